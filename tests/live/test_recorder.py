"""The recorder's contract: journalled before seen, append-only, readable whatever happened."""

import json
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import tracemalloc
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name

import numpy as np
import pytest
from hand_clock import START, HandClock, ScriptedTransport, stepped_bench

import jaxtwin as jt
from jaxtwin.errors import RecordingError
from jaxtwin.io import Session
from jaxtwin.live import (
    Data,
    Gap,
    Greeting,
    Hello,
    Image,
    LinkState,
    Reading,
    Recorder,
    Sample,
    Service,
    SystemClock,
    connect,
    encode,
)
from jaxtwin.rig import Rig

HELLO = Hello(2, "dual-cell", "b1", cells=("P1", "P2"), camera=(80, 60), watchdog=2.0)
GREETING = Greeting("link", START, HELLO)


def sample(seq: int) -> Sample:
    return Sample("link", "b1", START + seq * 10**8, seq * 10**5, seq, (128, -3), 16.0)


def reading(seq: int, *, frame: bool = False) -> Reading:
    pixels = np.full((60, 80), seq, np.uint16) if frame else None
    return Reading(
        "link", "b1", START + seq * 10**8, seq * 10**5, seq, np.full(15, 20.0), False, pixels
    )


def count(file: Path, table: str = "samples") -> int:
    with Session(file) as session:
        return session.database.execute(f"SELECT count(*) FROM {table}").fetchone()[0]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "session.db"


def test_what_was_written_is_read_by_others_while_recording_goes_on(rig: Rig, file: Path) -> None:
    with Recorder(file, rig, keep_frames=True) as recorder:
        recorder.write([GREETING, sample(1), reading(1, frame=True)])
        with Session(file) as reader, Session(file) as other:
            for session in (reader, other):
                row = session.database.execute('SELECT "pwm_P1", "pwm_P2" FROM samples').fetchone()
                assert row == (128, -3)
            recorder.write([sample(2)])
            assert reader.database.execute("SELECT count(*) FROM samples").fetchone() == (2,)
        with closing(sqlite3.connect(file)) as database:
            pixels = database.execute("SELECT pixels FROM frames").fetchone()[0]
        assert pixels == np.full(4800, 1, "<u2").tobytes()


def test_a_frame_is_in_the_file_before_anyone_sees_it(
    rig: Rig, file: Path, clock: HandClock
) -> None:
    messages = [HELLO, *[Data(seq, seq, (0, 0)) for seq in range(20)]]
    reads = [encode(message) for message in messages]
    recorder = Recorder(file, rig, clock=clock)
    bench = stepped_bench(rig, {"link": lambda: ScriptedTransport(*reads)}, clock, journal=recorder)
    seen = 0
    for _ in range(25):
        seen += sum(isinstance(record, Sample) for record in bench.poll())
        assert count(file) == seen
    assert seen == 20
    recorder.close()


def test_a_record_that_the_journal_refuses_reaches_no_consumer(
    rig: Rig, file: Path, clock: HandClock
) -> None:
    recorder = Recorder(file, rig, clock=clock)
    transport = ScriptedTransport(encode(HELLO), encode(Data(0, 0, (0, 0))))
    bench = stepped_bench(rig, {"link": lambda: transport}, clock, journal=recorder)
    service = Service(bench)
    service.turn()
    service.turn()
    recorder.close()
    with pytest.raises(RecordingError, match="closed"):
        service.turn()
    assert service.state.sample is None


def test_a_recording_is_append_only(rig: Rig, file: Path) -> None:
    with Recorder(file, rig) as recorder:
        recorder.write([GREETING, sample(1), Gap("link", START, "data", 5, 2)])
    database = sqlite3.connect(file)
    for statement in ("DELETE FROM samples", "UPDATE gaps SET count = 0", "DELETE FROM gaps"):
        with pytest.raises(sqlite3.IntegrityError, match="append-only"):
            database.execute(statement)
    database.close()


def test_it_is_synced_to_the_disk_once_a_second_also_in_silence(
    rig: Rig, file: Path, clock: HandClock
) -> None:
    with Recorder(file, rig, clock=clock) as recorder:
        for _ in range(30):
            clock.turn(0.1)
            recorder.write([])
        with Session(file) as session:
            alive = session.database.execute("SELECT alive FROM runs").fetchone()[0]
        assert clock.now() - alive < 1.1e9


def test_a_step_of_the_system_clock_is_noted_and_changes_no_time(
    rig: Rig, file: Path, clock: HandClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clock, "utc", lambda: clock.time - 3_600_000_000_000)
    with Recorder(file, rig, clock=clock) as recorder:
        for _ in range(7):
            clock.turn(100.0)
            recorder.write([])
    with Session(file) as session:
        query = "SELECT arrival, detail FROM events WHERE kind = 'host-clock'"
        rows = session.database.execute(query).fetchall()
    assert rows == [(START + 600 * 10**9, "system clock -3600.000000 s")]


def test_a_suspend_is_noted_at_once(
    rig: Rig, file: Path, clock: HandClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    asleep = [0]
    monkeypatch.setattr(clock, "utc", lambda: clock.time + asleep[0])
    with Recorder(file, rig, clock=clock) as recorder:
        for second in range(10):
            asleep[0] = 900 * 10**9 * (second > 4)  # the monotonic clock slept as well
            clock.turn(1.0)
            recorder.write([])
    with Session(file) as session:
        query = "SELECT detail FROM events WHERE kind = 'host-clock'"
        assert session.database.execute(query).fetchall() == [("system clock +900.000000 s",)]


def test_it_is_noted_whether_ntp_keeps_the_clock(
    rig: Rig, file: Path, clock: HandClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the start, and at once when that changes."""
    second = [0]
    monkeypatch.setattr(clock, "is_synchronised", lambda: 5 <= second[0] < 8)
    with Recorder(file, rig, clock=clock) as recorder:
        for second[0] in range(10):
            clock.turn(1.0)
            recorder.write([])
    with Session(file) as session:
        query = "SELECT arrival, detail FROM events WHERE kind = 'host-clock' ORDER BY id"
        rows = [
            ((arrival - START) // 10**9, detail)
            for arrival, detail in session.database.execute(query).fetchall()
        ]
    assert rows == [
        (1, "system clock +0.000000 s, not kept by NTP"),
        (6, "system clock +0.000000 s, kept by NTP"),
        (9, "system clock +0.000000 s, not kept by NTP"),
    ]


def test_the_system_says_whether_ntp_keeps_its_clock() -> None:
    """By the kernel's flag of an unsynchronised clock, which timedatectl shows too."""
    found = SystemClock().is_synchronised()
    assert found is None or type(found) is bool
    if sys.platform == "linux":
        assert found is not None


def test_a_file_that_is_there_is_not_overwritten(rig: Rig, file: Path) -> None:
    file.write_text("precious")
    with pytest.raises(RecordingError, match="expected a new file, got an existing one"):
        Recorder(file, rig)
    assert file.read_text() == "precious"


def test_a_second_recorder_is_refused_until_the_first_has_ended(rig: Rig, file: Path) -> None:
    with (
        Recorder(file, rig),
        pytest.raises(RecordingError, match="another process records into it"),
    ):
        Recorder(file, rig, append=True)
    Recorder(file, rig, append=True).close()


def test_a_second_recorder_is_refused_if_the_lock_beside_the_file_is_deleted(
    rig: Rig, file: Path
) -> None:
    with Recorder(file, rig) as recorder:
        file.with_name("session.db-lock").unlink()
        with pytest.raises(RecordingError, match="another process records into it"):
            Recorder(file, rig, append=True)
        recorder.write([GREETING, sample(0)])
    assert count(file) == 1


def changed_copy(rig: Rig, file: Path, *statements: str) -> Path:
    """A recording that somebody has changed."""
    with Recorder(file, rig) as recorder:
        recorder.write([GREETING, sample(0), reading(0)])
    with closing(sqlite3.connect(file)) as database:
        for statement in statements:
            database.execute(statement)
        database.commit()
    return file


def test_a_channel_name_with_sql_in_it_is_refused(rig: Rig, file: Path) -> None:
    """Names become parts of SQL: this one would read another table."""
    name = 'T", (SELECT value FROM session) AS "x'
    names = json.dumps([name]).replace("'", "''")
    changed_copy(
        rig,
        file,
        "DROP TRIGGER session_update",
        f"UPDATE session SET value = '{names}' WHERE key = 'channels'",
    )
    with pytest.raises(RecordingError, match="is damaged: its metadata say channels = "):
        Session(file)


def test_a_view_in_place_of_a_table_is_refused(rig: Rig, file: Path) -> None:
    """This one never ends."""
    endless = (
        "WITH RECURSIVE k(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM k) SELECT i AS id FROM k"
    )
    changed_copy(rig, file, "DROP TABLE events", f"CREATE VIEW events AS {endless}")
    with pytest.raises(RecordingError, match="got the view 'events', which no recorder makes"):
        Session(file)


@pytest.mark.slow
def test_a_part_of_a_recording_equals_that_part_of_the_whole(rig: Rig, file: Path) -> None:
    """Rows of a part are found by their arrival. Two runs, ten minutes apart."""
    clock = HandClock()
    for run in range(2):
        clock.time = START + run * 900 * 10**9
        hello = replace(HELLO, boot=f"b{run}")
        with Recorder(file, rig, append=run > 0, clock=clock) as recorder:
            recorder.write([Greeting("link", clock.time, hello)])
            for k in range(3000):
                at = {"arrival": clock.time + k * 10**8 + (k * 7919 % 97) * 10**5}
                boot = {"boot": f"b{run}"}
                recorder.write(
                    [
                        replace(sample(k), pwm=(k % 200, 0), **at, **boot),
                        replace(reading(k), temperatures=np.full(15, k % 40.0), **at, **boot),
                    ]
                )
    with Session(file) as session:
        whole = session.experiment()
        assert len(whole.gaps) == 1
        for start, end in ((100, 200), (250, 950), (1000, 1100)):
            assert session.experiment(start=start, end=end) == whole.between(start, end + 0.5)


@pytest.mark.slow
def test_an_experiment_needs_no_more_memory_than_its_grid(
    rig: Rig, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """20 000 readings of 15 channels are 2.4 MB; a block of 500 and a grid of 20 steps are not."""
    with Recorder(file, rig) as recorder:
        records = [part for k in range(20_000) for part in (sample(k), reading(k))]
        recorder.write([GREETING, *records])
    monkeypatch.setattr("jaxtwin.io._session_rows.ROWS_IN_MEMORY", 500)
    monkeypatch.setattr("jaxtwin.io._session.MAX_STAMPS", 1000)
    with Session(file) as session:
        tracemalloc.start()
        found = session.experiment(step=100.0)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert len(found.time) == 20
    assert peak < 1.5e6


def test_going_on_after_a_break_notes_the_break(rig: Rig, file: Path, clock: HandClock) -> None:
    first = Recorder(file, rig, clock=clock)
    first.write([GREETING, sample(1)])
    copy = file.with_name("copy.db")
    shutil.copy(file, copy)  # as it is left behind when the power fails
    shutil.copy(f"{file}-wal", f"{copy}-wal")
    first.close()
    clock.turn(60)
    with Recorder(copy, rig, append=True, clock=clock) as recorder:
        recorder.write([GREETING, sample(2)])
    with Session(copy) as session:
        query = "SELECT detail FROM events WHERE kind = 'not-recorded'"
        (detail,) = session.database.execute(query).fetchone()
    assert detail == "the run before broke off; nothing was recorded for 60.0 s"
    assert count(copy) == 2


def test_a_recording_of_another_rig_is_not_gone_on_with(rig: Rig, file: Path) -> None:
    Recorder(file, jt.load_rig("paper-2024")).close()
    with pytest.raises(RecordingError, match="record each rig into a file of its own"):
        Recorder(file, rig, append=True)


@pytest.mark.parametrize("lost", [1, 33, 3000, 4097, 9000])
def test_a_torn_tail_is_repaired_on_opening(rig: Rig, file: Path, lost: int) -> None:
    recorder = Recorder(file, rig)
    recorder.write([GREETING])
    for seq in range(40):
        recorder.write([sample(seq)])
    torn = file.with_name("torn.db")
    shutil.copy(file, torn)
    journal = Path(f"{file}-wal").read_bytes()
    Path(f"{torn}-wal").write_bytes(journal[:-lost])
    recorder.close()
    with Session(torn) as session:
        found = [seq for (seq,) in session.database.execute("SELECT seq FROM samples ORDER BY id")]
    # The last transactions are gone as a whole; the others are there as a whole.
    assert found == list(range(len(found)))
    assert 40 > len(found) >= 40 - 1 - lost // 4096


def test_a_full_disk_stops_with_a_clear_error_and_all_before_can_be_read(
    rig: Rig, file: Path
) -> None:
    recorder = Recorder(file, rig, keep_frames=True)
    recorder.write([GREETING])
    (pages,) = recorder._database.execute("PRAGMA page_count").fetchone()
    recorder._database.execute(f"PRAGMA max_page_count = {pages + 80}")
    for seq in range(20):
        recorder.write([reading(seq, frame=True)])
    many = [reading(seq, frame=True) for seq in range(20, 200)]
    with pytest.raises(
        RecordingError, match="the disk is full; recording stopped after 21"
    ) as error:
        recorder.write(many)
    assert str(file) in str(error.value)
    assert count(file, "readings") == 20
    with pytest.raises(RecordingError, match="closed"):
        recorder.write([reading(1)])


@pytest.mark.parametrize(
    ("refused", "journal"),
    [
        (["mode=rw NORMAL"], True),  # a full disk: no room for the index
        (["mode=rw NORMAL", "mode=rw EXCLUSIVE"], False),  # a write-protected folder
    ],
)
def test_a_recording_can_be_read_where_nothing_can_be_written(
    rig: Rig, file: Path, monkeypatch: pytest.MonkeyPatch, refused: list[str], journal: bool
) -> None:
    recorder = Recorder(file, rig)
    recorder.write([GREETING, sample(1)])
    left = file.with_name("left.db")
    if journal:
        shutil.copy(file, left)
        shutil.copy(f"{file}-wal", f"{left}-wal")
    recorder.close()
    if not journal:
        shutil.copy(file, left)
    real = resolve_name("jaxtwin.io._session._connect")

    def connect(file: Path, access: str, locking: str) -> sqlite3.Connection:
        if f"{access} {locking}" in refused:
            raise sqlite3.OperationalError("unable to open database file")
        return real(file, access, locking)

    monkeypatch.setattr("jaxtwin.io._session._connect", connect)
    assert count(left) == 1


def test_a_reader_leaves_nothing_behind_and_can_change_nothing(rig: Rig, file: Path) -> None:
    with Recorder(file, rig) as recorder:
        recorder.write([GREETING, sample(1)])
    with Session(file) as session, pytest.raises(sqlite3.OperationalError, match="readonly"):
        session.database.execute("DROP TABLE samples")
    assert {path.name for path in file.parent.iterdir()} == {"session.db", "session.db-lock"}


def test_a_reader_that_ends_first_takes_nothing_from_the_recorder(rig: Rig, file: Path) -> None:
    with Recorder(file, rig) as recorder:
        recorder.write([GREETING, sample(1)])
        for number in range(2, 5):
            assert count(file) == number - 1
            recorder.write([sample(number)])
    assert count(file) == 4


def test_other_databases_are_no_recordings_and_are_left_alone(file: Path) -> None:
    sqlite3.connect(file).execute("CREATE TABLE t (x)").connection.close()
    before = file.read_bytes()
    with pytest.raises(RecordingError, match="expected a recording of a live rig"):
        Session(file)
    with pytest.raises(RecordingError, match="is no recording"):
        jt.read_recording(file)
    assert [(path.name, path.read_bytes()) for path in file.parent.iterdir()] == [
        (file.name, before)
    ]


RECORDING = """
import sys
import jaxtwin as jt
from jaxtwin.live import Reading, Recorder, Sample, connect
rig = jt.load_rig("dual-cell")
with Recorder(sys.argv[1], rig) as recorder, connect(rig, sys.argv[2], journal=recorder) as bench:
    for record in bench:
        if isinstance(record, Sample):
            print(record.seq, flush=True)
"""


def accepted_from(process: subprocess.Popen[str], server: socket.socket) -> socket.socket:
    """The connection of a process, waited for while the process runs, one minute at most."""
    server.settimeout(1.0)
    for _ in range(60):
        with suppress(TimeoutError):
            return server.accept()[0]
        if process.poll() is not None:
            break
    process.kill()
    process.communicate()
    pytest.fail(f"expected a connection, got a process that ended with {process.returncode}")


def test_kill_9_loses_nothing_that_was_seen_and_at_most_a_second(rig: Rig, file: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        command = [sys.executable, "-c", RECORDING, str(file), url]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        connection = accepted_from(process, server)
        connection.sendall(encode(HELLO))
        sent = 0
        assert process.stdout is not None
        while sent < 200 or not process.stdout.readline():
            connection.sendall(encode(Data(sent, sent * 1000, (0, 0))))
            sent += 1
        process.send_signal(signal.SIGKILL)
        seen = [int(line) for line in process.stdout.read().split()]
        process.wait()
        process.stdout.close()
        connection.close()
    with Session(file) as session:
        kept = [seq for (seq,) in session.database.execute("SELECT seq FROM samples ORDER BY id")]
        assert session.database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert kept == list(range(len(kept)))
    assert set(seen) <= set(kept)
    with Session(file) as session:
        assert session.database.execute("SELECT ended FROM runs").fetchone() == (None,)


@pytest.mark.usefixtures("no_threads_left")
def test_a_bench_on_a_real_socket_reconnects_and_records_the_gap(rig: Rig, file: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        records: list[object] = []
        with Recorder(file, rig) as recorder, connect(rig, url, journal=recorder) as bench:
            for first in (0, 5):
                connection, _ = server.accept()
                stream = [HELLO, *[Data(seq, seq, (0, 0)) for seq in range(first, first + 3)]]
                connection.sendall(b"".join(map(encode, stream)))
                while Sample not in {type(r) for r in records if getattr(r, "seq", 0) == first + 2}:
                    records += bench.poll()
                connection.close()
            while bench.states[url] is not LinkState.DOWN:
                records += bench.poll()
    assert [record.seq for record in records if isinstance(record, Sample)] == [0, 1, 2, 5, 6, 7]
    assert [(r.first, r.count) for r in records if isinstance(r, Gap)] == [(3, 2)]
    assert count(file) == 6
    assert count(file, "gaps") == 1


def test_image_rows_hold_the_channels(rig: Rig, file: Path, clock: HandClock) -> None:
    pixels = np.full((60, 80), 30_000, np.uint16)
    reads = [encode(HELLO), encode(Image(0, 0, 0, pixels)), encode(Image(1, 1, 1, pixels))]
    with Recorder(file, rig, clock=clock) as recorder:
        opener = lambda: ScriptedTransport(*reads)  # noqa: E731
        bench = stepped_bench(rig, {"link": opener}, clock, journal=recorder)
        for _ in range(5):
            bench.poll()
    with Session(file) as session:
        rows = session.database.execute('SELECT "T11_degC", recalibrating FROM readings').fetchall()
        kinds = [kind for (kind,) in session.database.execute("SELECT kind FROM events")]
    assert rows == [(pytest.approx(26.85), 0), (pytest.approx(26.85), 1)]
    assert "recalibration-start" in kinds
