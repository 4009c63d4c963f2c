"""The last message of each device in a recording, so that no message is recorded a second time."""

import sqlite3
from collections.abc import Mapping
from typing import NamedTuple

from ._records import Stream


class Counted(NamedTuple):
    """The point up to which a stream of one start of a device has been recorded.

    - `expected`: the number of the next message.
    - `device_us`: the device's time of the last message, microseconds.
    """

    expected: int
    device_us: int


Counters = Mapping[str, Mapping[Stream, Counted]]
"""Start of a device (`boot`) -> stream -> `Counted`."""


def counted_in(database: sqlite3.Connection) -> dict[str, dict[str, dict[Stream, Counted]]]:
    """Returns the last messages in a recording: link -> start of a device -> stream ->
    `Counted`."""
    found: dict[str, dict[str, dict[Stream, Counted]]] = {}
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
        found.setdefault(link, {})[boot] = streams
    return found
