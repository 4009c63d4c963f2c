"""Recursive statistics against the same written as loops and sums."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from jaxtwin.monitoring._cumulative import (
    ENERGY_SAMPLES,
    REFERENCE,
    WINDOW_SAMPLES,
    CumulativeSums,
    LikelihoodWindow,
    energy_after,
    joint_ratio,
)

pytestmark = pytest.mark.usefixtures("float64")
CHANNELS = 3


def series(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Innovations, and which of them were read."""
    random = np.random.default_rng(seed)
    return random.normal(size=(count, CHANNELS)), random.uniform(size=(count, CHANNELS)) > 0.2


def test_sums_are_those_of_page_and_know_what_came_since_they_were_zero():
    x, used = series(150)
    sums = CumulativeSums.zero(CHANNELS)
    up, since, total, count = np.zeros((4, CHANNELS))
    for row, there in zip(x, used, strict=True):
        sums = sums.after(
            jnp.asarray(row), jnp.asarray(2 * row), jnp.asarray(there), jnp.asarray(0.5),
            jnp.asarray(np.inf),
        )  # fmt: skip
        up = np.where(there, np.maximum(up + row - REFERENCE, 0), up)
        alive = up > 0
        since = np.where(alive, since + 0.5, 0)
        total = np.where(alive, total + np.where(there, 2 * row, 0), 0)
        count = np.where(alive, count + there, 0)
    np.testing.assert_allclose(sums.sums[0], up)
    np.testing.assert_allclose(sums.ages[0], since)
    np.testing.assert_allclose(sums.totals[0], total)
    np.testing.assert_allclose(sums.counts[0], count)


def test_a_sum_does_not_pass_its_ceiling():
    sums, all_read = CumulativeSums.zero(1), jnp.ones(1, bool)
    for _ in range(100):
        sums = sums.after(jnp.ones(1), jnp.ones(1), all_read, jnp.asarray(1.0), jnp.asarray(7.5))
    assert sums.sums[:, 0].tolist() == [7.5, 0.0]


def test_the_ratio_is_the_largest_over_all_onsets():
    x, used = series(WINDOW_SAMPLES + 70, seed=1)
    window = LikelihoodWindow.zero(CHANNELS)
    for row, there in zip(x, used, strict=True):
        window = window.after(
            jnp.asarray(row), jnp.asarray(row), jnp.asarray(there), jnp.asarray(1.0)
        )
    ratio, _, size = window.ratio()
    for channel in range(CHANNELS):
        last = x[used[:, channel], channel][::-1][:WINDOW_SAMPLES]
        means = np.cumsum(last) / np.arange(1, len(last) + 1)
        ratios = means**2 * np.arange(1, len(last) + 1) / 2
        assert ratio[channel] == pytest.approx(ratios.max())
        assert size[channel] == pytest.approx(means[ratios.argmax()])


def test_the_onset_and_the_size_of_a_step_are_found():
    x = np.concatenate([np.zeros(50), np.full(20, 1.5)])
    window = LikelihoodWindow.zero(1)
    for value in x:
        window = window.after(
            jnp.full(1, value), jnp.full(1, 0.1 * value), jnp.ones(1, bool), jnp.asarray(3.0)
        )
    ratio, age, size = window.ratio()
    assert float(ratio[0]) == pytest.approx(1.5**2 * 20 / 2)
    assert float(age[0]) == 60.0
    assert float(size[0]) == pytest.approx(0.15)


def test_the_time_since_an_onset_goes_on_without_readings():
    """A channel that gives every third reading; a step from 1.5 on, 30 s ago."""
    window = LikelihoodWindow.zero(1)
    for second, value in enumerate(np.repeat([0.0, 1.5], [60, 30])):
        window = window.after(
            jnp.full(1, value), jnp.full(1, value), jnp.array([second % 3 == 0]), jnp.asarray(1.0)
        )
    _, age, size = window.ratio()
    assert float(age[0]) == pytest.approx(30.0, abs=3.0)
    assert float(size[0]) == pytest.approx(1.5)


@pytest.mark.slow
def test_the_joint_ratio_is_as_unlikely_as_that_of_one_channel():
    # A chi-squared variable of C degrees of freedom against a normal one: Wilson and Hilferty.
    for channels, share in ((2, 0.08), (5, 0.04), (15, 0.02)):
        for chance in (1e-3, 1e-5, 1e-8):
            square = scipy.stats.chi2.isf(chance, channels)
            window = LikelihoodWindow.zero(channels)
            x = jnp.full(channels, np.sqrt(square / channels))
            window = window.after(x, x, jnp.ones(channels, bool), jnp.asarray(1.0))
            ratio, _, size = joint_ratio(window)
            normal = scipy.stats.norm.isf(chance)
            assert float(jnp.sqrt(2 * ratio)) == pytest.approx(normal, rel=share)
            assert float(size) == pytest.approx(float(x[0]))


def test_the_energy_is_a_mean_square_that_forgets():
    energy, all_read = jnp.ones(1), jnp.ones(1, bool)
    for _ in range(int(ENERGY_SAMPLES)):
        energy = energy_after(energy, jnp.full(1, 3.0), all_read)
    share = 1 - (1 - 1 / ENERGY_SAMPLES) ** ENERGY_SAMPLES
    assert float(energy[0]) == pytest.approx(1 + 8 * share)
    assert float(energy_after(energy, jnp.zeros(1), ~all_read)[0]) == float(energy[0])
