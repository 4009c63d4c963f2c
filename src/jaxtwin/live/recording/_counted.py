"""The last message of each device in a recording, so that no message is recorded a second time."""

import sqlite3

from ..protocol._message_counts import Counted
from ..protocol._records import Stream


def counted_in(database: sqlite3.Connection) -> dict[str, dict[str, dict[Stream, Counted]]]:
    """Returns the last messages in a recording: link -> start of a device -> stream ->
    `Counted`."""
    result: dict[str, dict[str, dict[Stream, Counted]]] = {}
    starts = "SELECT link, boot, max(id), min(arrival), max(hello) FROM greetings GROUP BY 1, 2"
    for link, boot, _, first, hello in database.execute(f"{starts} ORDER BY 3").fetchall():
        streams: dict[Stream, Counted] = {}
        own = "greeting IN (SELECT id FROM greetings WHERE link = ? AND boot = ?)"
        tables: list[tuple[Stream, str, str, tuple[object, ...]]] = [
            ("data", "samples", own, (link, boot)),
            ("event", "events", "link = ? AND arrival >= ? AND seq IS NOT NULL", (link, first)),
        ]
        if '"camera": null' not in hello:
            tables.append(("image", "readings", own, (link, boot)))
        for stream, table, where, values in tables:
            last = database.execute(
                f"SELECT seq, device_us FROM {table} WHERE {where} ORDER BY id DESC LIMIT 1", values
            ).fetchone()
            if last is not None:
                streams[stream] = Counted((last[0] + 1) % 2**32, last[1])
        result.setdefault(link, {})[boot] = streams
    return result
