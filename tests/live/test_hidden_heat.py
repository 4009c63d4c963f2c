"""Heat that no sensor shows: the duty tells the twin how hot the plate is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from folded import Watched
from hand_clock import START, HandClock, virtual_bench

from jaxtwin import JaxtwinError
from jaxtwin.cli import run
from jaxtwin.control import PID, LiveLoop, control
from jaxtwin.errors import SafetyStop
from jaxtwin.io import Experiment
from jaxtwin.live import (
    Finding,
    Guard,
    OperatingLimits,
    Plant,
    Reading,
    RigState,
    Sample,
    VirtualRig,
    drive,
)
from jaxtwin.live.safety._duty_response import DutyResponse
from jaxtwin.live.safety._twin_ensemble import TwinEnsemble
from jaxtwin.live.safety._twin_watch import TwinWatch
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig, Sensors, load_rig
from jaxtwin.simulation import simulate

ROOM, LIMIT = 20.0, 55.0


@pytest.fixture(scope="module")
def low(rig: Rig) -> Twin:
    """A rig with sensors and a limit of 55 degC."""
    assert rig.limits is not None
    limits = replace(rig.limits, temperature=LIMIT + 273.15)
    return Twin(replace(rig, camera=None, sensors=Sensors(0.1), limits=limits))


@pytest.fixture(scope="module")
def draws(low: Twin) -> dict[str, np.ndarray]:
    """The effect of the cells is known to 8 %, as after a match."""
    seebeck = float(low.values["alpha"])
    return {"alpha": seebeck * np.exp(0.08 * np.random.default_rng(0).normal(size=16))}


def stopped(
    low: Twin, share: float, seconds: int, draws: dict[str, np.ndarray] | None, duty: float = 0.7
) -> tuple[Finding | None, float]:
    """What trips a rig whose sensors show a share of their rise, and how hot its plate was."""
    lock = Watched(TwinWatch(low, OperatingLimits.of(low), ROOM, draws))
    plant, random = Plant(low), np.random.default_rng(1)
    plant.start(0.0, ROOM, ROOM)
    counts = (round(255 * duty),) * 2
    for second in range(seconds):
        now = START + second * 10**9
        values = ROOM + share * (plant.temperatures - ROOM) + random.normal(0, 0.1, 15)
        trip = lock.on_record(Reading("l", "b", now, second * 10**6, 0, values, False, None))
        trip = trip or lock.on_record(Sample("l", "b", now, second * 10**6, 0, counts, ROOM))
        if trip is not None:
            return trip, float(plant.nodes[:24].max())
        plant.drive(np.array(counts) / 255)
        plant.advance(second + 1.0)
    return None, float(plant.nodes[:24].max())


@pytest.mark.parametrize("share", [1.0, 0.75, 0.5, 0.25, 0.05])
def test_the_plate_does_not_pass_its_limit_whatever_its_sensors_show(
    low: Twin, draws: dict[str, np.ndarray], share: float
) -> None:
    """With this duty it would reach 90 degC. The sensors themselves are not asked here."""
    for known in (None, draws):
        trip, hottest = stopped(low, share, 600, known)
        assert trip is not None
        assert hottest < LIMIT + 1.0


def test_a_part_that_is_too_hot_by_its_duty_is_named_with_its_probability(
    low: Twin, draws: dict[str, np.ndarray]
) -> None:
    trip, hottest = stopped(low, 0.95, 600, draws)
    assert trip is not None
    assert (trip.kind, trip.severity) == ("predicted-temperature", "critical")
    assert trip.channel in {node.name for node in low.netlist.nodes} | set(low.channels)
    assert "whatever the sensors read; the rig's limit is 55" in trip.detail
    assert trip.probability is not None
    assert 0.1 <= trip.probability < 0.3  # a reading a second
    # Its band reaches the limit before the twin does.
    alone, later = stopped(low, 0.95, 600, None)
    assert alone is not None
    assert hottest < later


def test_the_stop_is_early_enough_for_the_heat_that_the_cells_still_hold(rig: Rig) -> None:
    """Full duty warms the plate so fast that it goes on to warm by 5 K after a stop."""
    assert rig.limits is not None
    limits = replace(rig.limits, temperature=ROOM + 15.0 + 273.15)
    low = Twin(replace(rig, camera=None, sensors=Sensors(0.1), limits=limits))
    lock, plant = Watched(TwinWatch(low, OperatingLimits.of(low), ROOM)), Plant(low)
    plant.start(0.0, ROOM, ROOM)
    trip, at_stop, hottest = None, 0.0, 0.0
    for second in range(60):
        now = START + second * 10**9
        if trip is None:
            at_stop = float(plant.nodes[:24].max())
            read = Reading("l", "b", now, second * 10**6, 0, plant.temperatures, False, None)
            trip = lock.on_record(read)
            trip = trip or lock.on_record(
                Sample("l", "b", now, second * 10**6, 0, (255, 255), ROOM)
            )
        plant.drive(np.full(2, float(trip is None)))
        plant.advance(second + 1.0)
        hottest = max(hottest, float(plant.nodes[:24].max()))
    assert trip is not None
    assert trip.kind == "predicted-temperature"
    assert "now or soon after a stop" in trip.detail
    assert hottest > at_stop + 4.0
    assert ROOM + 12.0 < hottest < ROOM + 16.0, "neither too late nor much too early"


@pytest.mark.parametrize(
    ("name", "heated", "rise"), [("dual-cell", 10, 5.0), ("oven", 120, 10.0), ("tclab", 30, 2.0)]
)
def test_what_a_stop_leaves_is_foreseen(name: str, heated: int, rise: float) -> None:
    """As `simulate` has it, with the driver's delay and lag: seconds on the plate of the two cells,
    minutes in the oven."""
    twin = Twin(load_rig(name))
    ensemble, response, state = TwinEnsemble(twin), DutyResponse(twin, ROOM), RigState()
    counts = (twin.rig.driver.counts,) * len(twin.rig.driven)
    cold = np.full(len(twin.channels), ROOM)
    for time in np.arange(0, heated + 0.5, 0.5):
        now, device_us = START + round(time * 1e9), round(time * 1e6)
        reading = Reading("l", "b", now, device_us, 0, cold, False, None)
        sample = Sample("l", "b", now, device_us, 0, counts, ROOM)
        for record in (reading, sample):
            state = state.after(record)
            response.update(record, state)
            ensemble.follow(response)
    (hottest,) = ensemble.after_stop[1]
    time = np.arange(0, heated + 300.0, 0.5)
    duty = np.repeat((time < heated)[:, None].astype(float), len(counts), axis=1)
    run = simulate(twin, Experiment(time=time, duty=duty, ambient=ROOM), initial=ROOM)
    expected = run.temperatures[time >= heated].max()
    assert hottest.max() == pytest.approx(expected, abs=0.03)
    assert hottest.max() > ensemble.readings.max() + rise


def test_sensors_that_together_show_too_little_are_a_finding(
    low: Twin, draws: dict[str, np.ndarray]
) -> None:
    """A sixth of the duty would warm the plate by 15 K: far below its limit."""
    trip, _ = stopped(low, 0.5, 300, draws, duty=0.25)
    assert trip is not None
    assert trip.kind == "gain"
    assert trip.size == pytest.approx(0.5, abs=0.05)
    assert stopped(low, 1.0, 300, draws, duty=0.25)[0] is None


def test_a_plan_that_must_exceed_the_limit_is_refused_before_it_begins(
    low: Twin, clock: HandClock
) -> None:
    hot = Experiment.schedule("0:0.7", duration=600, cells=2)
    device = VirtualRig(low)
    bench = virtual_bench(low.rig, device, clock)
    with pytest.raises(JaxtwinError, match=r"plan: expected at most 55 degC, the limit of the rig"):
        drive(bench, Guard.of(low), hot)
    assert bench.number == 0, "nothing was sent"
    with pytest.raises(SafetyStop, match=r"has V\d\d at 5\d degC"):
        drive(bench, Guard.of(low), hot, accept=True)
    Guard.of(low).check_plan(Experiment.schedule("0:0.2", duration=600, cells=2))


@pytest.fixture(scope="module")
def pid(low: Twin) -> PID:
    return PID(0.05, 0.001, limits=(0.0, 1.0), measured=[list(low.channels)])


def test_references_that_must_exceed_the_limit_are_refused(
    low: Twin, pid: PID, clock: HandClock
) -> None:
    bench = virtual_bench(low.rig, VirtualRig(low), clock)
    loop = LiveLoop(low, pid, 60.0, duration=60, ambient=ROOM)
    with pytest.raises(JaxtwinError, match=r"plan: expected at most 55 degC, the limit of the rig"):
        control(bench, Guard.of(low, ambient=ROOM), loop)
    assert bench.number == 0, "nothing was sent"
    Guard.of(low, ambient=ROOM).check_plan(
        LiveLoop(low, pid, 40.0, duration=60, ambient=ROOM).simulated_plan()
    )


def test_a_day_at_one_reference_is_simulated_until_the_loop_rests(low: Twin, pid: PID) -> None:
    def plan_of(controller: PID, duration: float) -> Experiment:
        loop = LiveLoop(low, controller, 30.0, duration=duration, ambient=ROOM)
        return loop.simulated_plan()

    assert plan_of(pid, 86_400).duration < 20_000
    slow = PID(0.01, 1e-6, limits=(0.0, 1.0), measured=[list(low.channels)])
    assert plan_of(slow, 20_000).duration >= 20_000, "it creeps on"


@pytest.mark.parametrize(("reference", "near"), [(30.0, False), (41.0, True)])
def test_a_plan_says_whether_a_healthy_rig_may_be_stopped(
    low: Twin, pid: PID, draws: dict[str, np.ndarray], reference: float, near: bool
) -> None:
    """Each of the draws holds the references as a rig. Only of plans that are near the limit is one
    of them stopped."""
    guard = Guard.of(low, ambient=ROOM, draws=draws)

    def plan(twin: Twin) -> Experiment:
        return LiveLoop(twin, pid, reference, duration=1000, ambient=ROOM).simulated_plan()

    hottest = guard.check_plan(plan(low))
    assert hottest is not None
    assert hottest.is_near == near
    assert hottest.name in {node.name for node in low.netlist.nodes} | set(low.channels)
    weakest = low.with_values({"alpha": float(draws["alpha"].min())})
    if near:
        with pytest.raises(
            JaxtwinError, match=r"the limit of the rig, got V\d\d at \d\d ± \d+ degC"
        ):
            guard.check_plan(plan(weakest))
    else:
        guard.check_plan(plan(weakest))


def test_the_command_refuses_it_before_it_connects(
    rig: Rig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "low.toml"
    file.write_text(rig.text.replace('temperature = "90 degC"', 'temperature = "55 degC"'))
    command = ["drive", str(file), "--link", "socket://127.0.0.1:1", "--duty", "0:1"]
    assert run([*command, "--duration", "600"]) == 2
    assert "the interlocks would stop it. Accept that to begin" in capsys.readouterr().err
