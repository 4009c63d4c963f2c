"""Computes the statistics of a recording: counts, losses, jitter, gaps, clocks."""

import json
from dataclasses import asdict, dataclass
from typing import Any, final

import numpy as np

from ...io import Session, damage_as_recording_error


@final
@dataclass(frozen=True)
class StreamReport:
    """The statistics of one stream of one start of a device.

    **Arguments:**

    - `stream`: `samples` or `readings`.
    - `link`, `boot`: the link and the start of the device.
    - `count`: the number of recorded messages.
    - `period`: the median time between two messages, s of the rig.
    - `longest`: the longest time between two messages, s of the rig.
    - `drift`: the drift of the device's clock, ppm.
    - `wait_median`, `wait_99`, `wait_greatest`: the median, the 99 % quantile and the maximum of
      the delay with which messages arrived, s: the jitter.
    """

    stream: str
    link: str
    boot: str
    count: int
    period: float
    longest: float
    drift: float
    wait_median: float
    wait_99: float
    wait_greatest: float


def report(session: Session) -> dict[str, Any]:
    """Counts of everything in a recording, as plain data for people and for JSON.

    **Returns:** `streams` (`StreamReport`s as dictionaries), `lost` by stream, `events` by kind,
    `runs` with their start, end and outcome, `drives` with operator, plan and outcome.

    **Raises:** `RecordingError` if the recording is damaged.
    """
    with damage_as_recording_error(session.file):
        return _report(session)


def _report(session: Session) -> dict[str, Any]:
    execute = session.database.execute
    streams = []
    for device in session.clocks():
        marks = ",".join("?" * len(device.greetings))
        for table in ("samples", "readings"):
            rows = execute(
                f"SELECT device_us FROM {table} WHERE greeting IN ({marks}) ORDER BY id",
                device.greetings,
            )
            stamps = np.fromiter((stamp for (stamp,) in rows), np.int64)
            if len(stamps) < 2:
                continue
            steps = np.diff(stamps) * 1e-6
            streams.append(
                StreamReport(
                    table,
                    device.link,
                    device.boot,
                    len(stamps),
                    float(np.median(steps)),
                    float(steps.max()),
                    device.clock.drift,
                    *device.clock.wait,
                )
            )
    lost = dict(execute("SELECT stream, sum(count) FROM gaps GROUP BY stream").fetchall())
    events = dict(execute("SELECT kind, count(*) FROM events GROUP BY kind").fetchall())
    documents: dict[str, dict[str, Any]] = {}
    begins_and_ends = "SELECT uid, content FROM documents WHERE kind != 'decision' ORDER BY id"
    for uid, content in execute(begins_and_ends):
        documents.setdefault(uid, {}).update(json.loads(content))
    drives = [
        {key: result.get(key, "") for key in ("operator", "owner", "plan", "status", "reason")}
        for result in documents.values()
    ]
    runs = execute("SELECT started, alive, ended FROM runs ORDER BY id").fetchall()
    return {
        "rig": session.metadata["rig"],
        "streams": [asdict(stream) for stream in streams],
        "lost": lost,
        "events": events,
        "drives": drives,
        "runs": [
            {"started": started * 1e-9, "alive": alive * 1e-9, "ended": ended or "broke off"}
            for started, alive, ended in runs
        ],
    }
