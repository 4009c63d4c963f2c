"""A controller on the virtual rig: it holds the reference; the cells go off whatever happens."""

import json
import threading
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from hand_clock import HandClock, virtual_bench

import jaxtwin as jt
from jaxtwin import ControlError, SafetyStop, Twin, linearize
from jaxtwin.cli import run as run_command
from jaxtwin.control import PID, FunctionController, control, save_controller
from jaxtwin.control._control import LiveLoop
from jaxtwin.control._stability import check_stability
from jaxtwin.io import Session
from jaxtwin.live import Faults, Moment, Recorder, SystemClock, TcpServer, VirtualRig, report, serve

OFF = (0, 0)


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.mark.slow
@pytest.mark.parametrize("reads", ["the mean", "every channel"])
def test_the_rig_does_what_the_simulated_loop_did(
    twin: Twin, pid: PID, clock: HandClock, tmp_path: Path, reads: str
):
    """With recalibrations of the same seed, within 0.3 K; each decision is recorded."""
    proportional = FunctionController(lambda t, r, y: 0.2 + 0.05 * (r.mean() - y.mean()))
    controller = pid if reads == "the mean" else proportional
    device = VirtualRig(twin, speed=4, seed=4, faults=Faults.parse("jumps=60"))
    with Recorder(tmp_path / "session.db", twin.rig, clock=clock) as recorder:
        bench = virtual_bench(twin.rig, device, clock, journal=recorder)
        outcome = control(bench, twin, controller, "0:30,100:35", duration_s=200)
    assert outcome == "completed"
    assert device.pwm == OFF
    simulated = jt.simulate_closed_loop(
        twin, controller, "0:30,100:35", duration_s=200, seed=4, faults="jumps=60"
    )
    with Session(tmp_path / "session.db") as session:
        rows = session.database.execute(
            "SELECT content FROM documents WHERE kind = 'decision' ORDER BY id"
        ).fetchall()
        decisions = [json.loads(content) for (content,) in rows]
        found = report(session)
    assert len(found["drives"]) == 1
    times = [decision["time"] for decision in decisions]
    assert len(decisions) > 60
    assert {decision["reference"][0] for decision in decisions} == {30.0, 35.0}
    outputs = simulated.measurement.T
    expected = np.stack([np.interp(times, simulated.time, row) for row in outputs], axis=1)
    measured = np.array([decision["measurement"] for decision in decisions])
    assert measured.shape[1] == (1 if reads == "the mean" else len(twin.channels))
    # Within a second of a recalibration the reading that stands may be the one before or after.
    is_clear = np.mod(np.array(times) + 2, 60) > 4
    np.testing.assert_allclose(measured[is_clear], expected[is_clear], rtol=0, atol=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("faults", "reason"),
    [("stall=20/9", r"no controller sample|is down|no temperature"), ("disconnect=20", "is down")],
)
def test_a_silent_rig_is_off(twin: Twin, pid: PID, clock: HandClock, faults: str, reason: str):
    device = VirtualRig(twin, faults=Faults.parse(faults))
    with pytest.raises(SafetyStop, match=reason):
        control(virtual_bench(twin.rig, device, clock), twin, pid, 40, duration_s=60)
    for _ in range(30):
        clock.turn(0.1)
        device.due(clock.now())
    assert device.pwm == OFF


@pytest.mark.slow
def test_dropped_frames_do_not_stop_it(twin: Twin, pid: PID, clock: HandClock):
    device = VirtualRig(twin, speed=10, faults=Faults.parse("drop=0.2"))
    bench = virtual_bench(twin.rig, device, clock)
    assert control(bench, twin, pid, 30, duration_s=100) == "completed"
    assert device.pwm == OFF
    assert device.twin.temperatures.mean() > 20


@pytest.mark.slow
def test_a_loosened_contact_is_made_up_for(twin: Twin, pid: PID, clock: HandClock):
    """Ten times the contact resistances of a cell: the other cell, and more duty, hold the mean."""
    device = VirtualRig(twin, speed=4, faults=Faults.parse("loosen=P1@60/10"))
    bench = virtual_bench(twin.rig, device, clock)
    assert control(bench, twin, pid, 40, duration_s=300) == "completed"
    assert device.twin.temperatures.mean() == pytest.approx(40, abs=0.5)
    assert device.pwm == OFF


@pytest.mark.slow
def test_a_sensor_without_a_number_switches_a_rig_off(
    clock: HandClock, monkeypatch: pytest.MonkeyPatch
):
    """The interlocks do not wait as long as the controller would. A camera has no NaN to send."""
    twin = Twin("pcr-block")
    device = VirtualRig(twin)
    exact = device._sensors

    def sensors() -> tuple[float, ...]:
        return exact() if device.twin.time < 10 else (np.nan, *exact()[1:])

    monkeypatch.setattr(device, "_sensors", sensors)
    with pytest.raises(SafetyStop, match="T_left has failed: nan"):
        control(virtual_bench(twin.rig, device, clock), twin, PID(0.02), 40, duration_s=60)
    clock.turn(1.0)
    device.due(clock.now())
    assert device.pwm == OFF
    assert device.twin.time < 13


def test_a_reading_without_a_number_holds_the_last_one_and_then_stops(
    twin: Twin, pid: PID, clock: HandClock
):
    """As the simulated loop does, whose cells are off after as long."""
    bench = virtual_bench(twin.rig, VirtualRig(twin), clock)
    loop, again = (LiveLoop(bench, twin, pid, 40, duration_s=60) for _ in range(2))
    good, bad = np.full(15, 20.0), np.full(15, 20.0)
    bad[3] = np.nan
    off = np.zeros(2)
    np.testing.assert_array_equal(loop(Moment(0.0, bad, off, None)), off)  # nothing was read yet
    for time in (1.0, 2.0):
        loop(Moment(time, good, off, None))
        again(Moment(time, good, off, None))
    for time in (3.0, 4.0, 5.0):
        held = loop(Moment(time, bad, off, None))
        expected = again(Moment(time, good, off, None))
        np.testing.assert_allclose(np.asarray(held), np.asarray(expected))
    with pytest.raises(SafetyStop, match=r"no reading of what it controls for 4\.0 s"):
        loop(Moment(6.0, bad, off, None))


@pytest.mark.slow
@pytest.mark.parametrize("asked", [np.nan, np.inf])
def test_a_duty_that_is_none_switches_off(twin: Twin, clock: HandClock, asked: float):
    device = VirtualRig(twin)
    wrong = FunctionController(lambda t, r, y: 0.5 + asked * (t > 5))
    with pytest.raises(SafetyStop, match="the controller asked for duty"):
        control(virtual_bench(twin.rig, device, clock), twin, wrong, 40, duration_s=60)
    assert device.pwm == OFF


def test_a_reference_out_of_reach_is_refused_before_anything_is_sent(
    twin: Twin, pid: PID, clock: HandClock
):
    device = VirtualRig(twin)
    with pytest.raises(ControlError, match=r"the duty can hold, got 300\.0 degC"):
        control(virtual_bench(twin.rig, device, clock), twin, pid, 300, duration_s=60)
    assert device.pwm == OFF


@pytest.mark.slow
def test_a_loop_that_is_not_stable_is_refused_before_there_is_a_connection_or_a_file(
    twin: Twin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """Nobody listens at this link."""
    save_controller(tmp_path / "wild.toml", PID(1.0, 0.01, limits=(0, 1)), twin.rig)
    words = ["control", "dual-cell", "--link", "socket://127.0.0.1:9", "--reference", "0:40"]
    words += ["--controller", str(tmp_path / "wild.toml"), "--out", str(tmp_path / "run.db")]
    assert run_command(words) == 2
    assert "deviations from 40 degC that grow e-fold in" in capsys.readouterr().err
    assert not (tmp_path / "run.db").exists()


@pytest.mark.slow
def test_deviations_grow_in_the_simulated_loop_as_the_check_says(twin: Twin):
    """The nonlinear twin, at rest by a small gain for 150 s, then with one beyond the margin."""
    weights = np.full((1, len(twin.channels)), 1 / len(twin.channels))
    reference = np.array([[40.0]])
    check_stability(twin, PID(0.3), weights, reference)
    with pytest.raises(ControlError, match="grow e-fold in") as refused:
        check_stability(twin, PID(0.5), weights, reference)
    said = float(str(refused.value).split("e-fold in ")[1].split(" s")[0])
    rest = linearize(twin, temperatures=40.0).operating_point
    proportional = FunctionController(
        lambda t, r, y: np.asarray(rest.duty) + jnp.where(t < 150, 0.1, 0.5) * (r.mean() - y.mean())
    )
    run = jt.simulate_closed_loop(
        twin,
        proportional,
        40,
        duration_s=400,
        initial=np.asarray(rest.nodes),
        noise=False,
        quantised=False,
    )
    mean = run.run.temperatures.mean(axis=1)
    slope = np.diff(mean)
    turns = 1 + np.flatnonzero(slope[1:] * slope[:-1] < 0)
    swing, time = np.abs(np.diff(mean[turns])), run.time[turns[1:]]
    is_free = (time > 180) & (swing < 0.5)  # far from the limits of the duty
    assert is_free.sum() > 6
    rate = np.polyfit(time[is_free], np.log(swing[is_free]), 1)[0]
    assert 1 / rate == pytest.approx(said, rel=0.1)


@pytest.mark.slow
def test_the_command_controls_a_rig_over_tcp(
    twin: Twin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    save_controller(tmp_path / "pid.toml", PID(0.1, 0.001), twin.rig)
    server, stop = TcpServer("127.0.0.1:0"), threading.Event()
    device = VirtualRig(twin)
    thread = threading.Thread(target=serve, args=(device, server, SystemClock(), stop))
    thread.start()
    words = ["control", "dual-cell", "--link", server.url, "--reference", "0:30"]
    words += ["--controller", str(tmp_path / "pid.toml")]
    try:
        code = run_command([*words, "--duration", "4", "--out", str(tmp_path / "run.db")])
        assert code == 0
        assert "the cells are off" in capsys.readouterr().out
        assert device.pwm == OFF
        text = (tmp_path / "pid.toml").read_text().replace("dual-cell", "another")
        (tmp_path / "pid.toml").write_text(text)
        assert run_command(words) == 2
        assert "expected a controller for 'dual-cell'" in capsys.readouterr().err
    finally:
        stop.set()
        thread.join()
        server.close()
    with Session(tmp_path / "run.db") as session:
        (content,) = session.database.execute(
            "SELECT content FROM documents WHERE kind = 'start'"
        ).fetchone()
    assert json.loads(content)["control"]["references"] == "0:30"
