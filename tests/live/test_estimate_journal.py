"""What an observer estimates is journalled beside the readings, in a table of its own."""

import sqlite3
from pathlib import Path

import numpy as np
import pytest
from folded import feed
from hand_clock import START

from jaxtwin.io import Session
from jaxtwin.live import (
    EstimateJournal,
    Follower,
    Greeting,
    Hello,
    Reading,
    Record,
    Recorder,
    Replay,
    RigState,
    Sample,
    StateEstimate,
    record_as_json,
)
from jaxtwin.observers import live_observer
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig

GREETING = Greeting("link", START, Hello(2, "dual-cell", "b1", cells=("P1", "P2")))
SECOND = 10**9


def reading(seq: int, temperature: float = 20.0) -> Reading:
    at = START + seq * SECOND // 2
    return Reading("link", "b1", at, seq * 500_000, seq, np.full(15, temperature), False, None)


def estimate(seq: int, **values: float) -> StateEstimate:
    return StateEstimate(START + seq * SECOND, "values of fit.toml", values)


@pytest.mark.slow
def test_an_estimate_a_second_says_what_no_channel_sees(twin: Twin, rig: Rig, tmp_path: Path):
    """Of six readings half a second apart; the estimates are those of the follower."""
    noted: list[Record] = []
    follower = Follower(twin, live_observer(twin, None, 0.5))
    journal = EstimateJournal(noted.append, lambda: (follower, "mine"))
    state = RigState()
    for seq in range(6):
        record = reading(seq)
        state = feed(follower, [record], record.arrival, state)
        journal.on_time(state, record.arrival)
        journal.on_time(state, record.arrival)
    assert [one.arrival for one in noted] == [START, START + SECOND, START + 2 * SECOND]
    last = noted[-1]
    assert isinstance(last, StateEstimate)
    assert last.twin == "mine"
    assert last.values["channel_T11_degC"] == pytest.approx(20.0, abs=0.5)
    assert 0 < last.values["channel_T11_spread_K"] < last.values["node_P1.TH_spread_K"]
    assert {"room_degC", "heat_P2_W", "heat_P2_spread_W"} <= set(last.values)
    assert not any("V11" in name for name in last.values)  # channels see the plate
    with Recorder(tmp_path / "session.db", rig) as recorder:
        recorder.write([GREETING, *map(reading, range(6)), *noted])
    with Session(tmp_path / "session.db") as session:
        found = session.estimates()
    assert found.columns == tuple(last.values)
    np.testing.assert_allclose(found.values[-1], list(last.values.values()), rtol=0, atol=0)
    np.testing.assert_allclose(np.diff(found.time), 1.0, atol=1e-6)


def test_a_follower_without_a_reading_or_a_filter_gives_no_estimate(twin: Twin):
    noted: list[Record] = []
    follower = Follower(twin)
    journal = EstimateJournal(noted.append, lambda: (follower, ""))
    state = feed(follower, [Sample("link", "b1", START, 0, 0, (0, 0), 20.0)], START, RigState())
    journal.on_time(state, START)
    state = feed(follower, [reading(1)], START, state)
    journal.on_time(state, START + SECOND)
    assert noted == []


def test_a_recording_has_the_table_only_with_an_observer_and_appends_to_it(
    rig: Rig, tmp_path: Path
):
    file = tmp_path / "session.db"
    with Recorder(file, rig) as recorder:
        recorder.write([GREETING, reading(0)])
    with Session(file) as session:
        assert len(session.estimates().time) == 0
        tables = session.database.execute("SELECT name FROM sqlite_schema").fetchall()
        assert ("estimates",) not in tables
    for seq in (1, 2):
        with Recorder(file, rig, append=True) as recorder:
            recorder.write([estimate(seq, room_degC=21.0 + seq, room_spread_K=0.5)])
    with Session(file) as session:
        found = session.estimates()
        assert found.columns == ("room_degC", "room_spread_K")
        assert found.values[:, 0].tolist() == [22.0, 23.0]
        assert found.run.tolist() == [2, 3]
    database = sqlite3.connect(file)
    with pytest.raises(sqlite3.IntegrityError, match="append-only"):
        database.execute("UPDATE estimates SET room_degC = 0")
    database.close()


def test_estimates_of_another_kind_are_dropped_and_the_readings_kept(rig: Rig, tmp_path: Path):
    """Such as those of a rig file that has one body more now."""
    file = tmp_path / "session.db"
    with Recorder(file, rig) as recorder:
        recorder.write([GREETING, estimate(0, room_degC=21.0, room_spread_K=0.5)])
    with Recorder(file, rig, append=True) as recorder:
        recorder.write([GREETING, reading(1), estimate(1, heat_P1_W=1.0), reading(2)])
        recorder.write([estimate(2, heat_P1_W=1.0), reading(3)])
    with Session(file) as session:
        assert session.estimates().values.tolist() == [[21.0, 0.5]]
        rows = session.database.execute("SELECT count(*) FROM readings").fetchone()
        assert rows == (3,)
        query = "SELECT detail FROM events WHERE kind = 'estimates-dropped'"
        ((detail,),) = session.database.execute(query).fetchall()
        assert "'heat_P1_W'" in detail


def test_a_replay_goes_on_without_estimates_and_json_has_them(rig: Rig, tmp_path: Path):
    """An observer of a replay makes its own."""
    file = tmp_path / "session.db"
    one = estimate(1, room_degC=21.00049)
    with Recorder(file, rig) as recorder:
        recorder.write([GREETING, reading(0), one])
    with Replay(file, speed=float("inf")) as replay:
        assert not any(isinstance(record, StateEstimate) for record in replay)
    expected = {"kind": "estimate", "twin": "values of fit.toml", "room_degC": 21.0}
    assert record_as_json(one, rig).items() >= expected.items()
