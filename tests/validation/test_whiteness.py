"""Tests of whiteness against what is known of white and of autoregressive noise."""

import numpy as np
import pytest
from scipy.stats import norm

from jaxtwin._statistics import QUANTILE_975, autocorrelation, normal_quantiles
from jaxtwin.validation import Whiteness, whiteness, whiteness_of_channels
from jaxtwin.validation._validation import holm_adjusted


def autoregressive(seed: int, samples: int, factor: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    series = np.zeros(samples)
    for number, shock in enumerate(rng.standard_normal(samples)):
        series[number] = factor * series[number - 1] + shock
    return series


def test_autocorrelation_is_that_of_the_definition():
    series = np.random.default_rng(0).standard_normal(50)
    about = series - series.mean()
    expected = [np.sum(about[: 50 - k] * about[k:]) / np.sum(about**2) for k in range(8)]
    np.testing.assert_allclose(autocorrelation(series, 7), expected, atol=1e-12)


def test_autocorrelation_of_a_first_order_process_falls_geometrically():
    found = autocorrelation(autoregressive(1, 200_000, 0.8), 5)
    np.testing.assert_allclose(found, 0.8 ** np.arange(6), atol=0.02)


def test_white_noise_is_rejected_as_often_as_the_level_says():
    """P-values of white noise are evenly spread: 1 in 20 lies below 0.05."""
    rng = np.random.default_rng(2)
    values = [whiteness(rng.standard_normal(500)).p_value for _ in range(1000)]
    rejected = np.mean(np.array(values) < 0.05)
    assert abs(rejected - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 1000)
    assert abs(np.mean(values) - 0.5) < 0.05


def test_ljung_and_boxs_statistic_by_hand():
    """Alternating 1, -1: the autocorrelation at lag k is (-1)^k (n - k) / n."""
    series = np.array([1.0, -1.0] * 5)
    k = np.arange(1, 3)
    expected = 10 * 12 * np.sum(((10 - k) / 10) ** 2 / (10 - k))
    test = whiteness(series)
    assert test.lags == 2
    assert test.statistic == pytest.approx(expected)
    assert not test.is_white


@pytest.mark.parametrize(("p_value", "is_white"), [(0.01, True), (0.0099, False)])
def test_whiteness_is_rejected_below_one_per_cent(p_value, is_white):
    assert Whiteness(0.0, 1, p_value, 1.0).is_white is is_white


def test_missing_samples_leave_the_test_as_it_is():
    """Stoffer and Toloi 1992: white noise of which a third is missing is rejected as often."""
    rng = np.random.default_rng(4)
    values = []
    for _ in range(600):
        series = rng.standard_normal(300)
        series[rng.random(300) < 1 / 3] = np.nan
        values.append(whiteness(series).p_value)
    rejected = np.mean(np.array(values) < 0.05)
    assert abs(rejected - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 600)


def test_autocorrelation_is_over_the_pairs_that_are_there():
    series = autoregressive(5, 200_000, 0.8)
    series[np.random.default_rng(6).random(200_000) < 0.5] = np.nan
    np.testing.assert_allclose(autocorrelation(series, 5), 0.8 ** np.arange(6), atol=0.02)


def test_lags_without_any_pair_do_not_count():
    series = np.where(np.arange(100) % 2, np.nan, np.random.default_rng(7).standard_normal(100))
    assert whiteness(series).lags == 5  # of ten, the even ones
    with pytest.raises(ValueError, match="expected at least 10 samples, got 9"):
        whiteness(np.append(np.full(50, np.nan), np.arange(9.0)))


def test_correlated_noise_is_no_white_noise_and_counts_less():
    """A first-order process with factor 1/2 has (1 + f) / (1 - f) = 3 samples for one."""
    test = whiteness(autoregressive(3, 50_000, 0.5))
    assert not test.is_white
    assert test.autocorrelation_time == pytest.approx(3.0, rel=0.1)


def test_a_lag_without_a_pair_has_no_autocorrelation():
    """Samples 0, 1 and 5 of six, by hand: the only neighbours give -1, and none are 2 apart."""
    series = np.array([1.0, -1.0, np.nan, np.nan, np.nan, 0.0])
    np.testing.assert_allclose(autocorrelation(series, 2), [1.0, -1.25, 0.0], atol=1e-12)


def test_a_series_that_never_changes_has_no_autocorrelation():
    np.testing.assert_array_equal(autocorrelation(np.ones(20), 4), np.zeros(5))


def test_quantiles_are_those_of_the_normal_distribution():
    quantiles = normal_quantiles(9999)
    assert quantiles[4999] == pytest.approx(0.0, abs=1e-12)
    assert quantiles[9749] == pytest.approx(1.96, abs=1e-2)
    np.testing.assert_allclose(quantiles, -quantiles[::-1], atol=1e-12)
    assert norm.cdf(QUANTILE_975) == pytest.approx(0.975, abs=1e-15)


def test_too_few_samples_are_refused():
    with pytest.raises(ValueError, match="expected at least 10 samples, got 9"):
        whiteness(np.zeros(9))


@pytest.mark.slow
@pytest.mark.parametrize(("samples", "most"), [(2000, 0.01), (400, 0.03)])
def test_white_noise_of_many_channels_is_rarely_called_not_white(samples: int, most: float):
    """Holm 1979. Without the adjustment, one of 15 channels is below 1 % in 12 to 24 % of
    recordings. The far tail of Ljung and Box's statistic is that of chi-squared only for many
    samples."""
    rng = np.random.default_rng(8)
    noise = rng.standard_normal((300, samples, 15))
    alarms = [not all(test.is_white for test in whiteness_of_channels(each)) for each in noise]
    assert np.mean(alarms) < most + 3 * np.sqrt(most * (1 - most) / 300)
    plain = [any(not whiteness(series).is_white for series in each.T) for each in noise[:60]]
    assert np.mean(plain) > 0.05


def test_a_channel_that_is_not_white_is_found_beside_white_ones():
    series = np.random.default_rng(9).standard_normal((500, 15))
    series[:, 3] = autoregressive(10, 500, 0.5)
    white = [test.is_white for test in whiteness_of_channels(series)]
    assert white == [number != 3 for number in range(15)]


def test_adjusted_p_values_are_those_of_holm():
    """By hand: 3 x 0.01, 2 x 0.02 and 0.03, none below the one before."""
    assert holm_adjusted([0.03, 0.01, 0.02]) == pytest.approx([0.04, 0.03, 0.04])
    assert holm_adjusted([0.6, 0.7]) == [1.0, 1.0]
