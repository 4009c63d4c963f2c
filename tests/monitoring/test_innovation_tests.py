"""Single large innovations say nothing; those that last count, also while they were held."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin.monitoring import Evidence, ObservedSample
from jaxtwin.monitoring._innovation_tests import (
    MASK_SECONDS_AFTER_JUMP,
    RESET_SCORE,
    InnovationTests,
)

pytestmark = pytest.mark.usefixtures("float64")
LIMITS = np.array([16.0, 20.0, 20.0, 3.6])


def said_of(
    z: np.ndarray, memory: float = 0.0, since_correction: float = np.inf
) -> tuple[Evidence, ...]:
    """What the tests say of standardised innovations, a second apart, of 0.1 K; with the time since
    the last correction of a camera that corrects itself every 100 s, at the first sample."""
    tests = InnovationTests(
        scales=np.ones(z.shape[1]),
        lag_one_correlation=np.full(z.shape[1], memory),
        thresholds=LIMITS,
        reset_score=np.array(RESET_SCORE),
        interval=100.0,
    )
    none = np.zeros(len(z))
    readings = np.where(np.isfinite(z), 0.1 * z, np.nan)
    samples = ObservedSample(
        readings=readings,
        expected=np.zeros_like(z),
        whitened=np.nan_to_num(z),
        mean=none[:, None],
        slope=np.zeros_like(z),
        duty=none[:, None],
        ambient=none,
        dt=np.ones(len(z)),
        since_correction=since_correction + np.arange(len(z)),
        rejected=np.zeros_like(z),
        is_inside=np.ones_like(z, dtype=bool),
    )

    def take(state, sample):
        return tests.step(state, sample, sample.dt, jnp.asarray(True))

    return jax.lax.scan(take, tests.init(), samples)[1]


def largest(found: tuple[Evidence, ...]) -> float:
    return max(float(one.score.max()) for one in found if one.score.shape[1])


def noise(seed: int = 0, channels: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(400, channels))


@pytest.mark.parametrize("size", [6.0, 30.0, 1e6])
def test_a_correction_that_fades_raises_nothing(size: float):
    z = noise()
    z[200:207, 0] += size * np.exp(-np.arange(7) / 2)
    assert largest(said_of(z)) < 0.9


def test_a_correction_of_all_channels_raises_nothing():
    z = noise(channels=5)
    z[200] += 12.0
    assert largest(said_of(z)) < 0.9


def test_a_change_that_lasts_counts_from_its_first_sample():
    z = noise()
    z[200:] += 5.0
    of_sum = said_of(z)[0]
    found = int(np.argmax(np.asarray(of_sum.score[:, 0]) >= 1))
    assert 200 < found <= 200 + MASK_SECONDS_AFTER_JUMP
    assert found - float(of_sum.age[found, 0]) == pytest.approx(199, abs=2)
    assert float(of_sum.size[found, 0]) == pytest.approx(0.5, abs=0.1)


def test_a_change_of_one_channel_is_not_held():
    z = noise(channels=5)
    z[200:, 2] += 5.0
    of_sum = said_of(z)[0]
    found = np.argmax(np.asarray(of_sum.score) >= 1, axis=0)
    assert 200 < found[2] <= 206
    assert found[[0, 1, 3, 4]].tolist() == [0, 0, 0, 0]


def test_a_small_change_of_all_channels_is_found_by_all_together():
    z = noise(channels=15)
    z[200:] += 0.45 * np.resize([1.0, -1.0], 15)
    of_sum, of_ratio, of_joint, _ = said_of(z)
    found = int(np.argmax(np.asarray(of_joint.score[:, 0]) >= 1))
    assert 200 < found < 250
    assert float(of_sum.score[found].max()) < 1
    assert float(of_ratio.score[found].max()) < 1


def test_a_louder_channel_is_found_by_its_energy():
    z = noise()
    z[200:] *= 3.0
    of_energy = said_of(z)[3]
    assert float(of_energy.score[199].max()) < 0.6
    assert float(of_energy.score[230:].max()) > 1


def test_a_missing_reading_leaves_the_statistics():
    z = noise()
    z[200:260] = np.nan
    found = said_of(z)
    for one in found[:2]:
        assert np.ptp(np.asarray(one.score[200:260])) == 0


def test_memory_is_taken_out():
    # An autoregressive process of variance 1 becomes white: the energy stays that of noise.
    white = np.random.default_rng(5).normal(size=400)
    z = np.zeros((400, 1))
    for n in range(1, 400):
        z[n] = 0.9 * z[n - 1] + np.sqrt(1 - 0.81) * white[n]
    assert largest(said_of(z, memory=0.9)) < 0.9
    assert largest(said_of(z)[:2]) > 1


@pytest.mark.parametrize(("since", "is_quiet"), [(0.0, True), (50.0, False), (np.inf, False)])
def test_a_correction_that_is_due_is_no_finding(since: float, is_quiet: bool):
    """A common shift that is too small for a jump, and over after five seconds."""
    z = np.random.default_rng(8).normal(0, 0.3, (120, 5))
    z[99:104] += 2.5
    assert (largest(said_of(z, since_correction=since)) < 1) == is_quiet
