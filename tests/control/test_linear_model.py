"""Linear models against central differences, SciPy, solutions by hand and the twin itself."""

import dataclasses
from typing import Any

import jax
import numpy as np
import pytest
from central_differences import differences
from scipy.signal import cont2discrete

from jaxtwin import Experiment, Twin, linearize, simulate
from jaxtwin.control import OperatingPoint, StateSpace
from jaxtwin.errors import ControlError, ParameterError

POINTS = [
    ("dual-cell", [0.4, 0.3]),
    ("dual-cell", [-0.2, 0.5]),
    ("dual-cell", [0.0, 0.2]),
    ("paper-2024", [0.5, -0.1]),
    ("paper-2024", [0.0, 0.0]),
    ("single-cell", [-0.3]),
]


@pytest.mark.slow
@pytest.mark.parametrize(("rig", "duty"), POINTS)
def test_matrices_are_the_derivatives_of_the_twin(rig: str, duty: list[float], float64):
    """To 1e-6 of the largest entry of a row; at a duty of 0 that is the mean of both slopes."""
    twin = Twin(rig)
    model = linearize(twin, duty=duty)
    system = twin.system()
    reference = system.ambient_temperature
    at = np.asarray(model.operating_point.nodes) + 273.15 - float(reference)
    rate = jax.jit(
        lambda nodes, duty: system.heat_into_nodes(nodes, duty, reference) / system.capacitance
    )
    by_nodes = differences(lambda nodes: rate(nodes, jax.numpy.asarray(duty)), at, 0.05)
    by_duty = differences(lambda duty: rate(jax.numpy.asarray(at), duty), np.array(duty), 1e-3)
    by_state = differences(jax.jit(lambda nodes: system.channel_temperatures(nodes)), at, 0.05)
    for found, expected in ((model.A, by_nodes), (model.B, by_duty), (model.C, by_state)):
        # Rows of 0, of nodes that no duty heats at once, are compared with the others.
        rows = np.abs(expected).max(axis=1, keepdims=True)
        scale = np.maximum(rows, 1e-3 * rows.max())
        np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-6)
    assert not np.any(model.D)


def test_the_sample_time_is_part_of_a_model_s_structure():
    """Only arrays are traced: models of two sample times are two programs, and `export_c` and the
    controllers can read the sample time of a model inside of `jax.jit`."""
    model = linearize(Twin("single-cell"), duty=0.2).discretise(2.0)
    leaves = jax.tree.leaves(model)
    assert leaves
    assert all(isinstance(leaf, np.ndarray) for leaf in leaves)
    other = linearize(Twin("single-cell"), duty=0.2).discretise(4.0)
    assert jax.tree.structure(model) != jax.tree.structure(other)


@pytest.mark.slow
@pytest.mark.parametrize(("rig", "duty"), POINTS)
def test_the_operating_point_is_where_a_long_run_ends(rig: str, duty: list[float]):
    twin = Twin(rig)
    experiment = Experiment([0.0, 40_000.0], [duty, duty])
    run = simulate(twin, experiment, initial="steady")
    point = linearize(twin, duty=duty).operating_point
    np.testing.assert_allclose(point.outputs, run.temperatures[-1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(point.nodes, run.states[-1], rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("step", [(0.01, 0.0), (0.0, 0.01), (0.01, 0.01)])
@pytest.mark.parametrize(
    ("rig", "duty", "values"),
    [("dual-cell", [0.4, 0.3], {"t_delay": 2.4}), ("paper-2024", [0.3, 0.3], {})],
)
def test_a_step_of_the_duty_by_a_hundredth_is_that_of_the_twin(rig, duty, values, step):
    """At every sample, and in each channel, within 1 % of that channel's own change: what is left
    is curvature. A channel needs no floor, because even the one furthest from the cell that moves
    changes by a fifth of what the nearest does."""
    twin = Twin(rig, values)
    time = np.arange(601.0)
    drive = np.where(time[:, None] < 1, duty, np.add(duty, step))
    run = simulate(twin, Experiment(time, drive), initial="steady").temperatures
    model = linearize(twin, duty=duty)
    found = model.discretise(1.0).simulate(drive)
    change, expected = found - model.operating_point.outputs, run - run[0]
    sizes = np.abs(expected).max(axis=0)
    assert sizes.min() > 0.2 * sizes.max()
    assert np.all(np.abs(change - expected).max(axis=0) < 0.01 * sizes)


@pytest.mark.parametrize("sample_time", [0.1, 1.0, 30.0])
def test_without_delay_and_lag_discretise_is_scipys(sample_time: float):
    model = linearize(Twin("paper-2024"), duty=[0.5, 0.2])
    assert not model.is_delayed
    assert not model.is_lagged
    found = model.discretise(sample_time)
    expected = cont2discrete((model.A, model.B, model.C, model.D), sample_time)
    A, B, C, D = tuple(expected)[:4]  # pyright: ignore
    np.testing.assert_allclose(found.A, A, rtol=0, atol=1e-12 * np.abs(A).max())
    np.testing.assert_allclose(found.B, B, rtol=0, atol=1e-12 * np.abs(B).max())
    np.testing.assert_array_equal(found.C, C)
    np.testing.assert_array_equal(found.D, D)


def first_order_step(time: np.ndarray, T: float, lag: float, delay: float) -> np.ndarray:
    """The answer of 1 / (T s + 1) to a unit step, behind a lag and a delay, solved by hand."""
    t = np.maximum(time - delay, 0.0)
    if lag == 0:
        return 1 - np.exp(-t / T)
    return 1 - (T * np.exp(-t / T) - lag * np.exp(-t / lag)) / (T - lag)


@pytest.mark.slow
@pytest.mark.parametrize("lag", [0.0, 0.7])
@pytest.mark.parametrize(
    ("delay", "shifts"), [(0.0, 0), (0.2, 1), (0.5, 1), (1.5, 3), (1.2, 3), (3 * 0.1, 1)]
)
def test_delays_that_are_multiples_or_not_are_exact(lag: float, delay: float, shifts: int):
    model = StateSpace([[-1 / 3]], [[1 / 3]], [[1.0]], [[0.0]], delay_s=delay, lag_s=lag)
    discrete = model.discretise(0.5)
    assert len(discrete.A) == 1 + (lag > 0) + shifts
    found = discrete.simulate(np.ones((40, 1)))[:, 0]
    expected = first_order_step(0.5 * np.arange(40), 3.0, lag, delay)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


def test_a_direct_gain_acts_behind_the_delay():
    model = StateSpace([[-1.0]], [[0.0]], [[1.0]], [[2.0]], delay_s=1.5)
    found = model.discretise(1.0).simulate(np.ones((5, 1)))[:, 0]
    np.testing.assert_array_equal(found, [0, 0, 2, 2, 2])


def test_room_for_a_longer_delay_changes_nothing():
    model = StateSpace([[-1 / 3]], [[1 / 3]], [[1.0]], [[0.5]], delay_s=1.2)
    commands = np.sin(np.arange(30.0))[:, None]
    own, roomy = model.discretise(0.5), model.discretise(0.5, longest_delay=4.0)
    assert len(roomy.A) > len(own.A)
    np.testing.assert_allclose(roomy.simulate(commands), own.simulate(commands), atol=1e-14)


@pytest.mark.slow
def test_a_model_starts_where_a_duty_was_held_for_long():
    model = linearize(Twin("dual-cell"), duty=0.4).discretise(2.0)
    state = model.start([0.5, 0.3])
    np.testing.assert_allclose(model.step(state, [0.5, 0.3]), state, rtol=0, atol=1e-9)
    gain = linearize(Twin("dual-cell"), duty=0.4).dcgain
    change = model.outputs(state, [0.5, 0.3]) - model.operating_point.outputs
    np.testing.assert_allclose(change, gain @ np.array([0.1, -0.1]), rtol=1e-9)


@pytest.mark.slow
def test_the_duty_for_temperatures_is_found():
    twin = Twin("dual-cell")
    point = linearize(twin, temperatures={"TAM": 40.0, "TCM": 35.0}).operating_point
    reached = dict(zip(twin.channels, np.asarray(point.outputs), strict=True))
    assert (reached["TAM"], reached["TCM"]) == pytest.approx((40.0, 35.0), abs=1e-6)
    again = linearize(twin, duty=point.duty).operating_point
    np.testing.assert_allclose(again.outputs, point.outputs, rtol=0, atol=1e-9)
    mean = linearize(twin, temperatures=50.0).operating_point
    assert np.mean(mean.outputs) == pytest.approx(50.0, abs=1e-6)
    assert mean.duty[0] == mean.duty[1]


@pytest.mark.slow
def test_more_temperatures_than_cells_are_met_as_well_as_possible():
    """At the optimum nothing is gained by moving either cell's duty."""
    twin = Twin("dual-cell")
    wanted: dict[str, float] = dict.fromkeys(["T11", "T13", "T15", "T26"], 40.0)
    model = linearize(twin, temperatures=wanted)
    rows = [twin.channels.index(name) for name in wanted]
    off = np.asarray(model.operating_point.outputs)[rows] - 40.0
    np.testing.assert_allclose(model.dcgain[np.array(rows)].T @ off, 0.0, atol=1e-6)
    assert 0.1 < np.abs(off).max() < 10


@pytest.mark.slow
def test_models_of_many_draws_are_those_of_each():
    twin, values = Twin("dual-cell"), np.array([1.8, 2.2])

    def model(R_E) -> StateSpace:
        linear = linearize(twin.with_values({"R_E": R_E}), duty=[0.4, 0.4])
        return linear.discretise(1.0, longest_delay=3.0)

    with jax.enable_x64(True):
        batch = jax.vmap(model)(values)
    for number, value in enumerate(values):
        single = linearize(twin.with_values({"R_E": value}), duty=[0.4, 0.4])
        single = single.discretise(1.0, longest_delay=3.0)
        np.testing.assert_allclose(batch.A[number], single.A, rtol=0, atol=1e-12)
        np.testing.assert_allclose(batch.B[number], single.B, rtol=0, atol=1e-12)
        outputs = batch.operating_point.outputs[number]
        np.testing.assert_allclose(outputs, single.operating_point.outputs, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    "keywords", [pytest.param({"duty": [0.4, 0.3]}, marks=pytest.mark.long), {"temperatures": 30.0}]
)
def test_derivatives_by_a_parameter_are_exact(keywords, float64):
    twin = Twin("single-cell" if "temperatures" in keywords else "dual-cell")

    def number(R_E):
        model = linearize(twin.with_values({"R_E": R_E}), **keywords)
        return model.dcgain.sum() + model.operating_point.duty.sum()

    step = 1e-4
    expected = (number(2.0 + step) - number(2.0 - step)) / (2 * step)
    backward, forward = jax.jit(lambda R_E: (jax.grad(number)(R_E), jax.jacfwd(number)(R_E)))(2.0)
    assert backward == pytest.approx(expected, rel=1e-6)
    assert forward == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({}, "expected one of duty, temperatures and run, got none"),
        ({"duty": 0.4, "temperatures": 30.0}, "got duty and temperatures"),
        ({"duty": [0.4, 0.4, 0.4]}, "duty: expected 2 numbers from -1 to 1"),
        ({"duty": 1.5}, "duty: expected 2 numbers from -1 to 1, or a single one, got 1.5"),
        ({"temperatures": {"T99": 30.0}}, "expected channels of dual-cell"),
        ({"temperatures": {}}, "at least as many as the 2 cells"),
        ({"temperatures": 400.0}, "that duty cycles from -1 to 1 reach, got 400 degC"),
        ({"temperatures": {"TAM": 60.0, "TCM": 20.0}}, "the nearest found was"),
    ],
)
def test_an_invalid_operating_point_is_refused(keywords, message: str):
    with pytest.raises(ControlError, match=message):
        linearize(Twin("dual-cell"), **keywords)


def test_a_twin_with_several_values_is_refused():
    with pytest.raises(ParameterError, match="R_E: expected one value, got 2"):
        linearize(Twin("dual-cell", {"R_E": [1.8, 2.2]}), duty=0.4)


def test_invalid_matrices_delays_and_sample_times_are_refused():
    with pytest.raises(ControlError, match=r"got shapes \(1, 1\), \(2, 1\)"):
        StateSpace([[-1.0]], [[1.0], [1.0]], [[1.0]], [[0.0]])
    with pytest.raises(
        ControlError, match="delay_s: expected a number of at least 0, in s, got -1"
    ):
        StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], delay_s=-1)
    with pytest.raises(ControlError, match="output_names: expected 1 names, got 2"):
        StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], output_names=["a", "b"])
    model = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], delay_s=2.0)
    with pytest.raises(ControlError, match="sample_time_s: expected a number above 0"):
        model.discretise(0.0)
    for size in (1e-3, 1e-9):
        with pytest.raises(ControlError, match=r"sample_time_s: expected at least 0.002 s"):
            model.discretise(size)
    with pytest.raises(ControlError, match="at least the driver's delay, 2 s, got 1 s"):
        model.discretise(1.0, longest_delay=1.0)
    with pytest.raises(ControlError, match="delay is traced by JAX"):
        jax.jit(lambda m: m.discretise(1.0))(model)
    with pytest.raises(ControlError, match="duty: expected 1 numbers"):
        model.discretise(1.0).step(np.zeros(3), [1.0, 2.0])
    for what in (model.start, lambda: model.step(np.zeros(1), 0.5), model.without_feedthrough):
        with pytest.raises(ControlError, match=r"expected a discrete model, such as linearize"):
            what()
    discrete = model.discretise(1.0)
    for what in (lambda: discrete.reduce(1), lambda: discrete.discretise(2.0)):
        with pytest.raises(ControlError, match="expected a model in continuous time, got one with"):
            what()
    with pytest.raises(ControlError, match="delay_s, lag_s: expected 0 s with a sample time"):
        StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], sample_time_s=1.0, delay_s=2.0)


def without_delay_and_lag() -> StateSpace:
    model = linearize(Twin("dual-cell"), duty=0.4)
    return dataclasses.replace(model, delay_s=0.0, lag_s=0.0, is_delayed=False, is_lagged=False)


def test_a_discrete_model_has_the_gain_and_the_time_constants_of_the_continuous_one():
    model = without_delay_and_lag()
    discrete = model.discretise(0.5)
    np.testing.assert_allclose(discrete.dcgain, model.dcgain, rtol=1e-9)
    np.testing.assert_allclose(discrete.time_constants_s[:5], model.time_constants_s[:5], rtol=1e-6)


def test_weighted_outputs_and_the_last_command_as_a_state_change_no_reading():
    model = without_delay_and_lag().reduce(3).discretise(1.0)
    weights = np.full((1, len(model.output_names)), 1 / len(model.output_names))
    mean = model.with_outputs(weights, ["mean"])
    duty = np.linspace([0.4, 0.4], [0.9, 0.2], 20)
    np.testing.assert_allclose(mean.simulate(duty)[:, 0], model.simulate(duty).mean(axis=1))
    late = mean.without_feedthrough()
    assert not np.asarray(late.D).any()
    # A reading just before a command follows the last one.
    state = mean.start()
    for last, now, read in zip(duty, duty[1:], late.simulate(duty)[1:], strict=False):
        state = mean.step(state, last)
        np.testing.assert_allclose(read, mean.outputs(state, last), rtol=1e-12)
        assert abs(read - mean.outputs(state, now)) > 1e-6


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"sample_time_s": 0.0}, "sample_time_s: expected a number above 0, in s, got 0"),
        ({"sample_time_s": np.nan}, "sample_time_s: expected a number above 0"),
        ({"delay_s": 2.0, "is_delayed": False}, "delay_s: expected 0 s, as the model is said to"),
        ({"lag_s": 0.0, "is_lagged": True}, "lag_s: expected a time above 0 s, as the model is"),
        ({"output_names": "a"}, "output_names: expected 1 names, got 'a'"),
        (
            {
                "operating_point": OperatingPoint(
                    np.zeros(2), np.zeros(1), np.zeros(1), np.zeros(())
                )
            },
            r"operating_point: duty: expected 1 numbers, got an array of shape \(2,\)",
        ),
    ],
)
def test_what_a_model_cannot_be_is_refused(settings: dict[str, Any], message: str):
    with pytest.raises(ControlError, match=message):
        StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], **settings)


def test_an_integrator_has_no_gain_at_rest_and_can_be_shown():
    model = StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    for integrator in (model, model.discretise(1.0)):
        with pytest.raises(ControlError, match="comes to rest under a constant duty"):
            _ = integrator.dcgain
        assert "y1" in integrator._repr_html_()


def test_the_states_of_a_reduced_model_are_no_temperatures():
    with pytest.raises(ControlError, match="got a reduced one; call it before reduce"):
        linearize(Twin("dual-cell"), duty=0.4).reduce(4).with_states_as_outputs(["balanced 1"])
