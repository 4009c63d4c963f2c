"""Whatever designs or simulates control for a twin does it for a fit: with the mean of its
recordings' own values, and with draws of its posterior."""

from typing import Any

import jax
import numpy as np
import pytest
from small_results import correlated_fit, fit

import jaxtwin as jt
from jaxtwin.control import PID, frontier, most_even_point
from jaxtwin.matching import posterior_draws

CONTROLLER = PID(Kp=0.1, Ki=0.001)
SETTINGS: dict[str, Any] = {"duration": 20, "rounds": 1}

pytestmark = pytest.mark.slow


def assert_same(found: object, expected: object) -> None:
    """Two PyTrees have the same structure and, to the last bit, the same numbers."""
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_mean_twin_differs_from_each_recordings_own():
    """Otherwise the tests below could not tell which of them is taken."""
    rooms = [float(twin.values["T_amb"]) for twin in fit().twins.values()]
    mean = float(fit().mean_twin.values["T_amb"])
    assert mean == pytest.approx(sum(rooms) / 2)
    assert min(abs(room - mean) for room in rooms) > 0.1
    assert float(fit().twin.values["T_amb"]) != mean


@pytest.mark.parametrize("at", [{"duty": 0.4}, {"temperatures": 25.0}])
def test_a_linear_model_of_a_fit_is_that_of_its_mean_twin(at: dict[str, Any]):
    assert_same(jt.linearize(fit(), **at), jt.linearize(fit().mean_twin, **at))


def test_the_most_even_point_of_a_fit_is_that_of_its_mean_twin():
    assert_same(most_even_point(fit(), 25), most_even_point(fit().mean_twin, 25))


def test_a_closed_loop_of_a_fit_is_that_of_its_mean_twin():
    found, expected = (
        jt.simulate_closed_loop(twin, CONTROLLER, 25, duration=20, seed=3)
        for twin in (fit(), fit().mean_twin)
    )
    assert_same(found.loop, expected.loop)
    draws = posterior_draws(fit(), 3)
    many, expected = (
        jt.simulate_closed_loops(twin, CONTROLLER, 25, duration=20, draws=draws, seed=3)
        for twin in (fit(), fit().mean_twin)
    )
    for name, values in expected.custom.items():
        np.testing.assert_array_equal(many[name], values)


def test_a_number_of_draws_beside_a_fit_is_that_of_its_posterior():
    known = correlated_fit()
    found = jt.tune(known, CONTROLLER, 25, draws=4, **SETTINGS)
    draws = posterior_draws(known, 4, seed=0)
    assert len(set(draws["R_pc"])) == 4
    expected = jt.tune(known.mean_twin, CONTROLLER, 25, draws=draws, **SETTINGS)
    np.testing.assert_array_equal(found.after.values, expected.after.values)
    np.testing.assert_array_equal(found.before.measures, expected.before.measures)
    np.testing.assert_array_equal(found.after.measures, expected.after.measures)
    assert found.after.sensitivity_peak == expected.after.sensitivity_peak
    error = found.measures.index("integral_absolute_error")
    assert len(set(found.before.measures[:, error])) == 4
    other = jt.tune(known, CONTROLLER, 25, draws=4, seed=1, **SETTINGS)
    assert np.all(other.before.measures[:, error] != found.before.measures[:, error])


def test_a_frontier_of_a_fit_is_that_of_its_mean_twin():
    found, expected = (
        frontier(twin, CONTROLLER, 25, weights=[0, 1], **SETTINGS)
        for twin in (fit(), fit().mean_twin)
    )
    for one, other in zip(found.tunings, expected.tunings, strict=True):
        np.testing.assert_array_equal(one.after.values, other.after.values)
        np.testing.assert_array_equal(one.after.measures, other.after.measures)
