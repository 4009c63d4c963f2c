"""Ends the driven runs of a recording whose program was killed before it could say how they
ended."""

import json
import sqlite3

# The end of a run that nobody ended.
END_OF_ABORTED_RUN = {
    "status": "aborted",
    "kind": "aborted",
    "reason": "the program ended without a stop of its own; only the device can have switched off",
    "off": False,
    "tripped": False,
}


def end_aborted_runs(database: sqlite3.Connection, run: int, arrival: int) -> None:
    """Adds a stop document for each start that has none, inside the caller's transaction.

    **Arguments:**

    - `run`: the run of the recorder that has found them.
    - `arrival`: the time of the documents, ns.
    """
    database.execute(
        "INSERT INTO documents SELECT NULL, ?, ?, 'stop', uid, ? FROM documents AS begun "
        "WHERE kind = 'start' AND NOT EXISTS "
        "(SELECT 1 FROM documents WHERE kind = 'stop' AND uid = begun.uid) ORDER BY id",
        (run, arrival, json.dumps(END_OF_ABORTED_RUN)),
    )
