"""Control of a rig whose heaters cannot cool."""

import numpy as np
import pytest
from heated_box import AMBIENT, heated_box

from jaxtwin import Twin, reduce_batch, simulate
from jaxtwin.c_export import export_c
from jaxtwin.control import (
    PID,
    Draught,
    FunctionController,
    HeatInput,
    LiveLoop,
    design_lqi,
    design_mpc,
    linearize,
    most_even_point,
    read_controller,
    save_controller,
    simulate_closed_loop,
    simulate_closed_loops,
    tune,
)
from jaxtwin.errors import ControlError, ParameterError, SimulationError
from jaxtwin.io import Experiment
from jaxtwin.physics import plate_map
from jaxtwin.plots import animate_plate, plot_closed_loop, plot_netlist, plot_plate_map
from jaxtwin.rig import Rig

ONE = (
    ('[[heaters]]\nname = "bulb"\npower = "12 W"\ncontacts = ["air"]\n', ""),
    ('{ name = "T_wall", nodes = ["wall"] }', ""),
)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return heated_box(*ONE)


@pytest.fixture(scope="module")
def twin(rig: Rig) -> Twin:
    return Twin(rig)


def controllers(twin: Twin, limits: tuple[float, float] | None = None):
    model = linearize(twin, temperatures=40.0).discretise(2.0)
    return [
        PID(Kp=0.3, Ki=0.002, limits=limits, sample_time_s=2.0),
        design_lqi(model, limits=limits),
        design_mpc(model, limits=limits, horizon=20),
    ]


@pytest.mark.slow
def test_controllers_hold_a_box_and_never_ask_for_cooling(twin: Twin):
    """A step down as well: the box cools by itself, with its heater off."""
    for controller in controllers(twin):
        run = simulate_closed_loop(twin, controller, "0:45,900:35", duration=2400)
        assert run.duty.min() == 0
        assert run.duty.max() <= 1
        assert run.output[run.time == 898, 0] == pytest.approx(45, abs=0.7)
        assert run.output[-1, 0] == pytest.approx(35, abs=0.5)


@pytest.mark.slow
def test_limits_that_are_not_given_are_those_of_heaters(rig: Rig, twin: Twin, tmp_path):
    """A reference that falls far: a controller that expects cooling would wind up meanwhile."""
    for default, given in zip(controllers(twin), controllers(twin, (0, 1)), strict=True):
        assert (default.limits, given.limits) == ((-1, 1), (0, 1))
        runs = [
            simulate_closed_loop(twin, one, "0:60,900:25,1500:40", duration=2400)
            for one in (default, given)
        ]
        np.testing.assert_array_equal(runs[0].duty, runs[1].duty)
        np.testing.assert_array_equal(runs[0].loop.limits, (0, 1))
        files = tmp_path / "default.toml", tmp_path / "given.toml"
        for file, one in zip(files, (default, given), strict=True):
            save_controller(file, one, rig)
        assert files[0].read_text() == files[1].read_text()
        assert "limits = [0.0, 1.0]" in files[0].read_text()
        text = "\n".join(
            line for line in files[0].read_text().splitlines() if not line.startswith("limits")
        )
        files[1].write_text(text)
        assert read_controller(files[1], rig).limits == (0, 1)
        sources = [
            export_c(one, tmp_path / name, rig=rig)
            for name, one in (("default", default), ("given", given))
        ]
        assert sources[0].numbers.read_bytes() == sources[1].numbers.read_bytes()
        assert sources[0].header.read_bytes() == sources[1].header.read_bytes()
    live = LiveLoop(twin, PID(Kp=0.3, sample_time_s=2.0), "0:60", duration=100)
    assert live._controller.limits == (0, 1)


@pytest.mark.slow
def test_tuning_knows_that_heaters_cannot_cool(twin: Twin):
    """Its measures are those of a rig without a plate."""
    pid = PID(Kp=0.1, Ki=0.001, sample_time_s=2.0)
    found = tune(twin, pid, 40, duration=600, rounds=2, starts=1)
    assert found.controller.limits == (0, 1)
    assert "energy" in found.measures
    assert "largest_plate_range" not in found.measures
    with pytest.raises(ControlError, match="objective: largest_plate_range: expected a rig with"):
        tune(twin, pid, 40, duration=600, objective={"largest_plate_range": 1.0})


def test_cells_may_cool_without_limits():
    assert PID(Kp=0.1).for_rig(Twin("dual-cell").rig).limits == (-1, 1)


@pytest.mark.slow
def test_limits_that_ask_heaters_to_cool_are_refused(rig: Rig, twin: Twin, tmp_path):
    message = "expected limits from 0 on, because the heaters of heated box cannot cool"
    for controller in controllers(twin, (-1, 1)):
        with pytest.raises(ControlError, match=message):
            simulate_closed_loop(twin, controller, "0:45", duration=60)
        with pytest.raises(ControlError, match=message):
            export_c(controller, tmp_path / "controller", rig=rig)


@pytest.mark.slow
def test_a_function_that_asks_for_cooling_gets_none(twin: Twin):
    run = simulate_closed_loop(
        twin,
        FunctionController(lambda time, references, measurement: -0.5 + 0 * measurement),
        "0:30",
        duration=20,
    )
    assert run.duty == pytest.approx(0)
    assert run.output == pytest.approx(AMBIENT)


def test_references_below_the_room_are_out_of_reach(twin: Twin):
    pid = PID(Kp=0.05, limits=(0, 1))
    with pytest.raises(ControlError, match=r"expected 20.0 to .* a duty of 0 to 1 can hold"):
        simulate_closed_loop(twin, pid, "0:15", duration=60)


def test_points_of_heaters(twin: Twin):
    """The temperature of the room is held with the heater off; a lower one is out of reach."""
    point = linearize(twin, temperatures=AMBIENT).operating_point
    assert point.duty == pytest.approx([0], abs=1e-9)
    with pytest.raises(ControlError, match="expected some that duty cycles from -1 to 1 reach"):
        linearize(twin, temperatures=15.0)
    with pytest.raises(ControlError, match="of heaters from 0 to 1"):
        linearize(twin, duty=-0.1)


def test_heat_of_a_disturbance_goes_into_bodies(twin: Twin):
    off = FunctionController(lambda time, references, measurement: 0 * measurement)
    hand = HeatInput(("wall",), 0, 100, 20.0)
    run = simulate_closed_loop(twin, off, "0:20", duration=100, disturbances=[hand])
    stored = (run.run.states[-1] - AMBIENT) @ np.array([60.0, 400.0, 25.0])
    assert 0.85 * 2000 < stored < 2000
    with pytest.raises(ControlError, match="expected a rig with a plate, got heated box"):
        simulate_closed_loop(
            twin, off, "0:20", duration=100, disturbances=[Draught(("wall",), 0, 9, 5.0)]
        )


def test_what_shows_a_plate_says_that_there_is_none(rig: Rig, twin: Twin):
    sentence = "expected a rig with a plate, got heated box, which has none"
    run = simulate(twin, Experiment.schedule("0:0.5", duration=20))
    with pytest.raises(ParameterError, match=sentence):
        plate_map(rig, np.zeros(0))
    with pytest.raises(ParameterError, match=sentence):
        plot_plate_map(rig, np.zeros((1, 0)), ["now"])
    with pytest.raises(ParameterError, match=sentence):
        animate_plate(rig, run)
    with pytest.raises(ControlError, match=sentence):
        most_even_point(twin, 40.0)
    with pytest.raises(SimulationError, match="a rig with a plate, got one of heated box"):
        _ = run.plate_uniformity
    with pytest.raises(SimulationError, match=f"reductions: plate_range: {sentence}"):
        reduce_batch(twin, run.experiment, {"P": np.ones(2)}, ["plate_range"])
    pid = PID(Kp=0.05, limits=(0, 1))
    with pytest.raises(ControlError, match=f"largest_plate_range: {sentence}"):
        simulate_closed_loops(
            twin, pid, "0:30", duration=20, draws={"P": np.array([30.0])},
            measures=["largest_plate_range"],
        )  # fmt: skip


@pytest.mark.slow
def test_the_rest_leaves_the_plate_out(twin: Twin):
    run = simulate_closed_loop(twin, PID(Kp=0.05, limits=(0, 1)), "0:30", duration=20)
    assert "largest_plate_range" not in run.measures().index
    assert "energy" in run.measures().index
    plot_closed_loop(run)
    texts = [text.get_text() for text in plot_netlist(twin).texts]
    assert "heater, 30 W" in texts
    assert "3 states, 4 resistances" in texts
    assert "plate_range" not in run.run.to_xarray()
