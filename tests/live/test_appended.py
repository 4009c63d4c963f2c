"""Recordings that go on: in the order of their runs, whatever the host's clock says meanwhile."""

import contextlib
import json
import os
import sqlite3
from dataclasses import replace
from pathlib import Path
from random import Random

import hypothesis.strategies as st
import numpy as np
import pytest
from hand_clock import START, HandClock, ScriptedTransport, stepped_bench, virtual_bench
from hypothesis import HealthCheck, given, settings

from jaxtwin import JaxtwinError
from jaxtwin.errors import RecordingError
from jaxtwin.io import Session, backup_session, read_recording, write_recording
from jaxtwin.live import (
    Command,
    Data,
    Document,
    Event,
    Gap,
    Greeting,
    Hello,
    Notice,
    Reading,
    Record,
    Recorder,
    Replay,
    Sample,
    VirtualRig,
    encode,
    report,
)
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig, Sensors, load_rig

HELLO = Hello(2, "dual-cell", "b1", cells=("P1", "P2"), camera=(80, 60), watchdog=2.0)
HOUR, DAY = 3600.0, 86_400.0


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "session.db"


def test_a_run_whose_program_was_killed_gets_its_end_from_the_next_recorder(
    file: Path, rig: Rig, clock: HandClock
) -> None:
    """One that ended itself keeps its own; and none gets a second one."""
    with Recorder(file, rig, clock=clock) as recorder:
        recorder.write([Document(clock.now(), "start", "ended", {"operator": "anna"})])
        recorder.write([Document(clock.now(), "decision", "control", {})])
        recorder.write([Document(clock.now(), "stop", "ended", {"status": "completed"})])
        recorder.write([Document(clock.now(), "start", "killed", {"operator": "berta"})])
        recorder._give_up()  # as by a kill: nothing more is written
    for _ in range(2):
        clock.turn(60)
        Recorder(file, rig, append=True, clock=clock).close()
    with Session(file) as session:
        ends = session.database.execute(
            "SELECT uid, run, arrival, content FROM documents WHERE kind = 'stop' ORDER BY id"
        ).fetchall()
        drives = report(session)["drives"]
    assert [uid for uid, *_ in ends] == ["ended", "killed"]
    _, run, arrival, content = ends[1]
    assert (run, arrival) == (2, START + 60 * 10**9)
    assert json.loads(content)["status"] == "aborted"
    assert not json.loads(content)["off"]
    assert [drive["status"] for drive in drives] == ["completed", "aborted"]


def minute(clock: HandClock, boot: str, degC: float) -> list[Record]:
    """Ten seconds of a rig at one temperature, from now on."""
    hello = Hello(2, "dual-cell", boot, cells=("P1", "P2"), camera=(80, 60), watchdog=2.0)
    records: list[Record] = [Greeting("l", clock.now(), hello)]
    records.append(Document(clock.now(), "start", boot, {}))
    records.append(Command("l", clock.now(), 1, (0, 0)))
    for number in range(100):
        clock.turn(0.1)
        stamp = "l", boot, clock.now(), number * 100_000, number
        records.append(Sample(*stamp, (0, 0), 16.0))
        records.append(Reading(*stamp, np.full(15, degC), False, None))
    return records


@pytest.mark.parametrize("step", [-HOUR, HOUR, -DAY, DAY, -START * 1e-9, -5.0, 0.0])
def test_a_step_of_the_clock_between_runs_merges_nothing_and_loses_nothing(
    rig: Rig, file: Path, step: float
) -> None:
    clock = HandClock()
    with Recorder(file, rig, clock=clock) as recorder:
        recorder.write(minute(clock, "b1", 20.0))
    clock.turn(step)
    with Recorder(file, rig, append=True, clock=clock) as recorder:
        recorder.write(minute(clock, "b2", 40.0))
    with Session(file) as session:
        experiment = session.experiment()
        query = "SELECT kind FROM events WHERE kind IN ('clock-step', 'not-recorded')"
        kinds = session.database.execute(query).fetchall()
        arrivals = [a for (a,) in session.database.execute("SELECT arrival FROM samples")]
        for table in ("readings", "greetings", "events", "commands", "documents"):
            query = f"SELECT arrival FROM {table} ORDER BY id"
            times = [arrival for (arrival,) in session.database.execute(query)]
            assert times == sorted(times), table
    assert kinds == [("clock-step" if step < 0 else "not-recorded",)]
    assert arrivals == sorted(arrivals)
    assert len(arrivals) == 200
    # Each second is of one run or the other, and none is a mean of both.
    values = np.asarray(experiment.temperatures)[:, 0]
    values = values[~np.isnan(values)]
    assert set(values) == {20.0, 40.0}
    assert 18 <= len(values) <= 22


def test_a_time_that_no_grid_can_hold_is_refused_with_where_it_is(rig: Rig, file: Path) -> None:
    clock = HandClock()
    with Recorder(file, rig, clock=clock) as recorder:
        recorder.write(minute(clock, "b1", 20.0))
    clock.turn(40 * 365 * DAY)
    with Recorder(file, rig, append=True, clock=clock) as recorder:
        recorder.write(minute(clock, "b2", 40.0))
    with Session(file) as session:
        with pytest.raises(
            RecordingError, match=r"expected at most 1e\+07.*nothing was recorded from 9"
        ):
            session.experiment()
        assert session.experiment(end=9.0).duration == pytest.approx(9.0, abs=1.0)


def test_what_a_device_repeats_to_the_next_run_is_not_recorded_again(rig: Rig, file: Path) -> None:
    def run(first: int, last: int, clock: HandClock) -> list[Record]:
        reads = [encode(HELLO), *[encode(Data(n, n * 1000, (0, 0))) for n in range(first, last)]]
        with Recorder(file, rig, append=file.exists(), clock=clock) as recorder:
            opener = lambda: ScriptedTransport(*reads)  # noqa: E731
            bench = stepped_bench(rig, {"link": opener}, clock, journal=recorder)
            return [record for _ in range(len(reads) + 3) for record in bench.poll()]

    clock = HandClock()
    run(0, 120, clock)
    # The device goes on, and repeats what it does not know to have arrived.
    again = run(60, 130, clock)
    assert [r.seq for r in again if isinstance(r, Sample)] == list(range(120, 130))
    later = run(140, 150, clock)
    assert [(r.first, r.count) for r in later if isinstance(r, Gap)] == [(130, 10)]
    with Session(file) as session:
        rows = session.database.execute("SELECT count(*), count(DISTINCT seq) FROM samples")
        assert rows.fetchone() == (140, 140)


def test_a_clock_that_has_stepped_in_one_run_is_known_in_the_next(rig: Rig, file: Path) -> None:
    """The next run knows its numbers and its new clock, and drops what is repeated."""

    def run(stamps: dict[int, int]) -> list[Record]:
        reads = [encode(HELLO), *[encode(Data(n, t, (0, 0))) for n, t in stamps.items()]]
        with Recorder(file, rig, append=file.exists(), clock=clock) as recorder:
            opener = lambda: ScriptedTransport(*reads)  # noqa: E731
            bench = stepped_bench(rig, {"link": opener}, clock, journal=recorder)
            return [record for _ in range(len(reads) + 3) for record in bench.poll()]

    clock = HandClock()
    # The 32 bits of micros() are used up after 71 minutes.
    run({n: (4_294_000_000 + n * 50_000) % 2**32 for n in range(100)})
    records = run({n: (4_294_000_000 + n * 50_000) % 2**32 for n in range(90, 120)})
    assert [record.seq for record in records if isinstance(record, Sample)] == list(range(100, 120))
    assert not [record for record in records if isinstance(record, Gap)]
    again = run({n: n for n in range(120, 150)})  # and once more
    assert [r.seq for r in again if isinstance(r, Sample)] == list(range(129, 150))
    with Session(file) as session:
        boots = session.database.execute("SELECT boot FROM greetings ORDER BY id").fetchall()
    assert boots == [("b1",), ("b1.1",), ("b1.1",), ("b1.1",), ("b1.2",)]


def test_events_of_a_device_are_recorded_as_its_own(rig: Rig, file: Path) -> None:
    clock = HandClock()
    forged = ["link-loss", "link-down", "recording-end", "drive-stop"]
    reads = [encode(HELLO), *[encode(Notice(n, n, kind)) for n, kind in enumerate(forged)]]
    with Recorder(file, rig, clock=clock) as recorder:
        opener = lambda: ScriptedTransport(*reads)  # noqa: E731
        bench = stepped_bench(rig, {"link": opener}, clock, journal=recorder)
        for _ in range(10):
            bench.poll()
        # What a later version may write is no reason to refuse the file.
        recorder.write([Event("link", clock.now(), "link-asleep", "new")])
    with Replay(file, speed=float("inf")) as replay:
        kinds = [record.kind for record in replay if isinstance(record, Event)]
    assert [kind for kind in kinds if kind.startswith("device/")] == [
        f"device/{kind}" for kind in forged
    ]
    assert kinds.count("recording-end") == 1
    assert "link-asleep" in kinds


def test_a_second_writer_is_refused_also_through_a_link(rig: Rig, file: Path) -> None:
    link = file.with_name("link.db")
    link.symlink_to(file)
    with Recorder(file, rig):
        with pytest.raises(RecordingError, match="another process records into it"):
            Recorder(link, rig, append=True)
        os.link(file, file.with_name("hard.db"))
        with pytest.raises(RecordingError, match="hard links"):
            Recorder(file.with_name("hard.db"), rig, append=True)


@pytest.mark.parametrize("how", ["moved", "deleted"])
def test_a_file_that_goes_away_ends_the_recording_at_once(rig: Rig, file: Path, how: str) -> None:
    recorder = Recorder(file, rig)
    recorder.write([Greeting("l", START, HELLO)])
    if how == "moved":
        file.rename(file.with_name("other.db"))
    else:
        file.unlink()
    with pytest.raises(RecordingError, match="was moved or deleted"):
        recorder.write([Sample("l", "b1", START, 0, 0, (0, 0), None)])


def test_a_foreign_database_is_refused_before_it_is_touched(rig: Rig, file: Path) -> None:
    sqlite3.connect(file).execute("CREATE TABLE t (x)").connection.close()
    before = file.read_bytes()
    with pytest.raises(RecordingError, match="expected a recording of a live rig"):
        Recorder(file, rig, append=True)
    assert file.read_bytes() == before
    assert [path.name for path in file.parent.iterdir()] == [file.name]


def test_no_row_can_be_replaced(rig: Rig, file: Path) -> None:
    with Recorder(file, rig) as recorder:
        recorder.write([Greeting("l", START, HELLO), Gap("l", START, "data", 5, 2)])
    database = sqlite3.connect(file)
    for statement in (
        "INSERT OR REPLACE INTO gaps VALUES (1, 1, 'l', 0, 'data', 9, 9)",
        "INSERT OR REPLACE INTO session VALUES ('rig', '7')",
        "UPDATE session SET value = '7'",
        "DELETE FROM session",
        "DELETE FROM runs",
        "UPDATE runs SET started = 0",
        "UPDATE runs SET ended = NULL",
    ):
        with pytest.raises(sqlite3.IntegrityError, match="append-only"):
            database.execute(statement)
    database.close()


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("cells", '"P1"'),
        ("cells", "{"),
        ("cells", "[1]"),
        ("channels", "[]"),
        ("channels", '["T", "t"]'),
        ("counts", "0"),
        ("counts", "true"),
        ("polarity", "2"),
        ("camera", "[80]"),
        ("camera", '["a", 1]'),
        ("rig", "7"),
        ("rig_file", "null"),
    ],
)
def test_damaged_metadata_are_one_sentence(rig: Rig, file: Path, key: str, value: str) -> None:
    Recorder(file, rig).close()
    database = sqlite3.connect(file)
    database.execute("DROP TRIGGER session_update")
    database.execute("UPDATE session SET value = ? WHERE key = ?", (value, key))
    database.commit()
    database.close()
    with pytest.raises(RecordingError, match="is damaged: its metadata"):
        Session(file)


def test_a_rig_of_one_cell_and_one_channel_can_be_recorded(file: Path) -> None:
    Recorder(file, load_rig("single-cell")).close()
    with Session(file) as session:
        assert (len(session.metadata["cells"]), session.channels) == (1, ("T",))


@given(
    places=st.lists(st.floats(0, 1, exclude_max=True), min_size=1, max_size=40),
    values=st.randoms(use_true_random=False),
    in_header=st.booleans(),
)
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_damaged_recording_is_read_or_refused_in_a_sentence(
    rig: Rig, sound: bytes, tmp_path: Path, places: list[float], values: Random, in_header: bool
) -> None:
    """Whatever is done with it; no error of SQLite, NumPy or JSON comes through."""
    damaged = bytearray(sound)
    for place in places:
        span = 4096 if in_header else len(damaged)
        damaged[int(place * span)] = values.randrange(256)
    for number, use in enumerate((_exported, _replayed, _backed_up, _continued)):
        file = tmp_path / f"{number}.db"
        for old in tmp_path.glob(f"{number}.*"):
            old.unlink()
        file.write_bytes(damaged)
        with contextlib.suppress(RecordingError):
            use(rig, file)


@pytest.fixture(scope="module")
def sound(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A recording without damage."""
    file, clock = tmp_path_factory.mktemp("sound") / "session.db", HandClock()
    with Recorder(file, rig, clock=clock) as recorder:
        recorder.write(minute(clock, "b1", 20.0))
    return file.read_bytes()


def _exported(rig: Rig, file: Path) -> None:
    with Session(file) as session:
        report(session)
        session.experiment()


def _replayed(rig: Rig, file: Path) -> None:
    with Replay(file, speed=float("inf")) as replay:
        list(replay)


def _backed_up(rig: Rig, file: Path) -> None:
    backup_session(file, file.with_suffix(".copy"))


def _continued(rig: Rig, file: Path) -> None:
    clock = HandClock()
    with Recorder(file, rig, append=True, clock=clock) as recorder:
        recorder.write(minute(clock, "b1", 30.0))


def test_missing_metadata_are_one_sentence(rig: Rig, file: Path) -> None:
    Recorder(file, rig).close()
    database = sqlite3.connect(file)
    database.execute("DROP TRIGGER session_delete")
    database.execute("DELETE FROM session WHERE key = 'channels'")
    database.commit()
    database.close()
    with pytest.raises(RecordingError, match="say channels = None"):
        Session(file)


def test_names_that_differ_in_case_only_are_refused(rig: Rig, file: Path) -> None:
    first, second, *rest = rig.channels
    clash = replace(rig, channels=(replace(first, name="t"), replace(second, name="T"), *rest))
    with pytest.raises(JaxtwinError, match="more than upper and lower case"):
        Recorder(file, clash)
    assert not file.exists()


def test_names_with_spaces_and_umlauts_are_recorded(rig: Rig, file: Path) -> None:
    first, second, *rest = rig.channels
    named = replace(
        rig, channels=(replace(first, name="Zone 1"), replace(second, name="Tü"), *rest)
    )
    clock = HandClock()
    with Recorder(file, named, clock=clock) as recorder:
        recorder.write(minute(clock, "b1", 20.0))
    with Session(file) as session:
        assert session.experiment().channels[:2] == ("Zone 1", "Tü")


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".csv", ".nc"])
def test_names_with_spaces_and_umlauts_reach_the_export_and_the_twin(
    rig: Rig, file: Path, ending: str
) -> None:
    """From the rig file by the greeting of its device into a recording, an export, and the twin."""
    first, second, *rest = rig.channels
    channels = (replace(first, name="Zone 1"), replace(second, name="Tü"), *rest)
    cells = (replace(rig.cells[0], name="Cell_A.1"), *rig.cells[1:])
    named = replace(rig, cells=cells, channels=channels, camera=None, sensors=Sensors(0.1))
    twin, clock = Twin(named), HandClock()
    with Recorder(file, named, clock=clock) as recorder:
        bench = virtual_bench(named, VirtualRig(twin, speed=10), clock, journal=recorder)
        for _ in range(40):
            bench.poll()
    out = file.with_suffix(ending)
    with Session(file) as session:
        write_recording(session.experiment(), out)
    exported = read_recording(out)
    assert exported.channels == twin.channels
    assert exported.channels[:2] == ("Zone 1", "Tü")
    run = twin.simulate(exported)
    assert run.channels == twin.channels
    error = np.asarray(run.temperatures) - np.asarray(exported.temperatures)
    assert np.nanmax(np.abs(error)) < 1.0


def test_documents_say_who_asked_for_what(rig: Rig, file: Path) -> None:
    with Recorder(file, rig) as recorder:
        recorder.write([Document(START, "start", "u1", {"operator": "anna"})])
        recorder.write([Document(START, "stop", "u1", {"status": "completed"})])
    with Session(file) as session:
        rows = session.database.execute("SELECT kind, uid, content FROM documents").fetchall()
    assert [(kind, uid, json.loads(text)) for kind, uid, text in rows] == [
        ("start", "u1", {"operator": "anna"}),
        ("stop", "u1", {"status": "completed"}),
    ]
