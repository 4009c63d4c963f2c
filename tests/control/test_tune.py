"""Tuning: exact derivatives, a search that finds what is known, limits that hold for every draw."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin import Twin
from jaxtwin._jax_settings import own_settings
from jaxtwin.control import (
    LQI,
    MPC,
    PID,
    StateSpace,
    Tuning,
    design_lqi,
    design_mpc,
    loop_margins,
    sensitivity_peak,
)
from jaxtwin.control.tuning._objective import checked_objective
from jaxtwin.control.tuning._side_by_side_sqp import CandidateEvaluation, descents
from jaxtwin.control.tuning._tuning_problem import SearchBox, TuningProblem, tuning_problem
from jaxtwin.errors import ControlError, ParameterError

DRAWS = {"R_E": np.array([1.8, 2.1]), "t_delay": np.array([1.5, 2.5])}
START = PID(Kp=0.03, Ki=0.0004, limits=(0, 1))
LIMIT = 1.5


def problem(twin: Twin) -> TuningProblem:
    return tuning_problem(
        "tune",
        START,
        twin,
        24,
        150,
        tuned={"Kp": (0.003, 0.3), "Ki": (1e-5, 1e-2)},
        objective={"integral_absolute_error": 1.0, "energy": 0.002},
        draws=DRAWS,
        tail_weight=0.5,
        sensitivity_limit=LIMIT,
        starts=2,
        seed=0,
        workers=None,
        settings={"noise": False},
    )


@pytest.fixture(scope="module")
def tuning(twin: Twin) -> Tuning:
    return problem(twin).solved(rounds=12, began=0.0)


@pytest.mark.slow
def test_derivatives_are_those_of_differences(twin: Twin):
    """Of the measures through the loop, and of the sensitivity peak of the linearised one."""
    asked = problem(twin)
    values = asked.vector.values
    found, peak = asked.loops([asked.vector.line(values)], 2), asked.linear
    assert peak is not None
    for place, size in enumerate(1e-5 * values):
        step = size * np.eye(2)[place]
        up, down = asked.loops(
            [asked.vector.line(v) for v in (values + step, values - step)], 2
        ).values
        smooth = [list(asked.objective.measures).index(name) for name in SMOOTH]
        difference = (up - down)[:, smooth] / (2 * size)
        np.testing.assert_allclose(found.slopes[0][:, smooth, place], difference, rtol=2e-4)
        by_peak = (peak.peak(values + step).value - peak.peak(values - step).value) / (2 * size)
        # The frequencies that are looked at stay, and so does the one with the peak.
        np.testing.assert_allclose(peak.peak(values).slope[place], by_peak, rtol=1e-2)


SMOOTH = ["integral_absolute_error", "integral_squared_error", "energy", "plate_range_at_rest"]


@pytest.mark.slow
def test_the_tuned_loop_is_better_and_keeps_to_the_limit(twin: Twin, tuning: Tuning):
    assert tuning.after.objective < 0.9 * tuning.before.objective
    assert tuning.after.sensitivity_peak <= LIMIT * (1 + 1e-3)
    assert tuning.after.sensitivity.max() == pytest.approx(tuning.after.sensitivity_peak)
    assert np.all(tuning.lower <= tuning.after.values)
    assert np.all(tuning.after.values <= tuning.upper)
    controller = tuning.controller
    assert isinstance(controller, PID)
    np.testing.assert_allclose([controller.Kp, controller.Ki], tuning.after.values)
    # The same loops by simulate_closed_loops.
    again = jt.simulate_closed_loops(
        twin, controller, 24, duration=150, draws=DRAWS, noise=False, quantised=False
    )
    for number, name in enumerate(tuning.measures):
        np.testing.assert_allclose(tuning.after.measures[:, number], again[name], rtol=1e-6)
    table = tuning.to_dataframe()
    assert table.loc[(0, 0), "objective"] == pytest.approx(tuning.before.objective)
    assert len(tuning.plot().axes) == 3
    plt.close("all")


@pytest.mark.slow
def test_the_sensitivity_is_that_of_the_continuous_loop_with_a_hold(twin: Twin, tuning: Tuning):
    """Below half the sample rate the hold, the delay and the sampled controller multiply; what
    sampling folds down from above is small for a plate."""
    peaks = []
    for R_E, delay in zip(*DRAWS.values(), strict=True):
        plant = twin.with_values({"R_E": R_E, "t_delay": delay})
        model = jt.linearize(plant, temperatures=24.0)
        Kp, Ki = tuning.after.values

        def loop(omega: Any, model: Any = model, Kp: float = Kp, Ki: float = Ki) -> Any:
            z = np.exp(1j * omega)
            hold = (1 - 1 / z) / (1j * omega)
            plate = model.frequency_response(omega).mean(axis=1).sum(axis=1)
            return plate * hold * (Kp + Ki / (z - 1))

        peaks.append(sensitivity_peak(loop, omega=np.geomspace(1e-3, np.pi, 2000))[0])
    np.testing.assert_allclose(tuning.after.sensitivity.max(axis=1), peaks, rtol=0.01)


def test_the_search_finds_a_minimum_on_a_curved_limit():
    """Rosenbrock's valley outside of a circle, by scipy's SLSQP from the same start."""
    from scipy.optimize import minimize

    def f(z: Any) -> float:
        x, y = 2 * np.asarray(z)
        return float((1 - x) ** 2 + 10 * (y - x**2) ** 2)

    def c(z: Any) -> float:
        return float(z[0] ** 2 + z[1] ** 2 - 0.3)

    def evaluate(points: Any) -> list[CandidateEvaluation]:
        results = []
        for z in points:
            x, y = 2 * z
            g = 2 * np.array([-2 * (1 - x) - 40 * x * (y - x**2), 20 * (y - x**2)])
            results.append(CandidateEvaluation(f(z), g, c(z), 2 * z))
        return results

    starts = [np.array([0.1, 0.8]), np.array([0.9, 0.1])]
    history = descents(evaluate, starts, rounds=60)
    known = minimize(
        f, [0.4, 0.3], bounds=[(0, 1)] * 2, constraints=[{"type": "ineq", "fun": lambda z: -c(z)}]
    )
    for start in (0, 1):
        kept = [part for part in history if part.start == start and part.evaluation.c <= 1e-3]
        best = min(kept, key=lambda part: part.evaluation.f)
        np.testing.assert_allclose(best.point, known.x, atol=1e-2)
        assert best.evaluation.f == pytest.approx(known.fun, rel=0.02)


def test_the_worst_draws_count_by_their_weight():
    """Of 40 draws the worst 2 are 5 %."""
    rig = Twin("single-cell").rig
    objective = checked_objective("tune", {"energy": 2.0}, 0.25, rig)
    column = list(objective.measures).index("energy")
    values = np.full((40, len(objective.measures)), np.inf)  # a measure without weight may be
    values[:, column] = np.arange(40)
    slopes = np.zeros((*values.shape, 1))
    slopes[-1, column] = 1.0
    total, slope = objective.over_draws(values, slopes)
    assert total == pytest.approx(2 * (0.75 * np.arange(40).mean() + 0.25 * 38.5))
    np.testing.assert_allclose(slope, [2 * (0.75 / 40 + 0.25 / 2)])


def test_the_box_is_logarithmic_where_it_is_above_0():
    box = SearchBox(np.array([0.01, -1.0]), np.array([1.0, 3.0]))
    np.testing.assert_allclose(box.values(np.array([0.5, 0.5])), [0.1, 1.0])
    np.testing.assert_allclose(box.point(np.array([0.1, 9.0])), [0.5, 1.0])
    up, down = (box.values(np.array([0.5 + h, 0.5 + h])) for h in (1e-6, -1e-6))
    np.testing.assert_allclose(box.slopes(np.array([0.1, 1.0])), (up - down) / 2e-6, rtol=1e-6)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"tuned": ["Kx"]}, "unknown parameter 'Kx'"),
        ({"tuned": ["Kd"]}, "Kd: expected bounds, because its value is not above 0"),
        ({"tuned": {"Kp": (1, 0.1)}}, r"Kp: expected \(lowest, highest\)"),
        ({"tuned": []}, "expected names of parameters, got none"),
        ({"objective": "settling_time"}, "which changes by whole samples; take integral_time"),
        ({"objective": "speed"}, "unknown measure 'speed'"),
        ({"objective": {"energy": np.inf}}, "energy: expected a finite number"),
        ({"objective": {"energy": 0.0}}, "expected a weight other than 0"),
        ({"objective": {}}, "expected a measure, measure -> weight"),
        ({"tail_weight": 1.5}, "tail_weight: expected a number from 0 to 1"),
        ({"sensitivity_limit": 1}, "sensitivity_limit: expected a number above 1"),
        ({"draws": 8}, "a number of draws only beside a fit"),
        ({"quantised": True}, "quantised: expected False"),
        ({"starts": 0}, "starts: expected a whole number"),
    ],
)
def test_invalid_arguments_of_tune_are_refused(twin: Twin, settings: dict[str, Any], message: str):
    with pytest.raises(ControlError, match=message):
        jt.tune(twin, START, 24, duration=150, **settings)


def test_a_draw_that_no_rig_can_have_is_refused_by_its_number(twin: Twin):
    with pytest.raises(ParameterError, match=r"dual-cell: draw 2: .*R_E.* above 0, got -1"):
        jt.tune(twin, START, 24, duration=150, draws={"R_E": [2.0, 1.9, -1.0]})


def test_gains_of_a_file_have_no_weights_that_could_be_tuned(twin: Twin):
    """A file of an `LQI` has its gains alone."""
    lqi = design_lqi(jt.linearize(twin, duty=0.4).reduce(2).discretise(1.0))
    with pytest.raises(ControlError, match="expected names of parameters for a LQI"):
        jt.tune(twin, eqx.tree_at(lambda c: c.weights, lqi, None), 24, duration=150)


def test_a_name_that_is_no_weight_beside_one_that_is(twin: Twin):
    lqi = design_lqi(jt.linearize(twin, duty=0.4).reduce(2).discretise(1.0))
    with pytest.raises(ControlError, match="unknown weight 'Kx'"):
        jt.tune(twin, lqi, 24, duration=150, tuned=["drift", "Kx"])


def test_the_old_order_of_arguments_is_taken_with_a_warning(twin):
    with (
        pytest.warns(DeprecationWarning, match=r"now tune\(twin, controller, \.\.\.\)"),
        pytest.raises(ControlError, match="tune: starts"),
    ):
        jt.tune(START, twin, 24, duration=150, starts=0)  # pyright: ignore[reportArgumentType]
    with (
        pytest.warns(DeprecationWarning, match=r"now tune\(twin, controller, \.\.\.\)"),
        pytest.raises(ControlError, match="tune: starts"),
    ):
        jt.tune(START, twin=twin, references=24, duration=150, starts=0)  # pyright: ignore


@pytest.fixture(scope="module")
def tclab_model() -> StateSpace:
    return jt.linearize(Twin("tclab"), temperatures=40.0).discretise(5.0)


DESIGNS = [(design_lqi, {}), (design_mpc, {"horizon": 6, "temperature_limits": {"T1": (0, 60)}})]


@pytest.mark.parametrize(("design", "settings"), DESIGNS)
def test_another_design_is_that_of_the_constructor(
    design: Callable[..., LQI | MPC], settings: dict[str, Any], tclab_model: StateSpace
):
    given: dict[str, Any] = {"measured": ["T1", "T2"], "limits": (0, 1), **settings}
    other = design(tclab_model, **given).redesigned({"duty_deviation": [0.2, 0.3], "drift": 0.5})
    asked = design(tclab_model, **given, duty_deviation=[0.2, 0.3], drift=0.5)
    assert jax.tree.structure(other) == jax.tree.structure(asked)
    for a, b in zip(jax.tree.leaves(other), jax.tree.leaves(asked), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("design", "settings"), DESIGNS)
def test_derivatives_by_weights_are_those_of_differences(
    design: Callable[..., LQI | MPC], settings: dict[str, Any], tclab_model: StateSpace
):
    """Of the measures of loops, and of the sensitivity peak."""
    start = design(tclab_model, measured=["T1", "T2"], limits=(0, 1), **settings)
    asked = tuning_problem(
        "tune", start, Twin("tclab"), [40.0, 35.0], 200, tuned=None,
        objective="integral_squared_error", draws=None, tail_weight=0.5, sensitivity_limit=1.8,
        starts=2, seed=0, workers=None, settings={"noise": False},
    )  # fmt: skip
    values, smooth = asked.vector.values, [list(asked.objective.measures).index(SMOOTH[0])]
    assert asked.linear is not None

    def measured(values: np.ndarray) -> tuple[np.ndarray, float]:
        assert asked.linear is not None
        with own_settings():
            peak = asked.linear.peak(values).value
        return asked.loops([asked.vector.line(values)], 2).values[0, 0][smooth], peak

    found = asked.loops([asked.vector.line(values)], 2).slopes[0, 0][smooth]
    with own_settings():
        peak = asked.linear.peak(values)
    for place in range(len(values)):
        step = 2e-4 * values[place] * np.eye(len(values))[place]
        more, less = measured(values + step), measured(values - step)
        apart = 4e-4 * values[place]
        np.testing.assert_allclose(
            found[:, place], (more[0] - less[0]) / apart, rtol=1e-4, atol=1e-6
        )
        np.testing.assert_allclose(peak.slope[place], (more[1] - less[1]) / apart, rtol=1e-4)


@pytest.mark.slow
def test_a_fragile_lqi_becomes_robust_by_its_weights(tclab_model: StateSpace):
    """Its margins are said with it."""
    twin, two = Twin("tclab"), {"measured": ["T1", "T2"], "limits": (0, 1)}
    start = design_lqi(tclab_model, reading_noise=0.1, **two)
    assert "fragile" in loop_margins(twin, start, [40.0, 35.0]).summary()
    tuning = jt.tune(
        twin, start, [40.0, 35.0], duration=200, sensitivity_limit=1.6, starts=1, rounds=14
    )
    assert tuning.margins is not None
    assert tuning.margins.sensitivity_peak < 1.6 * 1.001
    assert "tolerates gains" in tuning._repr_html_()
    assert isinstance(tuning.controller, LQI)
    assert tuning.controller.designed_for == "tclab"
