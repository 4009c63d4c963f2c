"""Everything that the protocol allows a device to say can be recorded: codec, receiver and recorder
are tried together, each optional field absent or present, in every order."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hand_clock import HandClock, ScriptedTransport, stepped_bench
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxtwin as jt
from jaxtwin.errors import RecordingError
from jaxtwin.io import Session
from jaxtwin.live import Hello, Reading, Recorder, Replay, Sample, encode, encode_line
from jaxtwin.rig import load_rig

CELLS, CHANNELS = ("P1", "P2"), tuple(channel.name for channel in load_rig("dual-cell").channels)
OPTIONAL = {
    "pwm": st.sampled_from(["10,-20", "0,0"]),
    "ambient": st.sampled_from(["21.50", "-3"]),
    "temp": st.sampled_from([",".join(["20.5"] * 15), ",".join(["!open", *["20"] * 14])]),
    "owner": st.just("me"),
    "n": st.integers(0, 2**32 - 1).map(str),
    "trip": st.just("watchdog"),
    "relay": st.sampled_from(["on", "off"]),
}


@st.composite
def data_lines(draw: st.DrawFn, has_cells: bool, has_channels: bool) -> list[str]:
    """Lines of `data`, valid for a device with or without cells and channels."""
    allowed = [
        key for key in OPTIONAL if (key != "pwm" or has_cells) and (key != "temp" or has_channels)
    ]
    lines = []
    for seq in range(draw(st.integers(1, 6))):
        words = [f"seq={seq}", f"t={100_000 * seq}"]
        chosen = draw(st.lists(st.sampled_from(allowed), unique=True))
        words += [f"{key}={draw(OPTIONAL[key])}" for key in chosen]
        if has_cells and not any(word.startswith("pwm=") for word in words):
            words.append("pwm=1,2")  # of a device with cells it is not optional
        lines.append(" ".join(["data", *draw(st.permutations(words))]))
    return lines


@settings(max_examples=60, deadline=None)
@given(st.data(), st.booleans(), st.booleans())
def test_what_a_device_may_say_is_recorded_and_read_back(
    data: st.DataObject, has_cells: bool, has_channels: bool
) -> None:
    rig, clock = load_rig("dual-cell"), HandClock()
    hello = Hello(
        2,
        rig.name,
        "b1",
        cells=CELLS if has_cells else (),
        channels=CHANNELS if has_channels else (),
        watchdog=2.0 if has_cells else None,
    )
    lines = data.draw(data_lines(has_cells, has_channels))
    transport = ScriptedTransport(encode(hello), *(encode_line(line) for line in lines))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "session.db"
        with Recorder(file, rig, clock=clock) as recorder:
            bench = stepped_bench(rig, {"l": lambda: transport}, clock, journal=recorder)
            seen = [record for _ in range(len(lines) + 5) for record in bench.poll()]
        samples = [record for record in seen if isinstance(record, Sample)]
        readings = [record for record in seen if isinstance(record, Reading)]
        assert len(samples) == len(lines)
        with Session(file) as session:
            duty = session.duty()
        with Replay(file, speed=float("inf"), clock=clock) as replay:
            back = list(replay)
        again = [record for record in back if isinstance(record, Sample)]
        assert [record.pwm for record in again] == [record.pwm for record in samples]
        assert [record.ambient for record in again] == [record.ambient for record in samples]
        assert len(duty.time) == (len(lines) if has_cells else 0)
        assert np.isfinite(duty.values).all()
        assert [len(r.temperatures) for r in back if isinstance(r, Reading)] == [15] * len(readings)


def test_a_recording_of_a_newer_jaxtwin_is_called_newer(tmp_path: Path) -> None:
    import sqlite3
    from contextlib import closing

    file = tmp_path / "session.db"
    Recorder(file, load_rig("dual-cell")).close()
    with closing(sqlite3.connect(file)) as database:
        database.execute("PRAGMA user_version = 99")
    with pytest.raises(RecordingError, match="got 99, as it was written by a newer jaxtwin"):
        jt.read_recording(file)
