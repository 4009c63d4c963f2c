"""Driving: the schedule is sent, and the cells go off whatever happens."""

import contextlib
import json
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hand_clock import HandClock, stepped_bench, virtual_bench

import jaxtwin as jt
from jaxtwin import JaxtwinError
from jaxtwin.data import data_folder
from jaxtwin.errors import SafetyStop
from jaxtwin.io import Experiment, Session
from jaxtwin.live import (
    Ask,
    Duty,
    Guard,
    InProcess,
    Moment,
    Order,
    OutputStage,
    Recorder,
    SystemClock,
    TcpServer,
    VirtualRig,
    drive,
    encode,
    operate,
    serve,
)
from jaxtwin.live.protocol._output_stage import Answer
from jaxtwin.physics import Faults, Twin
from jaxtwin.rig import Rig

OFF = (0, 0)


def plan(schedule: str, duration: float) -> Experiment:
    return Experiment.schedule(schedule, duration=duration, cells=2)


@pytest.mark.slow
def test_a_schedule_is_driven_in_rig_time_and_ends_with_the_cells_off(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    device = VirtualRig(twin, speed=10)
    applied: list[tuple[float, tuple[int, ...]]] = []
    bench = virtual_bench(rig, device, clock)
    drive(
        bench,
        Guard.of(twin),
        plan("0:0.5,30:0.78/-0.2", 60),
        on_progress=lambda time, pwm: applied.append((time, pwm)),
    )
    assert {pwm for time, pwm in applied if time < 30} == {(128, 128)}
    assert {pwm for time, pwm in applied if time >= 30} == {(199, -51)}
    assert device.pwm == OFF
    assert device.twin.temperatures.max() > 17


@pytest.mark.slow
def test_a_zone_above_the_limit_stops_it(rig: Rig, twin: Twin, clock: HandClock) -> None:
    assert rig.limits is not None
    cautious = replace(rig, limits=replace(rig.limits, temperature=273.15 + 25))
    device = VirtualRig(twin, speed=10)
    guard = Guard.of(Twin(cautious))
    with pytest.raises(SafetyStop, match="the rig's limit is 25; the cells are off"):
        drive(virtual_bench(rig, device, clock), guard, plan("0:1", 1000), accept=True)
    assert device.pwm == OFF
    assert device.twin.temperatures.max() < 27


@pytest.mark.slow
def test_silence_stops_it_and_the_device_stops_itself(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    device = VirtualRig(twin, faults=Faults.parse("stall=8/7"))
    with pytest.raises(SafetyStop, match=r"no (controller sample|temperature) for 3\.\d s|is down"):
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig)), plan("0:1", 60))
    assert device.pwm == OFF


@pytest.mark.slow
def test_a_lost_link_stops_it_for_good(rig: Rig, twin: Twin, clock: HandClock) -> None:
    device = VirtualRig(twin, faults=Faults.parse("disconnect=8"))
    with pytest.raises(SafetyStop, match="is down: cut by a fault"):
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig)), plan("0:1", 60))
    for _ in range(30):
        clock.turn(0.1)
        device.due(clock.now())
    assert device.pwm == OFF


def test_a_device_that_restarts_stops_it(rig: Rig, twin: Twin, clock: HandClock) -> None:
    device = VirtualRig(twin)

    def restart(time: float, pwm: tuple[int, ...]) -> None:
        if time > 2 and device.hello.boot != "another":
            device.hello = replace(device.hello, boot="another")
            device.receive(encode(Ask(2)))

    with pytest.raises(SafetyStop, match="the device on rig has restarted"):
        drive(
            virtual_bench(rig, device, clock),
            Guard.of(Twin(rig)),
            plan("0:1", 60),
            on_progress=restart,
        )
    assert device.pwm == OFF


def test_a_controller_that_does_not_obey_is_reported(
    rig: Rig, twin: Twin, clock: HandClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = VirtualRig(twin)
    obey = device.stage.obey

    def obeys_no_stop(command: Duty | Order, now: float) -> Answer | None:
        if isinstance(command, Order):
            return None
        return obey(command if any(command.pwm) else replace(command, pwm=device.pwm), now)

    monkeypatch.setattr(device.stage, "obey", obeys_no_stop)
    # Its watchdog switches it off once no duty arrives any more.
    with pytest.raises(SafetyStop, match="reported heat 2 s after a stop; the cells are off now"):
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig)), plan("0:1", 2))
    assert (device.pwm, device.stage.trip_reason) == (OFF, "watchdog")


def test_an_exception_switches_off_before_it_goes_on(
    rig: Rig, twin: Twin, clock: HandClock, tmp_path: Path
) -> None:
    device = VirtualRig(twin)

    def fails(time: float, pwm: tuple[int, ...]) -> None:
        if time > 2:
            raise ZeroDivisionError("a bug")

    with Recorder(tmp_path / "session.db", rig, clock=clock) as recorder:
        bench = virtual_bench(rig, device, clock, journal=recorder)
        with pytest.raises(ZeroDivisionError):
            drive(bench, Guard.of(Twin(rig)), plan("0:1", 60), on_progress=fails)
    assert device.pwm == OFF
    with Session(tmp_path / "session.db") as session:
        query = "SELECT content FROM documents WHERE kind = 'stop'"
        (content,) = session.database.execute(query).fetchone()
    assert json.loads(content) == {
        "status": "failed",
        "kind": "ZeroDivisionError",
        "reason": "a bug",
        "off": True,
        "tripped": True,
    }


def test_a_journal_that_fails_does_not_keep_the_cells_on(
    rig: Rig, twin: Twin, clock: HandClock, tmp_path: Path
) -> None:
    device = VirtualRig(twin)
    recorder = Recorder(tmp_path / "session.db", rig, clock=clock)
    bench = virtual_bench(rig, device, clock, journal=recorder)

    def closes(time: float, pwm: tuple[int, ...]) -> None:
        if time > 2:
            recorder.close()  # from now on every write fails, as on a full disk

    with pytest.raises(JaxtwinError, match="closed"):
        drive(bench, Guard.of(Twin(rig)), plan("0:1", 60), on_progress=closes)
    assert device.pwm == OFF


def test_a_set_stop_ends_it_politely(rig: Rig, twin: Twin, clock: HandClock) -> None:
    device, stop = VirtualRig(twin), threading.Event()
    seen = []

    def progress(time: float, pwm: tuple[int, ...]) -> None:
        seen.append(time)
        if time > 5:
            stop.set()

    drive(
        virtual_bench(rig, device, clock),
        Guard.of(Twin(rig)),
        plan("0:1", 60),
        stop=stop,
        on_progress=progress,
    )
    assert 5 < seen[-1] < 6
    assert device.pwm == OFF


def test_a_rig_without_a_limit_is_not_driven(rig: Rig, twin: Twin, clock: HandClock) -> None:
    device = VirtualRig(twin)
    unlimited = replace(rig, limits=None)
    with pytest.raises(JaxtwinError, match=r"limits\.temperature: expected the temperature"):
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(unlimited)), plan("0:1", 60))


def test_a_rig_that_does_not_come_up_is_not_driven(rig: Rig, clock: HandClock) -> None:
    def refused() -> InProcess:
        raise ConnectionRefusedError(111, "refused")

    bench = stepped_bench(rig, {"link": refused}, clock)
    with pytest.raises(SafetyStop, match="not started: after 30 s: link down"):
        drive(bench, Guard.of(Twin(rig)), plan("0:1", 60))


def test_a_device_that_is_refused_is_not_waited_for(rig: Rig, twin: Twin, clock: HandClock) -> None:
    """Not for the 30 s of a rig that may still come up."""
    device = VirtualRig(twin)
    device.hello = replace(device.hello, watchdog=20.0)
    with pytest.raises(
        SafetyStop, match=r"after 3 s: .*watchdog: expected 0\.1 to 5 s .* got 20 s"
    ):
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig)), plan("0:1", 60))
    assert device.pwm == OFF


def test_waiting_for_a_rig_can_be_stopped(rig: Rig, clock: HandClock) -> None:
    def refused() -> InProcess:
        raise ConnectionRefusedError(111, "refused")

    stop = threading.Event()
    stop.set()
    bench = stepped_bench(rig, {"link": refused}, clock)
    with pytest.raises(SafetyStop, match="stopped before the rig was there"):
        drive(bench, Guard.of(Twin(rig)), plan("0:1", 60), stop=stop)


def test_a_limit_in_a_rig_file_is_a_temperature(tmp_path: Path, rig: Rig) -> None:
    assert rig.maximum_temperature == pytest.approx(273.15 + 90)
    text = (data_folder() / "rigs" / "dual-cell.toml").read_text()
    file = tmp_path / "rig.toml"
    file.write_text(text.replace('temperature = "90 degC"', 'temperature = "90 cm"'))
    with pytest.raises(jt.errors.RigError, match=r"limits.temperature: expected .* got '90 cm'"):
        jt.load_rig(file)


DRIVING = """
import sys
import jaxtwin as jt
from jaxtwin.live import Guard, connect, drive
rig = jt.load_rig("dual-cell")
with connect(rig, sys.argv[1]) as bench:
    plan = jt.Experiment.schedule("0:0.5", duration=1000, cells=2)
    drive(bench, Guard.of(jt.Twin(rig)), plan, on_progress=lambda *_: print("on", flush=True))
"""


@pytest.mark.slow
def test_a_trip_stays_until_a_reset_on_purpose(rig: Rig, twin: Twin, clock: HandClock) -> None:
    device = VirtualRig(twin)
    device.stage.trip("watchdog")
    with pytest.raises(SafetyStop, match=r"switched off by itself \(watchdog\); look why") as no:
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig)), plan("0:0.5", 2))
    assert no.value.kind == "device-trip"
    assert (
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(rig)), plan("0:0.5", 2), reset=True)
        == "completed"
    )
    assert (device.pwm, device.stage.trip_reason, device.stage.owner) == (OFF, "", "")


@pytest.mark.slow
def test_an_interlock_leaves_the_device_tripped(rig: Rig, twin: Twin, clock: HandClock) -> None:
    assert rig.limits is not None
    cautious = replace(rig, limits=replace(rig.limits, cell_temperature=273.15 + 40))
    device = VirtualRig(twin)
    with pytest.raises(SafetyStop, match="inside, says the twin; its limit is 40; the cells are"):
        drive(virtual_bench(rig, device, clock), Guard.of(Twin(cautious)), plan("0:1", 1000))
    assert device.stage.trip_reason == "stop"


@pytest.mark.slow
def test_time_before_the_start_does_not_count_as_silence(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    device = VirtualRig(twin)
    bench = virtual_bench(rig, device, clock)
    for _ in range(200):  # more than the bench takes at once
        clock.turn(0.02)
        bench.step_links()
    clock.turn(3.5)  # this process compiles
    assert drive(bench, Guard.of(Twin(rig)), plan("0:0.5", 2)) == "completed"


@pytest.mark.slow
def test_two_drives_do_not_share_a_rig(rig: Rig, twin: Twin, clock: HandClock) -> None:
    device = VirtualRig(twin)
    second = virtual_bench(rig, device, clock)
    refused = []

    def meanwhile(time: float, pwm: tuple[int, ...]) -> None:
        if time > 3 and not refused:
            with pytest.raises(SafetyStop, match=r"another host, .* commands the cells") as stop:
                drive(second, Guard.of(Twin(rig)), plan("0:1", 10))
            refused.append(stop.value.kind)
            assert device.pwm == (128, 128)

    # The second one's waiting takes time, in which the first one sends nothing.
    device.stage = OutputStage(2, 255, 60.0)
    first = virtual_bench(rig, device, clock)
    with contextlib.suppress(SafetyStop):
        drive(first, Guard.of(Twin(rig)), plan("0:0.5", 6), on_progress=meanwhile)
    assert refused == ["commander"]


@pytest.mark.slow
def test_nothing_but_duties_reaches_a_device(rig: Rig, twin: Twin, clock: HandClock) -> None:
    for wrong in ((float("nan"), 0.0), (2.0, 0.0), (0.5,), (0.5, 0.5, 0.5)):
        device = VirtualRig(twin)
        with pytest.raises(JaxtwinError, match="expected 2 numbers from -1 to 1"):
            operate(
                virtual_bench(rig, device, clock), Guard.of(twin), lambda moment, duty=wrong: duty
            )
        assert device.pwm == OFF


def test_a_late_command_does_not_delay_the_next_ones(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    """Each multiple of 0.25 s has its command at the next poll, also where polls are 0.07 s
    apart."""
    device, times = VirtualRig(twin), list[float]()

    def source(moment: Moment) -> tuple[float, float] | None:
        times.append(moment.time)
        return (0.2, 0.2) if moment.time < 5 else None

    openers = {"rig": lambda: InProcess(device, clock)}
    operate(stepped_bench(rig, openers, clock, step=0.07), Guard.of(twin), source)
    late = np.array(times) - 0.25 * np.arange(len(times))
    assert len(times) == 21
    assert 0 <= late.min() <= late.max() < 0.0701


@pytest.mark.slow
def test_a_controller_sees_what_is_measured_and_ends_the_run(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    device, seen = VirtualRig(twin, speed=10), []

    def thermostat(moment: Moment) -> tuple[float, float] | None:
        seen.append(moment)
        on = moment.temperatures.max() < 20.0
        return (1.0 * on, 0.0) if moment.time < 120 else None

    assert operate(virtual_bench(rig, device, clock), Guard.of(twin), thermostat) == "completed"
    assert device.pwm == OFF
    # The driver lags by seven seconds: it overshoots, and does not run away.
    assert 20.0 < max(float(moment.temperatures.max()) for moment in seen) < 30.0
    assert {tuple(moment.duty) for moment in seen} == {(0.0, 0.0), (1.0, 0.0)}
    assert {moment.ambient for moment in seen} == {16.0}


@pytest.mark.slow
def test_after_the_death_of_the_driving_process_the_cells_go_off(twin: Twin) -> None:
    device = VirtualRig(twin, watchdog=0.5)
    server, stop = TcpServer("127.0.0.1:0"), threading.Event()
    thread = threading.Thread(target=serve, args=(device, server, SystemClock(), stop))
    thread.start()
    try:
        process = subprocess.Popen(
            [sys.executable, "-c", DRIVING, server.url],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert process.stdout is not None
        assert process.stdout.readline() == "on\n"
        on = threading.Event()
        while device.pwm == OFF and process.poll() is None:
            on.wait(0.01)
        assert device.pwm == (128, 128)
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        begin = SystemClock().now()
        while device.pwm != OFF and SystemClock().now() - begin < 20e9:
            on.wait(0.01)
        assert device.pwm == OFF
    finally:
        stop.set()
        thread.join()
        server.close()
