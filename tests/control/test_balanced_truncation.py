"""Reduced models: Hankel singular values by hand, the bound of the error, the DC gain."""

from typing import Any

import numpy as np
import pytest

from jaxtwin import Twin, linearize
from jaxtwin.control import StateSpace
from jaxtwin.errors import ControlError

OMEGA = np.geomspace(1e-6, 1e3, 300)


def norms(response: np.ndarray) -> np.ndarray:
    return np.linalg.norm(response, 2, axis=(1, 2))


def test_hankel_singular_values_of_first_orders_by_hand():
    """k / (s + a) has k / 2a; a system of several that do not touch has those of each."""
    model = StateSpace(np.diag([-1.0, -4.0]), np.diag([1.0, 2.0]), np.eye(2), np.zeros((2, 2)))
    np.testing.assert_allclose(model.hankel_singular_values, [1 / 2, 2 / 8], rtol=1e-12)
    assert model.error_bound(1) == pytest.approx(2 * 2 / 8)


@pytest.mark.slycot
@pytest.mark.parametrize("order", [2, 4, 6])
def test_reduced_models_are_those_of_slycot(order: int):
    """SLICOT's routines, through python-control's `balred` that matches the DC gain."""
    import control

    model = linearize(Twin("dual-cell"), duty=[0.4, 0.4])
    theirs = control.StateSpace(model.A, model.B, model.C, model.D)
    hankel = model.hankel_singular_values
    np.testing.assert_allclose(hankel[:10], control.hankel_singular_values(theirs)[:10], rtol=1e-9)
    reduced = model.reduce(order)
    ours = StateSpace(reduced.A, reduced.B, reduced.C, reduced.D).frequency_response(OMEGA)
    by_slycot: Any = control.balred(theirs, order, method="matchdc")
    expected = np.moveaxis(by_slycot.frequency_response(OMEGA).frdata, -1, 0)
    error = norms(np.asarray(ours) - expected).max()
    assert error < 1e-8 * norms(np.asarray(ours)).max()


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["paper-2024", "dual-cell"])
@pytest.mark.parametrize("order", [2, 4, 6, 10])
def test_the_error_stays_within_its_bound_and_is_none_at_rest(rig: str, order: int):
    """At least the first Hankel singular value that is left out, and at most twice their sum."""
    model = linearize(Twin(rig), duty=[0.4, 0.4])
    reduced = model.reduce(order)
    assert reduced.A.shape == (order, order)
    np.testing.assert_allclose(reduced.dcgain, model.dcgain, rtol=0, atol=1e-9)
    plain = [StateSpace(m.A, m.B, m.C, m.D).frequency_response(OMEGA) for m in (model, reduced)]
    error = norms(np.asarray(plain[0] - plain[1])).max()
    hankel = model.hankel_singular_values
    assert 0.9 * hankel[order] < error < model.error_bound(order) * (1 + 1e-9)
    assert np.real(reduced.poles).max() < 0
    assert (reduced.delay_s, reduced.lag_s) == (model.delay_s, model.lag_s)


def test_states_that_no_input_moves_or_no_output_shows_are_left_out():
    """Mirror images: of two equal first orders in parallel only the sum is left."""
    model = StateSpace(-np.eye(2), [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]])
    np.testing.assert_allclose(model.hankel_singular_values, [1.0])
    reduced = model.reduce(1)
    np.testing.assert_allclose(
        reduced.frequency_response(OMEGA), model.frequency_response(OMEGA), rtol=1e-9
    )
    with pytest.raises(ControlError, match="at most the 1 states that a drive moves"):
        model.reduce(2)


def test_all_states_kept_are_the_model_itself():
    model = linearize(Twin("single-cell"), duty=0.3)
    same = model.reduce(len(model.hankel_singular_values))
    found, expected = (m.frequency_response(OMEGA) for m in (same, model))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 * np.abs(expected).max())


def test_unstable_models_and_invalid_orders_are_refused():
    with pytest.raises(ControlError, match="expected a stable model, got a pole"):
        StateSpace([[0.1]], [[1.0]], [[1.0]], [[0.0]]).reduce(1)
    with pytest.raises(ControlError, match="order: expected a whole number above 0"):
        StateSpace([[-0.1]], [[1.0]], [[1.0]], [[0.0]]).reduce(0)


@pytest.mark.slow
def test_five_states_follow_the_paper_s_steps_within_a_tenth_of_a_kelvin():
    """The whole linear model of `dual-cell` under the drive of the recordings, from rest; six do,
    and four do not."""
    time = np.arange(1001)
    drive = np.tile(np.where(time < 500, 0.50, 0.78)[:, None], (1, 2))
    model = linearize(Twin("dual-cell"), duty=0.64)
    runs = []
    for each in (model, model.reduce(6), model.reduce(5), model.reduce(4)):
        discrete = each.discretise(1.0)
        runs.append(np.asarray(discrete.simulate(drive, discrete.start(0.0))))
    six, five, four = (np.abs(run - runs[0]).max() for run in runs[1:])
    assert max(six, five) < 0.1
    assert four > 0.1
