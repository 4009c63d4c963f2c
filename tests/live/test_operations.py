"""What a recording that nobody watches needs: alarms, copies, files by day, signs of life."""

import hashlib
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from folded import feed
from hand_clock import START

from jaxtwin.cli import run
from jaxtwin.errors import RecordingError
from jaxtwin.io import Session, backup_session
from jaxtwin.live import (
    Alarms,
    Finding,
    Greeting,
    Hello,
    LinkChange,
    LinkState,
    Reading,
    Record,
    Recorder,
    RigState,
    Sample,
)
from jaxtwin.rig import Rig

HELLO = Hello(2, "dual-cell", "b1", cells=("P1", "P2"), camera=(80, 60), watchdog=2.0)


def at(seconds: float) -> int:
    return START + round(seconds * 1e9)


def reading(seconds: float, *values: float, recalibrating: bool = False) -> Reading:
    device_us = round(seconds * 1e6)
    return Reading("l", "b", at(seconds), device_us, 0, np.array(values), recalibrating, None)


def sample(seconds: float, trip: str = "") -> Sample:
    return Sample("l", "b", at(seconds), round(seconds * 1e6), 0, (0, 0), None, trip=trip)


class Watch:
    """The alarms of a recording, and what they have raised at each turn."""

    def __init__(self, file: Path, channels: tuple[str, ...] = ("T11", "T12")):
        self._raised: list[Finding] = []
        self.alarms = Alarms(channels, 90.0, 10.0, file, START, self._raised.append)
        self._state = RigState()

    def check(self, records: Sequence[Record], now: int) -> list[Finding]:
        self._raised.clear()
        self._state = feed(self.alarms, records, now, self._state)
        return list(self._raised)


@pytest.fixture
def alarms(tmp_path: Path) -> Watch:
    return Watch(tmp_path / "s.db")


@pytest.mark.parametrize(
    ("record", "kind", "detail"),
    [
        (reading(1, 20.0, 91.0), "over-temperature", "T12 is at 91.0 degC"),
        (reading(1, float("nan"), 20.0), "channel-fault", "T11 failed"),
        (sample(1, "watchdog"), "device-trip", "the device is off: watchdog"),
        (LinkChange("l", at(1), LinkState.DOWN, "gone"), "link-down", "l is down: gone"),
    ],
)
def test_an_alarm_says_what_is_wrong(alarms: Watch, record: Record, kind: str, detail: str) -> None:
    assert [(alarm.kind, alarm.detail) for alarm in alarms.check([record], at(1))] == [
        (kind, detail)
    ]


def test_an_alarm_is_raised_once_and_again_after_it_was_over(alarms: Watch) -> None:
    raised = [
        second
        for second in range(60)
        if alarms.check(
            [sample(second), reading(second, 95.0 if second < 20 or second >= 40 else 20.0, 20.0)],
            at(second),
        )
    ]
    assert raised == [0, 40]


def test_a_failed_channel_hides_no_other_that_is_too_hot(tmp_path: Path) -> None:
    names = tuple(f"T{number}" for number in range(15))
    alarms = Watch(tmp_path / "s.db", names)
    hot = [500.0] * 14
    worst, lesser = alarms.check([reading(1, float("nan"), *hot)], at(1))
    assert [worst.kind, worst.severity] == ["over-temperature", "critical"]
    assert all(f"{name} is at 500.0 degC" in worst.detail for name in names[1:])
    assert lesser == Finding("channel-fault", "T0 failed", "T0", at(1), "warning")


def test_each_channel_has_an_alarm_of_its_own(alarms: Watch) -> None:
    details = []
    for second, values in enumerate([(91, 20), (91, 95), (20, 95), (float("nan"), 95), (20, 95)]):
        raised = alarms.check([reading(second, *map(float, values))], at(second))
        details += [alarm.detail for alarm in raised]
    assert details == ["T11 is at 91.0 degC", "T12 is at 95.0 degC", "T11 failed"]


def test_a_hot_channel_that_fails_or_is_silent_remains_hot(alarms: Watch) -> None:
    raised = [
        (second, alarm.kind)
        for second in range(60)
        for alarm in alarms.check(
            [sample(second), reading(second, 95.0, 20.0)]
            if second in (0, 55)
            else [sample(second), reading(second, float("nan"), 20.0)]
            if second < 30
            else [sample(second)],
            at(second),
        )
    ]
    assert raised == [(0, "over-temperature"), (1, "channel-fault"), (40, "stale-temperature")]


def test_heat_that_is_gone_with_the_next_record_is_an_alarm(alarms: Watch) -> None:
    (alarm,) = alarms.check([reading(1, 20.0, 91.0), reading(1.1, 20.0, 20.0)], at(1.1))
    found = "over-temperature", "T12 is at 91.0 degC", "T12", at(1.1), "critical"
    assert alarm == Finding(*found)


def test_each_link_has_an_alarm_until_it_is_live_again(alarms: Watch) -> None:
    def turn(second: int) -> list[Record]:
        records: list[Record] = [sample(second), reading(second, 20.0, 20.0)]
        if second in (0, 30):
            records.append(LinkChange("a", at(second), LinkState.DOWN, "gone"))
        if second in (5, 50):
            records.append(LinkChange("b", at(second), LinkState.DOWN, "gone"))
        if second in (20, 35):
            records.append(LinkChange("b", at(second), LinkState.LIVE, ""))
        return records

    raised = [(s, alarm.detail) for s in range(60) for alarm in alarms.check(turn(s), at(s))]
    assert raised == [(0, "a is down: gone"), (5, "b is down: gone"), (50, "b is down: gone")]


def test_samples_of_a_device_without_cells_raise_the_alarm_of_a_silent_controller(
    alarms: Watch,
) -> None:
    kinds = []
    for second in range(12):
        other = Sample("l", "b", at(second), 0, 0, (), 20.0)
        raised = alarms.check([other, reading(second, 20.0, 20.0)], at(second))
        kinds += [alarm.kind for alarm in raised]
    assert kinds == ["stale-controller"]


def test_silence_and_recalibrations_without_end_are_alarms(alarms: Watch) -> None:
    kinds = []
    for second in range(12):
        records: list[Record] = [reading(second, 20.0, 20.0, recalibrating=True)]
        kinds += [alarm.kind for alarm in alarms.check(records, at(second))]
    assert sorted(kinds) == ["stale-controller", "stale-temperature"]


def test_a_disk_that_is_nearly_full_is_an_alarm(
    alarms: Watch, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=50_000_000))
    (alarm,) = alarms.check([], at(1))
    assert alarm.kind == "disk"
    assert alarm.detail.startswith("50 MB are free at ")


def test_a_backup_holds_all_that_was_seen_while_recording_goes_on(rig: Rig, tmp_path: Path) -> None:
    file, copy = tmp_path / "session.db", tmp_path / "copy.db"
    with Recorder(file, rig) as recorder:
        recorder.write([Greeting("l", START, HELLO)])
        for number in range(50):
            recorder.write([Sample("l", "b1", at(number), number, number, (0, 0), None)])
        checksum = backup_session(file, copy)
        recorder.write([Sample("l", "b1", at(50), 50, 50, (0, 0), None)])
    assert hashlib.sha256(copy.read_bytes()).hexdigest() == checksum
    subprocess.run(["sha256sum", "--check", "copy.db.sha256"], cwd=tmp_path, check=True)
    # One file, that needs no journal.
    moved = tmp_path / "elsewhere.db"
    copy.rename(moved)
    with Session(moved) as session:
        assert session.database.execute("SELECT count(*) FROM samples").fetchone() == (50,)
    assert not list(tmp_path.glob("*.part"))


def test_a_backup_follows_no_link(rig: Rig, tmp_path: Path) -> None:
    """Neither one where it used to make its unfinished file, nor one in place of its results."""
    file, copy, victim = (tmp_path / name for name in ("session.db", "copy.db", "victim"))
    Recorder(file, rig).close()
    victim.write_text("precious")
    (tmp_path / "copy.db.part").symlink_to(victim)
    backup_session(file, copy)
    assert victim.read_text() == "precious"
    for name in ("second.db", "third.db.sha256"):
        (tmp_path / name).symlink_to(tmp_path / "nowhere")
        with pytest.raises(RecordingError, match="expected a new file, got an existing one"):
            backup_session(file, tmp_path / name.removesuffix(".sha256"))
    assert not (tmp_path / "nowhere").exists()


def test_a_backup_replaces_nothing_and_copies_recordings_only(rig: Rig, tmp_path: Path) -> None:
    file, copy = tmp_path / "session.db", tmp_path / "copy.db"
    Recorder(file, rig).close()
    copy.write_text("precious")
    with pytest.raises(RecordingError, match="expected a new file, got an existing one"):
        backup_session(file, copy)
    assert copy.read_text() == "precious"
    with pytest.raises(RecordingError, match="expected a recording of a live rig"):
        backup_session(copy, tmp_path / "other.db")
    assert run(["backup", str(file), str(tmp_path / "third.db")]) == 0


def test_an_alarm_runs_the_command_and_shows_in_the_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = tmp_path / "told"
    command = ["record", "dual-cell", "--link", "socket://127.0.0.1:1", "--duration", "1.5"]
    words = "$JAXTWIN_ALARM:$JAXTWIN_ALARM_SEVERITY"
    command += ["--silence", "0.5", "--alarm", f'echo "{words}" >> "{told}"']
    command += ["--out", str(tmp_path / "s.db")]
    assert run(command) == 5
    assert "alarm: 3" in capsys.readouterr().out
    assert set(told.read_text().split()) == {
        "link-down:warning",
        "stale-controller:warning",
        "stale-temperature:critical",
    }
