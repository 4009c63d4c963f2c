"""A controller on the virtual rig: it holds the reference; the cells go off whatever happens."""

import contextlib
import json
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from hand_clock import HandClock, virtual_bench
from patient_clock import PatientClock

import jaxtwin as jt
from jaxtwin import Twin, linearize
from jaxtwin.cli import run as run_command
from jaxtwin.control import (
    PID,
    AbstractController,
    DecoupledPI,
    ExceededLimit,
    FunctionController,
    LiveLoop,
    Relay,
    control,
    design_lqi,
    design_mpc,
    read_controller,
    save_controller,
    ultimate_point,
)
from jaxtwin.control.loops._loop_margins import check_stability
from jaxtwin.errors import ControlError, SafetyStop
from jaxtwin.io import Session
from jaxtwin.live import (
    Clock,
    Guard,
    Moment,
    Recorder,
    RigConnection,
    SystemClock,
    TcpServer,
    VirtualRig,
    connect,
    report,
    serve,
)
from jaxtwin.physics import Faults
from jaxtwin.rig import Rig

OFF = (0, 0)


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.mark.slow
@pytest.mark.parametrize(
    "reads", ["the mean", pytest.param("every channel", marks=pytest.mark.long)]
)
def test_the_rig_does_what_the_simulated_loop_did(
    twin: Twin, pid: PID, clock: HandClock, tmp_path: Path, reads: str
):
    """With recalibrations of the same seed, within 0.3 K; each decision is recorded."""
    proportional = FunctionController(lambda t, r, y: 0.2 + 0.05 * (r.mean() - y.mean()))
    controller = pid if reads == "the mean" else proportional
    device = VirtualRig(twin, speed=4, seed=4, faults=Faults.parse("jumps=40"))
    with Recorder(tmp_path / "session.db", twin.rig, clock=clock) as recorder:
        bench = virtual_bench(twin.rig, device, clock, journal=recorder)
        outcome = control(
            bench, Guard.of(twin), LiveLoop(twin, controller, "0:30,60:35", duration=120)
        )
    assert outcome == "completed"
    assert device.pwm == OFF
    simulated = jt.simulate_closed_loop(
        twin, controller, "0:30,60:35", duration=120, seed=4, faults="jumps=40"
    )
    with Session(tmp_path / "session.db") as session:
        decisions = decisions_in(session)
        found = report(session)
    assert len(found["drives"]) == 1
    times = [decision["time"] for decision in decisions]
    assert len(decisions) > 36
    assert {decision["reference"][0] for decision in decisions} == {30.0, 35.0}
    outputs = simulated.measurement.T
    expected = np.stack([np.interp(times, simulated.time, row) for row in outputs], axis=1)
    measured = np.array([decision["measurement"] for decision in decisions])
    assert measured.shape[1] == (1 if reads == "the mean" else len(twin.channels))
    # Within a second of a recalibration the reading that stands may be the one before or after.
    is_clear = np.mod(np.array(times) + 2, 40) > 4
    np.testing.assert_allclose(measured[is_clear], expected[is_clear], rtol=0, atol=0.3)


def decisions_in(session: Session) -> list[dict[str, Any]]:
    """What the controller of a recorded run decided, in order."""
    rows = session.database.execute(
        "SELECT content FROM documents WHERE kind = 'decision' ORDER BY id"
    ).fetchall()
    return [json.loads(content) for (content,) in rows]


@contextlib.contextmanager
def served(device: VirtualRig, clock: Clock) -> Iterator[str]:
    """The address of a TCP port at which a virtual rig is reached meanwhile."""
    server, stop = TcpServer("127.0.0.1:0"), threading.Event()
    thread = threading.Thread(target=serve, args=(device, server, clock, stop), name="rig")
    thread.start()
    try:
        yield server.url
    finally:
        stop.set()
        thread.join()
        server.close()


@pytest.mark.slow
def test_a_rig_over_tcp_does_what_the_simulated_loop_did(twin: Twin, pid: PID, tmp_path: Path):
    """Each channel of each frame within 0.3 K, with a step of the reference and the same seed."""
    speed, schedule = 4, "0:30,60:35"
    simulated = jt.simulate_closed_loop(twin, pid, schedule, duration=120, seed=4).run
    device = VirtualRig(twin, speed=speed, seed=4)
    clock = PatientClock("rig", threading.current_thread().name)
    with (
        served(device, clock) as url,
        Recorder(tmp_path / "session.db", twin.rig, clock=clock) as recorder,
        connect(twin.rig, url, journal=recorder, clock=clock) as bench,
    ):
        outcome = control(bench, Guard.of(twin), LiveLoop(twin, pid, schedule, duration=120))
    assert outcome == "completed"
    assert device.pwm == OFF
    with Session(tmp_path / "session.db") as session:
        decisions = session.database.execute(
            "SELECT arrival, content FROM documents WHERE kind = 'decision'"
        ).fetchall()
        readings = np.array(session.database.execute("SELECT * FROM readings").fetchall(), float)
    arrival, device_us, channels = readings[:, 2], readings[:, 3], readings[:, 6:]
    # The device's time, less that at which the run began; the fastest message had no delay.
    began = np.median([at * 1e-9 * speed - json.loads(said)["time"] for at, said in decisions])
    time = device_us * 1e-6 + np.min(arrival * 1e-9 * speed - device_us * 1e-6) - began
    is_driven = (time >= 0) & (time <= 120)
    assert is_driven.sum() > 9 * 110  # frames a second
    rows = simulated.temperatures.T
    expected = np.array([np.interp(time[is_driven], simulated.time, row) for row in rows]).T
    np.testing.assert_allclose(channels[is_driven], expected, rtol=0, atol=0.3)
    assert expected[-1].mean() > 34  # the loop has followed both references


@pytest.mark.slow
@pytest.mark.parametrize(
    ("faults", "reason"),
    [("stall=20/9", r"no controller sample|is down|no temperature"), ("disconnect=20", "is down")],
)
def test_a_rig_without_readings_is_switched_off(
    twin: Twin, pid: PID, clock: HandClock, faults: str, reason: str
):
    device = VirtualRig(twin, faults=Faults.parse(faults))
    with pytest.raises(SafetyStop, match=reason):
        control(
            virtual_bench(twin.rig, device, clock),
            Guard.of(twin),
            LiveLoop(twin, pid, 40, duration=60),
        )
    for _ in range(30):
        clock.turn(0.1)
        device.due(clock.now())
    assert device.pwm == OFF


@pytest.mark.slow
def test_dropped_frames_do_not_stop_a_run(twin: Twin, pid: PID, clock: HandClock):
    device = VirtualRig(twin, speed=10, faults=Faults.parse("drop=0.2"))
    bench = virtual_bench(twin.rig, device, clock)
    assert control(bench, Guard.of(twin), LiveLoop(twin, pid, 30, duration=100)) == "completed"
    assert device.pwm == OFF
    assert device.twin.temperatures.mean() > 20


@pytest.mark.long
def test_the_mean_stays_within_half_a_kelvin_with_a_loosened_contact(
    twin: Twin, pid: PID, clock: HandClock
):
    """Ten times the contact resistances of a cell: the other cell, and more duty, hold the mean."""
    device = VirtualRig(twin, speed=4, faults=Faults.parse("loosen=P1@60/10"))
    bench = virtual_bench(twin.rig, device, clock)
    assert control(bench, Guard.of(twin), LiveLoop(twin, pid, 40, duration=300)) == "completed"
    assert device.twin.temperatures.mean() == pytest.approx(40, abs=0.5)
    assert device.pwm == OFF


@pytest.mark.slow
def test_a_nan_of_a_sensor_switches_the_cells_off_before_the_controller_would(
    clock: HandClock, monkeypatch: pytest.MonkeyPatch
):
    """The interlocks do not wait as long as the controller would. A camera has no NaN to send."""
    twin = Twin("pcr-block")
    device = VirtualRig(twin)
    exact = device._sensors

    def sensors() -> tuple[float, ...]:
        return exact() if device.twin.time < 10 else (np.nan, *exact()[1:])

    monkeypatch.setattr(device, "_sensors", sensors)
    ended: list[float] = []
    with pytest.raises(SafetyStop, match="T_left has failed: nan"):
        control(
            virtual_bench(twin.rig, device, clock),
            Guard.of(twin),
            LiveLoop(twin, PID(0.02), 40, duration=60),
            on_end=lambda ending: ended.append(device.twin.time),
        )
    clock.turn(1.0)
    device.due(clock.now())
    assert device.pwm == OFF
    assert ended[0] < 13


GROUPS = (("T11", "T12", "TAM"), ("T15", "T16", "TCM"))


def of_kind(twin: Twin, kind: str) -> AbstractController:
    """A controller of each kind."""
    both: Any = {"measured": GROUPS, "limits": (0, 1)}
    if kind in ("LQI", "MPC", "MPC with preview"):
        model = linearize(twin, duty=0.3).reduce(3).discretise(1.0)
        if kind == "LQI":
            return design_lqi(model, duty_deviation=0.5, **both)
        return design_mpc(model, horizon=8, preview=kind == "MPC with preview", **both)
    return {
        "PID": PID(0.1, 0.001, 0.1, 5.0),
        "DecoupledPI": DecoupledPI(0.05, 0.0005, 0.05, 0.0005, **both),
        "Relay": Relay(0.1, 0.3, 0.05),
        "function": FunctionController(lambda t, r, y: 0.2 + 0.02 * (r - y).mean()),
    }[kind]


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [
        "PID",
        "DecoupledPI",
        "LQI",
        pytest.param("MPC", marks=pytest.mark.long),
        "MPC with preview",
        "Relay",
        "function",
    ],
)
def test_a_live_controller_decides_as_in_the_simulated_loop(twin: Twin, kind: str):
    """Given the readings of the simulated loop, with the references that it was given there."""
    controller, schedule = of_kind(twin, kind), "0:20,15:23"
    settings: dict[str, Any] = {"noise": False, "quantised": False}
    run = jt.simulate_closed_loop(twin, controller, schedule, duration=40, **settings)
    loop = LiveLoop(twin, controller, schedule, duration=40)
    off, new = np.zeros(2), np.zeros(len(twin.channels))
    decided = [
        loop(Moment(float(time), temperatures, new, off, None))
        for time, temperatures in zip(run.time[:-1], run.run.temperatures[:-1], strict=True)
    ]
    np.testing.assert_allclose(np.array(decided), run.duty[:-1], rtol=0, atol=1e-6)
    if kind == "MPC with preview":
        early = run.duty[14] - run.duty[5]
        assert np.all(early > 0.05)  # the step of the reference is a second away


@pytest.mark.slow
def test_an_mpc_with_preview_from_a_file_runs_on_a_rig(
    twin: Twin, clock: HandClock, tmp_path: Path
):
    """The heat is on before the reference has changed, and the run ends with the cells off."""
    save_controller(tmp_path / "mpc.toml", of_kind(twin, "MPC with preview"), twin.rig)
    device = VirtualRig(twin, speed=4)
    with Recorder(tmp_path / "session.db", twin.rig, clock=clock) as recorder:
        bench = virtual_bench(twin.rig, device, clock, journal=recorder)
        mpc = read_controller(tmp_path / "mpc.toml", twin.rig)
        outcome = control(bench, Guard.of(twin), LiveLoop(twin, mpc, "0:16,40:20", duration=60))
    assert outcome == "completed"
    assert device.pwm == OFF
    with Session(tmp_path / "session.db") as session:
        decisions = decisions_in(session)
    duty = {
        kind: [d["duty"] for d in decisions if low <= d["time"] < high]
        for kind, low, high in (("rest", 5, 31), ("before", 38, 40))
    }
    assert np.max(duty["rest"]) < 0.05
    assert np.min(np.max(duty["before"], axis=0)) > 0.1
    assert {d["reference"][0] for d in decisions if d["time"] < 39.5} == {16.0}


@pytest.mark.slow
def test_a_limit_that_readings_exceed_is_kept_with_its_largest_excess_and_its_times(twin: Twin):
    model = linearize(twin, temperatures={"TAM": 30.0, "TCM": 30.0}).reduce(4).discretise(1.0)
    limits: Any = {"T11": (0, 25)}
    mpc = design_mpc(model, measured=["TAM", "TCM"], limits=(0, 1), temperature_limits=limits)
    loop = LiveLoop(twin, mpc, 30, duration=60)
    readings, new, off = np.full(15, 24.0), np.zeros(15), np.zeros(2)
    for time, T11 in enumerate([24.0, 26.0, 28.0, 26.5, 24.0]):
        readings[twin.channels.index("T11")] = T11
        loop(Moment(float(time), readings.copy(), new, off, None))
    assert loop.exceeded == (ExceededLimit("T11", 25.0, 3.0, 1.0, 3.0),)


@pytest.mark.slow
def test_a_reading_without_a_number_holds_the_last_one_and_then_stops(twin: Twin, pid: PID):
    """As the simulated loop does, whose cells are off after as long."""
    loop, again = (LiveLoop(twin, pid, 40, duration=60) for _ in range(2))
    values, new, off = np.full(15, 20.0), np.zeros(15), np.zeros(2)
    never = np.where(np.arange(15) == 3, np.nan, values)  # channel 3 has not been read yet
    np.testing.assert_array_equal(loop(Moment(0.0, never, new, off, None)), off)
    for time in (1.0, 2.0):
        loop(Moment(time, values, new, off, None))
        again(Moment(time, values, new, off, None))
    old = np.zeros(15)
    for time in (3.0, 4.0, 5.0):
        old[3] = time - 2.0
        held = loop(Moment(time, values, old, off, None))
        expected = again(Moment(time, values, new, off, None))
        np.testing.assert_allclose(np.asarray(held), np.asarray(expected))
    old[3] = 4.0
    with pytest.raises(SafetyStop, match=r"no reading that it uses for 4\.0 s"):
        loop(Moment(6.0, values, old, off, None))


@pytest.mark.slow
def test_an_old_reading_of_what_is_not_controlled_stops_nothing(twin: Twin):
    loop = LiveLoop(twin, PID(0.1, measured=["TAM"]), 40, duration=60)
    old = np.where(np.array(twin.channels) == "TAM", 0.0, 100.0)
    assert loop(Moment(1.0, np.full(15, 20.0), old, np.zeros(2), None)) is not None


@pytest.mark.slow
@pytest.mark.parametrize("asked", [np.nan, np.inf])
def test_a_duty_that_is_not_finite_switches_the_cells_off(
    twin: Twin, clock: HandClock, asked: float
):
    device = VirtualRig(twin)
    wrong = FunctionController(lambda t, r, y: 0.5 + asked * (t > 5))
    with pytest.raises(SafetyStop, match="the controller asked for duty"):
        control(
            virtual_bench(twin.rig, device, clock),
            Guard.of(twin),
            LiveLoop(twin, wrong, 40, duration=60),
            accept=True,  # otherwise it is refused, because its loop on the twin fails alike
        )
    assert device.pwm == OFF


@pytest.mark.slow
def test_a_reference_out_of_reach_is_refused_before_anything_is_sent(
    twin: Twin, pid: PID, clock: HandClock
):
    device = VirtualRig(twin)
    with pytest.raises(ControlError, match=r"can hold, got 300\.0 degC"):
        control(
            virtual_bench(twin.rig, device, clock),
            Guard.of(twin),
            LiveLoop(twin, pid, 300, duration=60),
        )
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


@pytest.mark.long
def test_a_relay_on_a_rig_finds_what_it_finds_in_the_simulated_loop(
    twin: Twin,
    clock: HandClock,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    """The ultimate gain to 5 %, the period to a sample. What is printed are fields of a file."""
    relay = Relay(0.15, 0.22, 0.1, limits=(0, 1))
    save_controller(tmp_path / "relay.toml", relay, twin.rig)
    device = VirtualRig(twin, speed=4, seed=2)

    def connected(
        rig: Rig, *urls: str, journal: Recorder | None, baud: int
    ) -> contextlib.AbstractContextManager[RigConnection]:
        # Not entered, because that would start a thread that reads the link besides.
        return contextlib.nullcontext(virtual_bench(rig, device, clock, journal=journal))

    monkeypatch.setattr("jaxtwin.live.connect", connected)
    words = ["control", "dual-cell", "--link", "socket://127.0.0.1:1", "--reference", "0:30"]
    words += ["--controller", str(tmp_path / "relay.toml"), "--duration"]
    assert run_command([*words, "300"]) == 0
    said = capsys.readouterr().out
    assert device.pwm == OFF
    simulated = ultimate_point(jt.simulate_closed_loop(twin, relay, 30, duration=300, seed=2))
    found = re.search(r"ultimate gain (\S+) 1/K, period (\S+) s", said)
    assert found is not None
    assert float(found[1]) == pytest.approx(simulated.gain, rel=0.05)
    assert float(found[2]) == pytest.approx(simulated.period_s, abs=1)
    of_all = ["format = 1", 'rig = "dual-cell"', 'kind = "pid"', 'sample_time = "1 s"']
    (tmp_path / "pid.toml").write_text("\n".join([*of_all, said[said.index("Kp") :]]))
    pid, expected = read_controller(tmp_path / "pid.toml", twin.rig), simulated.pid()
    assert isinstance(pid, PID)
    for name in ("Kp", "Ki", "Kd", "Tf"):
        np.testing.assert_allclose(getattr(pid, name), getattr(expected, name), rtol=0.1)

    assert run_command([*words, "60"]) == 2
    assert "at least 3 whole periods of the relay" in capsys.readouterr().err
    assert device.pwm == OFF


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
        duration=400,
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
    device = VirtualRig(twin)
    with served(device, SystemClock()) as url:
        words = ["control", "dual-cell", "--link", url, "--reference", "0:30"]
        words += ["--controller", str(tmp_path / "pid.toml")]
        code = run_command([*words, "--duration", "4", "--out", str(tmp_path / "run.db")])
        assert code == 0
        assert "the cells are off" in capsys.readouterr().out
        assert device.pwm == OFF
        text = (tmp_path / "pid.toml").read_text().replace("dual-cell", "another")
        (tmp_path / "pid.toml").write_text(text)
        assert run_command(words) == 2
        assert "expected a controller for 'dual-cell'" in capsys.readouterr().err
    with Session(tmp_path / "run.db") as session:
        (content,) = session.database.execute(
            "SELECT content FROM documents WHERE kind = 'start'"
        ).fetchone()
    assert json.loads(content)["control"]["references"] == "0:30"
