"""Frequency responses, poles and margins: by hand, and against python-control."""

import jax
import numpy as np
import pytest
from scipy.optimize import brentq

from jaxtwin import Twin, linearize
from jaxtwin.control import StateSpace, disk_margin, margins, sensitivity_peak
from jaxtwin.errors import ControlError

OMEGA = np.geomspace(1e-4, 10.0, 60)


def first_order(
    gain: float = 4.0, T: float = 3.0, lag_s: float = 0.0, delay_s: float = 0.0
) -> StateSpace:
    A, B = [[-1 / T]], [[gain / T]]
    return StateSpace(A, B, [[1.0]], [[0.0]], lag_s=lag_s, delay_s=delay_s)


def response(system, omega: np.ndarray) -> np.ndarray:
    """As python-control has it: `(outputs, inputs, frequency)`, or `(frequency,)` of a single."""
    import control

    return control.frequency_response(system, omega).complex  # pyright: ignore


def test_a_first_order_with_lag_and_delay_by_hand():
    model = first_order(lag_s=0.5, delay_s=1.5)
    s = 1j * OMEGA
    expected = 4 / (3 * s + 1) / (0.5 * s + 1) * np.exp(-1.5 * s)
    np.testing.assert_allclose(model.frequency_response(OMEGA)[:, 0, 0], expected, rtol=1e-13)
    assert model.frequency_response(0.0).shape == (1, 1)
    np.testing.assert_allclose(model.frequency_response(0.0), [[4.0]], rtol=1e-13)


@pytest.mark.slow
@pytest.mark.python_control
def test_the_response_of_a_twin_is_that_of_python_control():
    """Without delay as it is; with the delay in discrete time, where python-control has it too."""
    model = linearize(Twin("dual-cell"), duty=[0.4, 0.3])
    plain = StateSpace(model.A, model.B, model.C, model.D, lag_s=model.lag_s)
    expected = response(plain.to_control(), OMEGA)
    found = np.moveaxis(np.asarray(plain.frequency_response(OMEGA)), 0, -1)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10)
    late = found * np.exp(-1j * OMEGA * float(model.delay_s))
    own = np.moveaxis(np.asarray(model.frequency_response(OMEGA)), 0, -1)
    np.testing.assert_allclose(own, late, rtol=1e-12)
    slow = OMEGA[OMEGA < 0.05]
    discrete = response(model.discretise(0.05).to_control(), slow)
    # The hold itself is half a sample late.
    held = np.exp(-0.025j * slow)
    np.testing.assert_allclose(discrete, own[..., : len(slow)] * held, rtol=1e-5)


@pytest.mark.python_control
def test_pade_stands_for_the_delay_where_it_is_asked_for():
    model = first_order(lag_s=0.5, delay_s=2.0)
    with pytest.raises(ControlError, match="delay of 2 s cannot be in a StateSpace"):
        model.to_control()
    system = model.to_control(pade_order=4)
    assert system.nstates == 1 + 1 + 4
    slow = OMEGA[OMEGA < 1.0]
    found = response(system, slow)
    np.testing.assert_allclose(found, model.frequency_response(slow)[:, 0, 0], rtol=1e-4)


def test_poles_and_time_constants():
    model = StateSpace([[-0.5, 1.0], [0.0, -0.01]], [[1.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    np.testing.assert_allclose(model.poles, [-0.01, -0.5])
    np.testing.assert_allclose(model.time_constants_s, [100.0, 2.0])
    integrator = StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    np.testing.assert_array_equal(integrator.time_constants_s, [np.inf])


def test_the_relative_gain_of_two_by_two_is_bristols():
    gain = np.array([[2.0, 1.0], [0.5, 3.0]])
    model = StateSpace(-np.eye(2), gain, np.eye(2), np.zeros((2, 2)))
    share = 1 / (1 - gain[0, 1] * gain[1, 0] / (gain[0, 0] * gain[1, 1]))
    expected = [[share, 1 - share], [1 - share, share]]
    np.testing.assert_allclose(model.relative_gain_array, expected, rtol=1e-12)


def test_directions_of_two_cells_are_mean_and_uniformity():
    """Two cells that heat their own half by 3 K and the other by 1 K: sum and difference."""
    gain = np.array([[3.0, 1.0], [1.0, 3.0]])
    found = StateSpace(-np.eye(2), gain, np.eye(2), np.zeros((2, 2))).directions
    np.testing.assert_allclose(found.gains, [4.0, 2.0])
    assert found.names == ("mean", "uniformity")
    np.testing.assert_allclose(found.mean_share, [1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.abs(found.inputs), np.sqrt(0.5))
    np.testing.assert_allclose(found.duty_per_kelvin, np.sqrt(2) / found.gains)
    assert found.condition_number == pytest.approx(2.0)


def test_margins_of_an_integrator_with_a_delay_by_hand():
    """k e^(-2 s) / s: the gain is 1 at k, the phase -180 degrees at pi / 4."""
    k = 0.2
    gm, pm, wcg, wcp = found = margins(lambda w: k * np.exp(-2j * w) / (1j * w))
    assert wcp == pytest.approx(k, rel=1e-9)
    assert pm == pytest.approx(90 - np.degrees(2 * k), rel=1e-9)
    assert wcg == pytest.approx(np.pi / 4, rel=1e-9)
    assert gm == pytest.approx(np.pi / 4 / k, rel=1e-9)
    assert found.delay_s == pytest.approx(np.pi / 2 / k - 2, rel=1e-9)


def test_margins_of_a_first_order_with_a_delay_by_hand():
    model = first_order(gain=4.0, T=3.0, delay_s=1.0)
    found = margins(model)
    wcp = np.sqrt(15) / 3
    assert found.wcp == pytest.approx(wcp, rel=1e-9)
    assert found.pm == pytest.approx(180 - np.degrees(wcp + np.arctan(3 * wcp)), rel=1e-9)
    wcg = float(brentq(lambda w: w + np.arctan(3 * w) - np.pi, 1.0, 3.0))  # pyright: ignore
    assert found.wcg == pytest.approx(wcg, rel=1e-9)
    assert found.gm == pytest.approx(np.hypot(1, 3 * wcg) / 4, rel=1e-9)


@pytest.mark.python_control
@pytest.mark.parametrize("gain", [1.0, 5.0])
def test_margins_are_those_of_python_control_also_where_they_are_negative(gain: float):
    import control

    system = control.tf([gain], [1, 2, 1, 0])
    expected = control.margin(system)
    found = margins(lambda w: gain / (1j * w * (1j * w + 1) ** 2))
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_margins_at_one_of_the_given_frequencies_are_found():
    """1 / s has a gain of 1 at 1 rad/s. The second loop is -1/2 at 2 rad/s."""
    omega = np.array([0.5, 1.0, 2.0, 4.0])
    assert margins(lambda w: 1 / (1j * w), omega=omega)[1::2] == (90.0, 1.0)
    assert margins(lambda w: -0.5 + 1j * (w - 2), omega=omega)[::2] == (2.0, 2.0)


def test_a_loop_without_crossings_has_infinite_margins():
    gm, pm, wcg, wcp = margins(first_order(gain=0.5))
    assert (gm, pm) == (np.inf, np.inf)
    assert np.isnan([wcg, wcp]).all()


def test_the_peak_of_the_sensitivity_is_the_distance_from_minus_one():
    """1 / (s (s + 1)): largest where |1 + L| is smallest, by calculus at a frequency of 1.27."""
    peak, omega = sensitivity_peak(lambda w: 1 / (1j * w * (1j * w + 1)))
    squared = np.linspace(1.0, 2.5, 2_000_001)  # of the frequency
    found = squared * (squared + 1) / ((1 - squared) ** 2 + squared)
    assert peak**2 == pytest.approx(found.max(), rel=1e-9)
    assert omega**2 == pytest.approx(squared[np.argmax(found)], rel=1e-4)


@pytest.mark.python_control
@pytest.mark.parametrize("skew", [0.0, 1.0, -1.0])
def test_the_disk_margin_is_that_of_python_control(skew: float):
    import control

    system = control.tf([1.0], [1, 2, 1, 0])
    omega = np.geomspace(1e-2, 1e2, 3000)  # between which python-control does not look
    size, decibels, degrees = control.disk_margins(system, omega, skew)
    found = disk_margin(lambda w: 1 / (1j * w * (1j * w + 1) ** 2), skew=skew, omega=omega)
    assert found.margin == pytest.approx(size, rel=1e-4)
    assert found.phase_deg == pytest.approx(degrees, rel=2e-4)
    low, high = found.gain
    assert min(20 * np.log10(high), -20 * np.log10(low)) == pytest.approx(decibels, rel=2e-4)


def test_the_disk_margin_of_two_uncoupled_loops_is_the_smaller_one():
    def good(w):
        return 0.2 / (1j * w)

    def bad(w):
        return np.exp(-2j * w) / (2j * w)

    both = disk_margin(lambda w: np.array([[[good(x), 0], [0, bad(x)]] for x in w]))
    assert both.margin == pytest.approx(disk_margin(bad).margin, rel=1e-6)


def test_a_response_of_a_wrong_shape_or_with_nan_is_refused():
    two = StateSpace(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)))
    with pytest.raises(ControlError, match="with a single channel, got 2"):
        margins(two)
    with pytest.raises(ControlError, match="got infinite numbers or NaN"):
        margins(lambda w: w * np.nan)
    with pytest.raises(ControlError, match=r"expected a response \(frequency,\)"):
        sensitivity_peak(lambda w: np.ones((len(w), 2, 3)))
    with pytest.raises(ControlError, match="increasing frequencies above 0"):
        margins(first_order(), omega=np.array([1.0, 0.5]))


def test_responses_of_many_models_are_those_of_each():
    with jax.enable_x64(True):
        models = jax.vmap(lambda g: StateSpace([[-1.0]], [[g]], [[1.0]], [[0.0]]))
        batch = jax.vmap(lambda model: model.frequency_response(OMEGA))(models(np.array([1.0, 2])))
    expected = 1 / (1j * OMEGA + 1)
    np.testing.assert_allclose(batch[..., 0, 0], [expected, 2 * expected], rtol=1e-12)


def test_the_relative_gain_of_one_channel_and_two_cells_sums_to_one():
    """By hand: gains of 1 and 2 have parts of 1/5 and 4/5."""
    model = StateSpace([[-1.0]], [[1.0, 2.0]], [[1.0]], [[0.0, 0.0]])
    np.testing.assert_allclose(model.relative_gain_array, [[0.2, 0.8]], rtol=1e-12)


@pytest.mark.python_control
def test_the_response_of_a_discrete_model_is_that_of_python_control():
    model = linearize(Twin("dual-cell"), duty=0.4).reduce(4).discretise(2.0)
    omega = np.geomspace(1e-4, np.pi / 2, 20)
    theirs = model.to_control()(np.exp(2j * omega))
    np.testing.assert_allclose(
        model.frequency_response(omega), np.moveaxis(theirs, -1, 0), rtol=1e-8
    )
    traced = jax.jit(lambda m: m.frequency_response(omega))(model)
    np.testing.assert_allclose(traced, model.frequency_response(omega), rtol=1e-3)


@pytest.mark.python_control
def test_margins_of_a_discrete_model_are_those_of_python_control():
    import control

    loop = StateSpace([[-0.1]], [[0.5]], [[1.0]], [[0.0]], delay_s=2.0).discretise(1.0)
    theirs = control.margin(loop.to_control())
    np.testing.assert_allclose(tuple(margins(loop)), theirs, rtol=1e-6)


def test_at_half_the_sample_rate_a_loop_may_lose_its_gain_margin():
    """By hand: at z = -1 the response is 0.5 / (-1 - 0.9)."""
    loop = StateSpace([[0.9]], [[0.5]], [[1.0]], [[0.0]], sample_time_s=1.0)
    of_loop = margins(loop)
    assert of_loop.gm == pytest.approx(3.8)
    assert of_loop.wcg == pytest.approx(np.pi)
    assert of_loop.pm == pytest.approx(86.18, abs=0.01)
    with pytest.raises(ControlError, match="omega: expected frequencies up to half the sample"):
        margins(loop, omega=np.geomspace(0.01, 10))
