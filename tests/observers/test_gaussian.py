"""The algebra of the Kalman filter against its textbook form, which takes all readings at once and
inverts their covariance (B. D. O. Anderson and J. B. Moore, Optimal Filtering, 1979, chapter 3)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin.observers._gaussian import (
    CAUTION_SIGMAS,
    Gaussian,
    GaussianUpdate,
    measurement_update,
    time_update,
)

pytestmark = pytest.mark.usefixtures("float64")

STATES, READINGS = 5, 3


class Example:
    """A normal distribution, and readings of it, drawn at random."""

    def __init__(self, seed: int, scale: float = 1.0):
        random = np.random.default_rng(seed)
        self.mean = random.normal(size=STATES)
        root = random.normal(size=(STATES, STATES))
        self.covariance = root @ root.T
        self.slope = random.normal(size=(READINGS, STATES))
        self.variance = random.uniform(0.1, 2.0, READINGS)
        self.innovation = scale * random.normal(size=READINGS)

    @property
    def gaussian(self) -> Gaussian:
        return Gaussian(jnp.asarray(self.mean), jnp.asarray(self.covariance))

    def updated(self, mask: np.ndarray | None = None, cautious: slice = slice(0)) -> GaussianUpdate:
        return measurement_update(
            self.gaussian,
            jnp.asarray(self.innovation),
            jnp.asarray(self.slope),
            jnp.asarray(self.variance),
            jnp.asarray(np.ones(READINGS, bool) if mask is None else mask),
            cautious,
        )

    def joint(self, kept: slice | list[int] = slice(None)) -> tuple[np.ndarray, ...]:
        """Mean and covariance of the textbook, the covariance of the innovations, and their log
        density."""
        slope, innovation = self.slope[kept], self.innovation[kept]
        S = slope @ self.covariance @ slope.T + np.diag(self.variance[kept])
        K = np.linalg.solve(S, slope @ self.covariance).T
        mean = self.mean + K @ innovation
        covariance = self.covariance - K @ S @ K.T
        away = innovation @ np.linalg.solve(S, innovation)
        density = -0.5 * (away + np.linalg.slogdet(2 * np.pi * S)[1])
        return mean, covariance, S, np.asarray(density)


@pytest.mark.parametrize("seed", range(3))
def test_readings_leave_what_the_textbook_says(seed: int):
    example = Example(seed)
    found = example.updated()
    mean, covariance, _, _ = example.joint()
    np.testing.assert_allclose(found.state.mean, mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.state.covariance, covariance, rtol=0, atol=1e-9)


def test_log_densities_add_up_to_that_of_all_readings():
    example = Example(3)
    found = example.updated()
    np.testing.assert_allclose(found.log_densities.sum(), example.joint()[3], rtol=0, atol=1e-9)


def test_whitened_innovations_are_those_of_a_cholesky_factor():
    """Each is what those before it do not say, divided by its standard deviation: the solution of
    a triangular system."""
    example = Example(4)
    found = example.updated()
    root = np.linalg.cholesky(example.joint()[2])
    whitened = np.linalg.solve(root, example.innovation)
    np.testing.assert_allclose(found.whitened, whitened, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.spreads, np.diagonal(root), rtol=0, atol=1e-9)


@pytest.mark.parametrize("left_out", range(READINGS))
def test_a_reading_that_is_missing_says_nothing(left_out: int):
    """The result is that of the textbook without this reading, though it is NaN."""
    example = Example(5)
    kept = [number for number in range(READINGS) if number != left_out]
    mean, covariance, _, density = example.joint(kept)
    example.innovation[left_out] = np.nan
    found = example.updated(np.arange(READINGS) != left_out)
    np.testing.assert_allclose(found.state.mean, mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.state.covariance, covariance, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.log_densities.sum(), density, rtol=0, atol=1e-9)
    assert found.whitened[left_out] == found.log_densities[left_out] == 0
    np.testing.assert_array_equal(found.gain[:, left_out], 0)


def test_without_any_reading_the_state_stays():
    example = Example(6)
    example.innovation[:] = np.nan
    found = example.updated(np.zeros(READINGS, bool))
    np.testing.assert_array_equal(found.state.mean, example.mean)
    np.testing.assert_array_equal(found.state.covariance, example.covariance)


@pytest.mark.parametrize("driven", [STATES, 3])
def test_a_step_moves_the_covariance_by_its_slope_and_adds_its_noise(driven: int):
    random, example = np.random.default_rng(7), Example(7)
    slope = random.normal(size=(driven, driven))
    decay = random.uniform(size=STATES - driven)
    noise = np.diag(random.uniform(size=STATES))
    mean = random.normal(size=STATES)
    predicted = time_update(
        example.gaussian,
        jnp.asarray(mean),
        jnp.asarray(slope),
        jnp.asarray(decay),
        jnp.asarray(noise),
    )
    whole = np.diag(np.append(np.zeros(driven), decay))
    whole[:driven, :driven] = slope
    expected = whole @ example.covariance @ whole.T + noise
    np.testing.assert_array_equal(predicted.mean, mean)
    np.testing.assert_allclose(predicted.covariance, expected, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(predicted.covariance, np.asarray(predicted.covariance).T)


def test_readings_within_four_standard_deviations_need_no_caution():
    cautious = slice(3, STATES)
    example = Example(8)
    assert np.abs(np.asarray(example.updated().whitened)).max() < CAUTION_SIGMAS
    found = example.updated(cautious=cautious)
    np.testing.assert_array_equal(found.state.mean, example.updated().state.mean)
    np.testing.assert_array_equal(found.state.covariance, example.updated().state.covariance)


@pytest.mark.parametrize("size", [5.0, 50.0])
def test_a_surprise_moves_cautious_entries_as_far_as_one_of_four_standard_deviations(size: float):
    """Other entries move in full. The covariance is that of Joseph's form with the smaller gain."""
    cautious = slice(3, STATES)
    example = Example(9)
    row, before = example.slope[0], example.covariance
    spread = row @ before @ row + example.variance[0]
    example.innovation[0] = size * np.sqrt(spread)
    found = example.updated(np.arange(READINGS) == 0, cautious)
    change = np.asarray(found.state.mean) - example.mean
    whole = before @ row / spread * example.innovation[0]
    np.testing.assert_allclose(change[:3], whole[:3], rtol=0, atol=1e-9)
    limited = whole[cautious] * CAUTION_SIGMAS / size
    np.testing.assert_allclose(change[cautious], limited, rtol=0, atol=1e-9)
    gain = before @ row / spread * np.where(np.arange(STATES) >= 3, CAUTION_SIGMAS / size, 1.0)
    left = np.eye(STATES) - np.outer(gain, row)
    joseph = left @ before @ left.T + example.variance[0] * np.outer(gain, gain)
    np.testing.assert_allclose(found.state.covariance, joseph, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_accurate_readings_leave_a_symmetric_and_positive_covariance():
    """They are a million times as accurate as the state before, and nearly all alike."""
    random, count = np.random.default_rng(10), 100
    found = Gaussian(jnp.zeros(STATES), 1e6 * jnp.eye(STATES))
    rows = random.normal(size=STATES) + 1e-3 * random.normal(size=(count, STATES))
    for number in range(count):
        found = _after_accurate_reading(found, jnp.asarray(rows[number]))
        covariance = np.asarray(found.covariance)
        np.testing.assert_array_equal(covariance, covariance.T)
        assert np.linalg.eigvalsh(covariance).min() > 0


@jax.jit
def _after_accurate_reading(state: Gaussian, row: jax.Array) -> Gaussian:
    all_of_it = jnp.ones(1, bool)
    variance = jnp.full(1, 1e-6)
    return measurement_update(state, jnp.zeros(1), row[None], variance, all_of_it, slice(0)).state
