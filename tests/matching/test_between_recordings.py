"""How much a rig differs between recordings, in a linear model whose random effects are known."""

import numpy as np
import pytest

from jaxtwin.matching._group_values import RecordingScore, estimate_heterogeneity

PRIOR_SPREADS = np.array([0.5, 2.0, 1.0])
SAMPLES = 200


def scores(tau: float, recordings: int, seed: int) -> tuple[list[RecordingScore], np.ndarray]:
    """Scores at the least-squares match of recordings with an offset of their own each.

    Three shared parameters with priors, whose values differ by `tau` prior deviations, white noise
    of 1, and a fourth unknown for each recording, without a prior.
    """
    rng = np.random.default_rng(seed)
    size = 3 + recordings
    blocks, observed = [], []
    for number in range(recordings):
        slopes = np.zeros((SAMPLES, size))
        slopes[:, :3] = rng.standard_normal((SAMPLES, 3)) * [3.0, 0.5, 1.0]
        slopes[:, 3 + number] = 1.0
        truth = rng.standard_normal(size)
        truth[:3] = tau * PRIOR_SPREADS * rng.standard_normal(3)
        blocks.append(slopes)
        observed.append(slopes @ truth + rng.standard_normal(SAMPLES))
    prior = np.zeros((size, size))
    prior[:3, :3] = np.diag(1 / PRIOR_SPREADS**2)
    normal = sum(block.T @ block for block in blocks) + prior
    match = np.linalg.solve(normal, sum(b.T @ y for b, y in zip(blocks, observed, strict=True)))
    made = []
    for slopes, values in zip(blocks, observed, strict=True):
        information = slopes.T @ slopes
        made.append(RecordingScore(slopes.T @ (slopes @ match - values), information, information))
    return made, prior


@pytest.mark.parametrize("tau", [0.1, 0.3, 1.0])
def test_the_spread_of_random_effects_is_found(tau: float):
    """The root mean square over forty data sets of eight recordings."""
    found = [
        estimate_heterogeneity(*scores(tau, 8, seed), np.arange(3), PRIOR_SPREADS)
        for seed in range(40)
    ]
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(tau, rel=0.25)


def test_recordings_of_one_rig_differ_by_little():
    """Less than what their noise leaves open of a single one."""
    found = estimate_heterogeneity(*scores(0.0, 8, 1), np.arange(3), PRIOR_SPREADS)
    assert found < 0.05


def test_with_one_recording_the_heterogeneity_is_that_of_its_prior():
    """What is left is the prior: a half-normal distribution with a scale of a quarter."""
    found = estimate_heterogeneity(*scores(0.5, 1, 0), np.arange(3), PRIOR_SPREADS)
    assert found == pytest.approx(0.25, rel=0.01)


def test_parameters_without_a_prior_are_the_same_in_all_recordings():
    made, prior = scores(0.0, 4, 2)
    found = estimate_heterogeneity(made, prior, np.arange(3), np.zeros(3))
    assert np.isfinite(found)
