"""After the end of a run: the readings show whether a rig that reports off cools, or heats."""

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hand_clock import HandClock, virtual_bench
from hazards import AFTER_STOP, AfterStop, run_after_stop

from jaxtwin.cli import run
from jaxtwin.errors import SafetyStop
from jaxtwin.io import Experiment
from jaxtwin.live import (
    Ending,
    Finding,
    Guard,
    Order,
    Reading,
    RigState,
    Sample,
    StopRequest,
    VirtualRig,
    drive,
)
from jaxtwin.live._switch_off import _Switch
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig, load_rig

PLAN = Experiment.schedule("0:0.5", duration=30)


@pytest.fixture(scope="module")
def cell() -> Twin:
    return Twin(load_rig("single-cell"))


def welded(device: VirtualRig) -> None:
    """A relay that does not open: the plant keeps its last duty whatever the device reports."""
    drive_plant = device.twin.drive

    def driven(duty: np.ndarray, ambient: float | None = None) -> None:
        if np.any(duty):
            drive_plant(duty, ambient)

    device.twin.drive = driven  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "is_matched"), [(1, False), (2, True)])
@pytest.mark.parametrize("case", AFTER_STOP, ids=lambda case: case.name)
def test_the_readings_show_what_the_device_does_not_report(
    twin: Twin, case: AfterStop, seed: int, is_matched: bool
) -> None:
    """Also where a match has left contacts and the lag of the driver open, and the rig is one that
    it has not excluded."""
    random, draws = np.random.default_rng(seed), None
    if is_matched:
        names = ["t_lag", *(name for name in twin.values if name.startswith("R_pc"))]
        draws = {
            name: float(twin.values[name]) * np.exp(0.5 * random.normal(size=17)) for name in names
        }
    truth = {name: float(column[16]) for name, column in (draws or {}).items()}
    known = draws and {name: column[:16] for name, column in draws.items()}
    seen = run_after_stop(case, (twin, twin), seed, truth, known)
    assert seen.verdict in case.verdicts, seen.said
    assert seen.after < 61


def test_a_rig_that_cools_is_called_off_and_not_before(cell: Twin, clock: HandClock) -> None:
    ends: list[Ending] = []
    bench = virtual_bench(cell.rig, VirtualRig(cell), clock)
    assert drive(bench, Guard.of(cell), PLAN, on_end=ends.append) == "completed"
    reported, ending = ends
    assert str(reported) == "the device reports off"
    assert ending.verdict == "off"
    assert str(ending).startswith("the cells are off (as the readings show after ")


def test_heat_before_the_stop_is_not_taken_for_heat_after_it(cell: Twin, clock: HandClock) -> None:
    """The last readings before a stop by silence are as old as the silence."""
    ends: list[Ending] = []
    bench = virtual_bench(cell.rig, VirtualRig(cell), clock)
    poll, begin = bench.poll, clock.now()

    def polled(timeout: float = 0.1) -> list:
        lost = 10e9 < clock.now() - begin < 13.2e9
        return [record for record in poll(timeout) if not (lost and isinstance(record, Reading))]

    bench.poll = polled  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(SafetyStop, match="no temperature for 3"):
        drive(bench, Guard.of(cell), Experiment.schedule("0:1", duration=30), on_end=ends.append)
    assert ends[-1].verdict == "off"


def test_a_welded_relay_is_an_alarm_and_the_relay_is_commanded_again(
    cell: Twin, clock: HandClock
) -> None:
    device, alarms = VirtualRig(cell), list[Finding]()
    welded(device)
    bench, orders = virtual_bench(cell.rig, device, clock), list[str]()
    send = bench.send_order
    bench.send_order = lambda kind: orders.append(kind) or send(kind)  # pyright: ignore
    with pytest.raises(SafetyStop, match="THE RIG HEATS AFTER A STOP: CUT THE POWER") as no:
        drive(bench, Guard.of(cell), PLAN, on_alarm=alarms.append)
    assert no.value.kind == "heats"
    assert [(alarm.kind, alarm.severity) for alarm in alarms] == [("heats", "critical")]
    assert orders.count("stop") > 10
    assert "the cells are off" not in str(no.value)


def test_sensors_that_stand_still_show_nothing(
    cell: Twin, clock: HandClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frozen reading looks like a rig whose heat goes on."""
    device, ends = VirtualRig(cell), list[Ending]()
    bench, camera = virtual_bench(cell.rig, device, clock), type(device._picture)

    def freeze(time: float, pwm: tuple[int, ...]) -> None:
        if time > 29:
            assert device._frozen is not None
            image = device._frozen
            monkeypatch.setattr(camera, "frame", lambda *_: image)

    drive(bench, Guard.of(cell), PLAN, on_progress=freeze, on_end=ends.append)
    assert [end.verdict for end in ends] == ["", "unknown"]
    assert str(ends[-1]) == "the device reports off (the readings did not show it within 60 s)"


def test_a_user_ends_the_watch_and_nothing_is_claimed(cell: Twin, clock: HandClock) -> None:
    stop, ends, released = StopRequest(), list[Ending](), list[int]()
    bench = virtual_bench(cell.rig, VirtualRig(cell), clock)
    send = bench.send_order

    def sent(kind: Any) -> bool:
        if kind == "release":  # the device has reported off
            released.append(clock.now())
        return send(kind)

    bench.send_order = sent  # pyright: ignore[reportAttributeAccessIssue]
    poll = bench.poll

    def polled(timeout: float = 0.1) -> list:
        if sum(released) and clock.now() - released[0] > 3e9:
            stop.set()
        return poll(timeout)

    bench.poll = polled  # pyright: ignore[reportAttributeAccessIssue]
    drive(bench, Guard.of(cell), PLAN, stop=stop, on_end=ends.append)
    assert (clock.now() - released[0]) * 1e-9 < 4
    assert str(ends[-1]) == "the device reports off"


def test_the_command_exits_with_6_and_runs_the_alarm(
    cell: Twin,
    clock: HandClock,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    device, called = VirtualRig(cell), tmp_path / "called"
    welded(device)
    bench = virtual_bench(cell.rig, device, clock)
    monkeypatch.setattr("jaxtwin.live.connect", lambda *_, **__: contextlib.nullcontext(bench))
    command = ["drive", "single-cell", "--link", "loop://", "--duty", "0:0.5", "--duration", "20"]
    assert run([*command, "--alarm", f'echo "$JAXTWIN_ALARM" >> "{called}"']) == 6
    assert called.read_text() == "heats\n"
    assert "CUT THE POWER" in capsys.readouterr().err


def test_the_alarm_runs_when_an_interlock_stops_the_run(
    cell: Twin, clock: HandClock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    device, called = VirtualRig(cell), tmp_path / "called"
    bench = virtual_bench(cell.rig, device, clock)
    poll, begin = bench.poll, clock.now()

    def polled(timeout: float = 0.1) -> list:
        if clock.now() - begin > 10e9 and not device.stage.trip_reason:
            device.stage.obey(Order("stop", 1, "somebody"), 0.0)
        return poll(timeout)

    bench.poll = polled  # pyright: ignore[reportAttributeAccessIssue]
    monkeypatch.setattr("jaxtwin.live.connect", lambda *_, **__: contextlib.nullcontext(bench))
    command = ["drive", "single-cell", "--link", "loop://", "--duty", "0:0.5", "--duration", "20"]
    assert run([*command, "--alarm", f'echo "$JAXTWIN_ALARM" >> "{called}"']) == 3
    assert called.read_text() == "device-trip\n"


def test_two_devices_that_were_driven_must_both_report_off(rig: Rig, twin: Twin) -> None:
    """A device whose link is lost while another one answers is not off."""
    clock = HandClock()
    bench = virtual_bench(rig, VirtualRig(twin), clock)
    bench._driven = {"a": True, "b": True, "relay": False}
    switch = _Switch(bench, False, RigState(), None, None)
    off = Sample("a", "x", clock.now() + 1, 0, 0, (0, 0), None)
    switch._samples = {"a": off}
    assert switch._sample() is None
    on = Sample("b", "y", clock.now() + 1, 0, 0, (178, 178), None)
    switch._samples["b"] = on
    assert switch._sample() is on
