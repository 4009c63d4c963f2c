"""NonlinearMPC: its plan is the optimum of the twin itself, and a loop comes to rest without
offset."""

from typing import Any

import jax
import numpy as np
import pytest
from jax import Array
from scipy.optimize import least_squares

from jaxtwin import Stepper, Twin, export_c, linearize, simulate_closed_loop, simulate_closed_loops
from jaxtwin.control import (
    MPC,
    HeatInput,
    LiveLoop,
    NonlinearMPC,
    design_mpc,
    design_nonlinear_mpc,
    loop_margins,
    save_controller,
)
from jaxtwin.errors import ControlError

BOTH = ("TAM", "TCM")


@pytest.fixture(scope="module")
def cell() -> Twin:
    """A rig of four nodes whose cell heats and cools."""
    return Twin("single-cell")


def first(controller: MPC | NonlinearMPC, duty: float, measured: float, reference: float) -> Any:
    """The first duty after a rest, and the state after it."""

    @jax.jit
    def step(u: Array, y: Array, r: Array) -> tuple[Array, Any]:
        return controller.step(controller.init(u, y), r, y)

    with jax.enable_x64(True):
        return jax.tree.map(
            np.asarray, step(np.full(1, duty), np.full(1, measured), np.full(1, reference))
        )


@pytest.mark.slow
def test_the_plan_is_the_optimum_of_the_twin(cell: Twin):
    """Scipy's least squares over `Stepper`, with derivatives by differences: the same residuals,
    written a second time."""
    controller = design_nonlinear_mpc(
        cell, horizon=4, sample_time_s=10.0, limits=(0, 0.9), iterations=12, output_deviation=0.5
    )
    room = float(cell.values["T_amb"])
    duty, later = first(controller, 0.0, room, room + 40.0)
    plan = np.concatenate([np.ravel(duty), np.ravel(later.path.duty)[:-1]])
    stepper = Stepper(cell, 10.0 / controller.steps)
    start = stepper.start(room, [0.0])

    def residuals(moves: np.ndarray) -> np.ndarray:
        state, errors = start, []
        for move in moves:
            state = stepper.step(state, [move], steps=controller.steps)
            errors.append((float(stepper.channels(state)[0]) - room - 40.0) / 0.5)
        return np.concatenate([errors, np.diff(moves, prepend=0) / 0.05])

    bounds = (np.zeros(4), np.full(4, 0.9))
    best = least_squares(residuals, np.full(4, 0.5), bounds=bounds, xtol=1e-12, ftol=1e-12)
    np.testing.assert_allclose(plan, best.x, atol=2e-5)
    assert plan.min() > 0.05


@pytest.mark.slow
def test_near_its_operating_point_it_does_what_the_linear_mpc_does(cell: Twin):
    """Half a kelvin from rest at 50 degC. The linear one has its horizon without an end, of which
    the samples beyond 300 s matter little."""
    given: dict[str, Any] = {"horizon": 30, "limits": (0, 1)}
    model = linearize(cell, temperatures=50.0).discretise(10.0)
    linear = design_mpc(model, duty_deviation=1e3, **given)
    nonlinear = design_nonlinear_mpc(cell, sample_time_s=10.0, **given)
    duty = float(np.asarray(model.operating_point.duty)[0])
    one, _ = first(linear, duty, 50.0, 50.5)
    other, _ = first(nonlinear, duty, 50.0, 50.5)
    assert one[0] - duty > 0.001
    assert other[0] - duty == pytest.approx(one[0] - duty, rel=0.03)


@pytest.mark.slow
def test_it_takes_over_without_a_jump(cell: Twin):
    """At any reading, which unknown heat then explains."""
    duty, _ = first(design_nonlinear_mpc(cell, horizon=5, limits=(0, 1)), 0.3, 40.0, 40.0)
    assert duty[0] == pytest.approx(0.3, abs=1e-8)


@pytest.mark.slow
def test_unknown_heat_leaves_no_offset(cell: Twin):
    """5 W into the load, and a twin whose sink is twice as good as the rig's."""
    wrong = cell.with_values({"R_sink": 0.5 * float(cell.values["R_sink"])})
    controller = design_nonlinear_mpc(wrong, horizon=20, sample_time_s=5.0, limits=(-1, 1))
    heat = HeatInput((cell.netlist.nodes[0].name,), 300.0, 900.0, 5.0)
    run = simulate_closed_loop(
        cell, controller, 50.0, duration=900, disturbances=[heat], noise=False
    )
    before, end = run.output[run.time < 299][-1], run.output[-1]
    np.testing.assert_allclose([before[0], end[0]], 50.0, atol=0.15)


@pytest.mark.slow
def test_limits_of_the_duty_its_rate_and_a_temperature_hold(cell: Twin):
    """The reference lies behind the limit of the same channel."""
    limits: Any = {cell.channels[0]: (0, 45)}
    controller = design_nonlinear_mpc(
        cell,
        horizon=20,
        sample_time_s=5.0,
        limits=(0, 0.6),
        rate_limit=0.01,
        temperature_limits=limits,
        excess_deviation=0.02,
    )
    run = simulate_closed_loop(cell, controller, 50.0, duration=600, noise=False)
    assert run.duty.min() >= 0
    assert run.duty.max() <= 0.6
    assert np.abs(np.diff(run.duty[:, 0])).max() <= 0.05 + 1e-12
    assert run.output.max() < 45.2
    assert run.output[-1, 0] == pytest.approx(45.0, abs=0.1)


@pytest.mark.slow
def test_a_plate_is_cooled_from_idle_cells(cell: Twin):
    """At a duty of 0 the heat of a cell has a kink, at which JAX gives its slope as 0."""
    controller = design_nonlinear_mpc(cell, horizon=20, sample_time_s=5.0)
    run = simulate_closed_loop(cell, controller, 10.0, duration=400, noise=False)
    assert run.duty.min() < -0.1
    assert run.output[-1, 0] == pytest.approx(10.0, abs=0.05)


@pytest.mark.slow
def test_draws_of_the_twin_are_controlled_side_by_side(cell: Twin):
    """The loop of each draw is the one that it has alone."""
    controller = design_nonlinear_mpc(cell, horizon=5, sample_time_s=10.0, limits=(0, 1))
    sinks = [0.8, 1.2] * np.asarray(cell.values["R_sink"])
    given: dict[str, Any] = {"duration": 100, "noise": False}
    loops = simulate_closed_loops(cell, controller, 50.0, draws={"R_sink": sinks}, **given)
    assert not loops.failed.any()
    for number, sink in enumerate(sinks):
        rig = cell.with_values({"R_sink": sink})
        alone = simulate_closed_loop(rig, controller, 50.0, **given).measures()["value"]
        together = loops["integral_absolute_error"][number]
        assert together == pytest.approx(alone["integral_absolute_error"], rel=1e-6)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"horizon": 1, "sample_time_s": 2.0}, "more samples than the driver's delay of 2 s"),
        ({"measured": ["T99"]}, "T99"),
        ({"temperature_limits": {"T99": (0, 50)}}, "temperature_limits: .*T99"),
        ({"temperature_limits": {"TAM": (50, 40)}}, "the lowest and the highest temperature"),
        ({"limits": (0.5, 0.2)}, "limits: expected the lowest and the highest duty"),
        ({"measured": ["T11", "T12", "T13"]}, "at most as many outputs as the 2 cells"),
        ({"iterations": 0}, "iterations"),
        ({"control_horizon": 31}, "at most the horizon"),
        ({"output_deviation": -1.0}, "output_deviation"),
        ({"rate_limit": 0.0}, "rate_limit"),
    ],
)
def test_what_has_no_meaning_is_refused(twin: Twin, settings: dict[str, Any], message: str):
    given: dict[str, Any] = {"measured": BOTH} | settings
    with pytest.raises(ControlError, match=message) as refused:
        design_nonlinear_mpc(twin, **given)
    assert "\n" not in str(refused.value)


@pytest.mark.slow
def test_it_belongs_to_its_rig_and_has_neither_file_nor_c(cell: Twin, twin: Twin, tmp_path: Any):
    controller = design_nonlinear_mpc(cell, horizon=3)
    with pytest.raises(ControlError, match="of dual-cell, got one designed on a model of single"):
        simulate_closed_loop(twin, controller, 40, duration=100)
    with pytest.raises(ControlError, match="NonlinearMPC has no C"):
        export_c(controller, tmp_path / "c", rig=cell.rig)
    with pytest.raises(ControlError, match="NonlinearMPC"):
        save_controller(tmp_path / "controller.toml", controller, cell.rig)
    with pytest.raises(ControlError, match="linear within its limits"):
        loop_margins(cell, controller, 40.0)
    assert LiveLoop(cell, controller, "0:30", duration=60)
