"""Stops: a run that does not end as its user wants leaves a trip on the device, whatever the link
does meanwhile; and a device that reports heat after a stop is not left alone."""

import contextlib
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hand_clock import HandClock, virtual_bench

from jaxtwin import JaxtwinError
from jaxtwin.cli import run
from jaxtwin.errors import SafetyStop
from jaxtwin.io import Experiment
from jaxtwin.live import (
    Ask,
    Duty,
    Finding,
    Guard,
    Order,
    OutputStage,
    Recorder,
    StopRequest,
    VirtualRig,
    drive,
    encode,
)
from jaxtwin.live.protocol._output_stage import Answer
from jaxtwin.physics import Faults, Twin
from jaxtwin.rig import Rig

OFF = (0, 0)
PLAN = Experiment.schedule("0:0.5", duration=60, cells=2)
SHORT = Experiment.schedule("0:0.5", duration=2, cells=2)


@pytest.mark.slow
@pytest.mark.parametrize("after", [5.0, 6.1, 7.3, 8.7, 11.0, 13.9])
def test_a_link_that_is_lost_and_returns_within_the_watchdog_leaves_a_trip(
    rig: Rig, twin: Twin, clock: HandClock, after: float
) -> None:
    device = VirtualRig(twin, faults=Faults(disconnect=after))
    with pytest.raises(SafetyStop, match="is down: cut by a fault; the cells are off, and") as no:
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig)), PLAN)
    assert no.value.kind == "link-down"
    assert (device.pwm, device.stage.trip_reason) == (OFF, "stop")
    with pytest.raises(SafetyStop, match=r"switched off by itself \(stop\)"):
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig)), PLAN)


def test_an_exception_leaves_a_trip(rig: Rig, twin: Twin, clock: HandClock) -> None:
    device = VirtualRig(twin)

    def fails(time: float, pwm: tuple[int, ...]) -> None:
        if time > 2:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig)), PLAN, on_progress=fails)
    assert (device.pwm, device.stage.trip_reason) == (OFF, "stop")


@pytest.mark.slow
@pytest.mark.parametrize("moved", [True, False])
def test_a_recording_that_fails_leaves_a_trip(
    rig: Rig, twin: Twin, clock: HandClock, tmp_path: Path, moved: bool
) -> None:
    """A file that was moved, and one whose every write fails, as on a full disk: the device's
    report of the trip is read all the same."""
    device, file = VirtualRig(twin), tmp_path / "session.db"
    recorder = Recorder(file, rig, clock=clock)
    times: list[float] = []

    def fails(time: float, pwm: tuple[int, ...]) -> None:
        times.append(time)
        if time > 2 and moved:
            file.rename(tmp_path / "elsewhere.db")
        elif time > 2:
            recorder.close()

    bench = virtual_bench(rig, device, clock, journal=recorder)
    begin, released, send = clock.now(), [], bench.send_order

    def noted(kind: Any) -> bool:
        released.extend([clock.now()] if kind == "release" else [])
        return send(kind)

    bench.send_order = noted  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(JaxtwinError, match="moved or deleted" if moved else "is closed"):
        drive(bench, Guard.of(Twin(rig)), PLAN, on_progress=fails)
    assert (device.pwm, device.stage.trip_reason) == (OFF, "stop")
    assert (released[-1] - begin) * 1e-9 < times[-1] + 2  # it did not wait in vain


@pytest.mark.slow
def test_a_signal_of_the_system_leaves_a_trip_and_a_stop_by_the_user_does_not(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    for name, left in (("SIGTERM", "stop"), ("SIGHUP", "stop"), ("", "")):
        device, stop = VirtualRig(twin), StopRequest()

        def end(time: float, pwm: tuple[int, ...], stop=stop, name=name) -> None:
            if time > 2:
                stop.signal = name
                stop.set()

        ended = contextlib.nullcontext()
        if name:
            ended = pytest.raises(SafetyStop, match=f"stopped: {name} ended the program")
        with ended:
            bench = virtual_bench(rig, device, clock)
            assert drive(bench, Guard.of(Twin(rig)), PLAN, stop=stop, on_progress=end) == "stopped"
        assert (device.pwm, device.stage.trip_reason) == (OFF, left)
        assert device.stage.owner == ""


def test_ctrl_c_in_a_script_is_a_stop_by_the_user(rig: Rig, twin: Twin, clock: HandClock) -> None:
    device = VirtualRig(twin)

    def press(time: float, pwm: tuple[int, ...]) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig)), PLAN, on_progress=press)
    assert (device.pwm, device.stage.trip_reason, device.stage.owner) == (OFF, "", "")


def test_a_second_ctrl_c_does_not_keep_the_cells_on(rig: Rig, twin: Twin, clock: HandClock) -> None:
    device = VirtualRig(twin)
    bench = virtual_bench(rig, device, clock)
    poll, presses = bench.poll, []

    def pressed(timeout: float = 0.1) -> list:
        if any(device.pwm) and len(presses) < 3:
            presses.append(clock.now())
            raise KeyboardInterrupt
        return poll(timeout)

    bench.poll = pressed  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(KeyboardInterrupt):
        drive(bench, Guard.of(Twin(rig)), PLAN)
    assert (device.pwm, device.stage.owner) == (OFF, "")


@pytest.mark.slow
@pytest.mark.parametrize("change", [{"watchdog": 500.0}, {"counts": 100}, {"rate": 2.0}])
def test_a_device_that_greets_as_another_is_stopped_before_its_link_is_dropped(
    rig: Rig, twin: Twin, clock: HandClock, change: dict
) -> None:
    """Its true watchdog would let it heat for 500 s."""
    device = VirtualRig(twin)
    device.stage = OutputStage(2, 255, 500.0)

    def greet(time: float, pwm: tuple[int, ...]) -> None:
        if 1.9 < time < 2.2:
            device.hello = replace(device.hello, **change)
            device.receive(encode(Ask(2)))

    with pytest.raises(SafetyStop, match=f"rig: {next(iter(change))}: expected") as no:
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig)), PLAN, on_progress=greet)
    assert no.value.kind == "refused"
    assert (device.pwm, device.stage.trip_reason) == (OFF, "stop")


def stuck(device: VirtualRig, heard: list[Duty | Order], frees: float = float("inf")) -> None:
    """A bridge that keeps what it has got, without a watchdog: it obeys a stop only after a time of
    the device, s."""
    device.stage = OutputStage(2, 255, 1e9)
    obey = device.stage.obey

    def obeys(command: Duty | Order, now: float) -> Answer | None:
        heard.append(command)
        stops = isinstance(command, Order) or not any(command.pwm)
        return None if stops and now < frees else obey(command, now)

    device.stage.obey = obeys  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.slow
def test_a_device_that_reports_heat_is_told_to_stop_until_the_user_ends_it(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    device, heard = VirtualRig(twin), list[Duty | Order]()
    stuck(device, heard)
    stop, alarms = StopRequest(), list[Finding]()
    bench = virtual_bench(rig, device, clock)
    poll, begin = bench.poll, clock.now()

    def polled(timeout: float = 0.1) -> list:
        if alarms and clock.now() - begin > 120e9:
            stop.set()
        return poll(timeout)

    bench.poll = polled  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(SafetyStop, match=r"STILL ON \(128, 128 counts\).*: CUT THE POWER") as no:
        drive(
            bench,
            Guard.of(Twin(rig)),
            SHORT,
            stop=stop,
            on_alarm=alarms.append,
        )
    assert no.value.kind == "still-on"
    assert [alarm.kind for alarm in alarms] == ["still-on"]
    stops = [command for command in heard if isinstance(command, Order)]
    assert {command.kind for command in stops} == {"stop"}
    assert len(stops) > 900  # for two minutes
    # The last duty, which counts as a command for a watchdog, came within 2 s of the end.
    assert isinstance(heard[-900], Order)


@pytest.mark.slow
def test_a_device_that_switches_off_late_ends_the_stop(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    device, alarms = VirtualRig(twin), list[Finding]()
    stuck(device, [], frees=40.0)
    with pytest.raises(SafetyStop, match="reported heat 2 s after a stop; the cells are off now"):
        drive(
            virtual_bench(rig, device, clock),
            Guard.of(Twin(rig)),
            SHORT,
            on_alarm=alarms.append,
        )
    assert (device.pwm, device.stage.trip_reason) == (OFF, "stop")
    assert [alarm.kind for alarm in alarms] == ["still-on"]


def test_a_device_that_is_gone_is_an_alarm_and_not_waited_for_without_end(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    device, alarms = VirtualRig(twin, faults=Faults(stall=(4.0, 1000.0))), list[Finding]()
    begin = clock.now()
    with pytest.raises(SafetyStop, match="nothing was heard from it after the stop") as no:
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig)), PLAN, on_alarm=alarms.append)
    assert no.value.kind == "silence"
    assert [alarm.kind for alarm in alarms] == ["unconfirmed"]
    assert (clock.now() - begin) * 1e-9 < 40


@pytest.mark.slow
def test_an_alarm_that_fails_does_not_end_the_stop(rig: Rig, twin: Twin, clock: HandClock) -> None:
    device = VirtualRig(twin)
    stuck(device, [], frees=20.0)

    def fails(alarm: Finding) -> None:
        raise OSError("no mail")

    with pytest.raises(SafetyStop, match="the cells are off now"):
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig)), SHORT, on_alarm=fails)
    assert device.pwm == OFF


@pytest.mark.slow
@pytest.mark.parametrize("silence", [5.1, 3600.0, 0.0, float("nan")])
def test_a_silence_of_0_or_above_5_s_is_refused(
    rig: Rig, twin: Twin, clock: HandClock, silence: float
) -> None:
    device = VirtualRig(twin)
    with pytest.raises(JaxtwinError, match="silence: expected at most 5 s, for which the watchdog"):
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig), silence=silence), PLAN)


@pytest.mark.slow
def test_the_command_exits_with_5_and_calls_the_alarm_if_the_device_reports_heat(
    rig: Rig,
    twin: Twin,
    clock: HandClock,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    device = VirtualRig(twin)
    stuck(device, [])
    bench, called = virtual_bench(rig, device, clock), tmp_path / "called"
    poll, begin = bench.poll, clock.now()

    def polled(timeout: float = 0.1) -> list:
        if clock.now() - begin > 30e9:
            signal.raise_signal(signal.SIGINT)
        return poll(timeout)

    bench.poll = polled  # pyright: ignore[reportAttributeAccessIssue]
    monkeypatch.setattr("jaxtwin.live.connect", lambda *_, **__: contextlib.nullcontext(bench))
    command = ["drive", "dual-cell", "--link", "loop://", "--duty", "0:0.5", "--duration", "2"]
    assert run([*command, "--alarm", f'echo "$JAXTWIN_ALARM" > "{called}"']) == 5
    assert called.read_text() == "still-on\n"
    assert "CUT THE POWER" in capsys.readouterr().err


def test_heat_that_is_reported_is_named_also_if_the_user_ends_the_stop_at_once(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    device, stop = VirtualRig(twin), StopRequest()
    stuck(device, [])
    bench = virtual_bench(rig, device, clock)
    with pytest.raises(SafetyStop, match="CUT THE POWER") as no:
        drive(bench, Guard.of(Twin(rig)), SHORT, stop=stop, on_alarm=lambda alarm: stop.set())
    assert no.value.kind == "still-on"


def test_a_run_that_ends_a_trip_and_does_not_start_puts_it_back(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    device = VirtualRig(twin)
    device.stage.trip("watchdog")
    obey = device.stage.obey

    def fails_after_the_reset(command: Duty | Order, now: float) -> Answer | None:
        if isinstance(command, Order) and command.kind == "reset":
            device.twin.ambient = -84.0
        return obey(command, now)

    device.stage.obey = fails_after_the_reset  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(SafetyStop, match="not started: the ambient temperature reads -84"):
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig)), SHORT, reset=True)
    assert device.stage.trip_reason == "stop"


@pytest.mark.slow
def test_a_second_run_on_a_bench_knows_the_rate_of_the_device(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    """Its greeting came before the first run."""
    bench = virtual_bench(rig, VirtualRig(twin, speed=10), clock)
    half = Experiment.schedule("0:0.5", duration=30, cells=2)
    for _ in range(2):
        begin = clock.now()
        drive(bench, Guard.of(Twin(rig)), half)
        # 30 s of the rig, and at most 60 until the readings show that it is off.
        assert 2.5 < (clock.now() - begin) * 1e-9 < 10
