"""Noise behind residuals: against covariances written down and processes whose statistics are
known."""

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from jaxtwin.matching._autocovariance import ResidualSeries, apply_autocorrelation, fit_noise
from jaxtwin.matching._noise_model import estimate_noise
from jaxtwin.matching._uncertainty import VectorEntries, uncertainty

TIMES, CHANNELS, RHO = 400, 4, float(np.exp(-1 / 8))
NOTHING = np.zeros((3, 3))


def slow_and_fast() -> np.ndarray:
    """Slopes of a linear model `(times, channels, unknowns)`: a level, a rise, a fast transient."""
    time = np.arange(TIMES) / TIMES
    shapes = np.stack([np.ones(TIMES), time, np.exp(-40 * time)], axis=1)
    return np.repeat(shapes[:, None], CHANNELS, axis=1)


def first_order(rng: np.random.Generator, rho: float) -> np.ndarray:
    """A stationary first-order process with a variance of 1."""
    steps = rng.standard_normal((TIMES + 100, CHANNELS))
    return np.asarray(lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], steps, axis=0))[100:]


def residuals_of(
    noise: np.ndarray, slopes: np.ndarray, roots: np.ndarray | None = None
) -> tuple[ResidualSeries, np.ndarray]:
    """What least squares leave of the noise, and the inverse of their normal equations."""
    roots = np.ones(noise.shape) if roots is None else roots
    slopes = slopes * roots[..., None]
    flat = slopes.reshape(-1, slopes.shape[-1])
    inverse = np.linalg.inv(flat.T @ flat)
    left = roots * noise
    left = left - (flat @ inverse @ flat.T @ left.ravel()).reshape(noise.shape)
    size = float(CHANNELS)
    entries = np.arange(slopes.shape[-1])
    every = np.ones(noise.shape)
    return ResidualSeries(0, 0, left, slopes, entries, every, roots, size, size), inverse


def test_apply_autocorrelation_is_the_product_with_the_toeplitz_matrix():
    table = np.random.default_rng(0).standard_normal((50, 2, 3))
    matrix = toeplitz(RHO ** np.arange(50))
    expected = np.einsum("ts,sij->tij", matrix, table)
    (result,) = apply_autocorrelation(np.array([RHO]), table)
    np.testing.assert_allclose(result, expected, atol=1e-12)


def test_the_meat_is_that_of_the_estimated_autocovariance():
    # J^T Gamma J written out, samples that count half or not at all among them.
    rng = np.random.default_rng(1)
    roots = np.ones((TIMES, CHANNELS))
    roots[50:80], roots[200:220, 1] = 0.0, 0.7
    series, inverse = residuals_of(first_order(rng, RHO), slow_and_fast(), roots)
    (mixture,), meat = fit_noise([series], inverse, NOTHING)
    lags = np.arange(TIMES)
    gamma = toeplitz(sum(v * r**lags for v, r in zip(mixture.variances, mixture.rho, strict=True)))
    expected = np.zeros((3, 3))
    for channel in range(CHANNELS):
        weighted = series.roots[:, channel, None] * series.slopes[:, channel]
        expected += weighted.T @ gamma @ weighted
    np.testing.assert_allclose(meat, expected, rtol=1e-9)


@pytest.mark.slow
def test_a_linear_model_in_first_order_noise_has_the_covariance_of_the_theory():
    # Least squares of y = X b + e: cov b = (X'X)^-1 X' Gamma X (X'X)^-1, Gamma_ts = rho^|t-s|.
    slopes = slow_and_fast()
    gamma = toeplitz(RHO ** np.arange(TIMES))
    normal = np.einsum("tci,tcj->ij", slopes, slopes)
    theory = np.einsum("tci,ts,scj->ij", slopes, gamma, slopes, optimize=True)
    theory = np.linalg.inv(normal) @ theory @ np.linalg.inv(normal)
    labels, every = ("level", "rise", "transient"), np.ones(3, dtype=bool)
    entries = VectorEntries(labels, np.zeros((3, 3)), np.ones(3), np.ones(3), every)
    found = []
    for seed in range(40):
        noise = first_order(np.random.default_rng(seed), RHO)
        series, inverse = residuals_of(noise, slopes)
        _, meat = fit_noise([series], inverse, NOTHING)
        result = uncertainty(entries, normal, meat)
        np.testing.assert_allclose(result.covariance, inverse @ meat @ inverse, rtol=1e-6)
        found.append(np.diag(result.covariance))
    # No part of the noise can be negative: on average a little too much is found.
    ratio = np.mean(found, axis=0) / np.diag(theory)
    assert np.all((ratio > 0.95) & (ratio < 1.25))


@pytest.mark.slow
@pytest.mark.parametrize("outlier", [0.0, 30.0, 3000.0])
def test_standard_errors_with_hubers_loss_are_the_scatter_of_its_estimates(outlier: float):
    """Of y = X b + e with white noise and one outlier in 25 samples, of either sign, the estimates
    by Huber's loss are found by Newton's method, for 200 draws of the noise."""
    slopes, limit = slow_and_fast()[:, :1], 2.0
    flat, estimates, variances = slopes[:, 0], [], []

    def hubers(residuals: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        inlying = np.abs(residuals) < limit
        return np.clip(residuals, -limit, limit), inlying, flat[inlying].T @ flat[inlying]

    for seed in range(200):
        rng = np.random.default_rng(seed)
        is_outlier = rng.random(TIMES) < 0.04
        noise = rng.standard_normal(TIMES) + outlier * is_outlier * rng.choice([-1.0, 1.0], TIMES)
        b = np.zeros(3)
        left, inlying, normal = hubers(noise - flat @ b)
        for _ in range(50):
            b += np.linalg.solve(normal, flat.T @ left)
            left, inlying, normal = hubers(noise - flat @ b)
        series = ResidualSeries(
            kind=0,
            recording=0,
            residuals=left[:, None],
            slopes=slopes,
            entries=np.arange(3),
            curvature=inlying[:, None].astype(float),
            roots=np.ones((TIMES, 1)),
            channels=1.0,
            independent=1.0,
        )
        inverse = np.linalg.inv(normal)
        _, meat = fit_noise([series], inverse, NOTHING)
        estimates.append(b)
        variances.append(np.diag(inverse @ meat @ inverse))
    ratio = np.mean(variances, axis=0) / np.var(estimates, axis=0)
    assert np.all((ratio > 0.75) & (ratio < 1.5)), ratio


@pytest.mark.slow
def test_noise_is_not_underestimated_where_unknowns_absorb_slow_residuals():
    # Six polynomials a channel leave little of what is slow: the plain sum of autocorrelations is
    # far too small, and so is the noise that would be read from it.
    time = np.linspace(-1, 1, TIMES)
    curves = np.polynomial.legendre.legvander(time, 5)
    slopes = np.zeros((TIMES, CHANNELS, 6 * CHANNELS))
    for channel in range(CHANNELS):
        slopes[:, channel, 6 * channel : 6 * channel + 6] = curves
    true = (1 + RHO) / (1 - RHO)
    plain, ours = [], []
    for seed in range(30):
        noise = first_order(np.random.default_rng(seed), RHO)
        series, inverse = residuals_of(noise, slopes)
        (mixture,), _ = fit_noise([series], inverse, np.zeros(inverse.shape))
        plain.append(estimate_noise([series.residuals]).effective ** 2)
        ours.append(mixture.noise(1.0).effective ** 2)
    assert np.mean(plain) < 0.7 * true
    assert np.median(ours) == pytest.approx(true, rel=0.2)


def test_white_noise_has_no_autocorrelation_and_zero_residuals_no_noise():
    slopes = slow_and_fast()
    white = np.random.default_rng(5).standard_normal((TIMES, CHANNELS))
    series, inverse = residuals_of(0.3 * white, slopes)
    (mixture,), meat = fit_noise([series], inverse, NOTHING)
    noise = mixture.noise(2.0)
    assert noise.standard_deviation == pytest.approx(0.6, rel=0.05)
    assert noise.autocorrelation_time == pytest.approx(1.0, abs=0.3)
    series, inverse = residuals_of(0 * white, slopes)
    (mixture,), meat = fit_noise([series], inverse, NOTHING)
    assert mixture.noise(1.0).standard_deviation == 0.0
    assert not meat.any()


def test_the_variance_with_a_prior_is_one_over_the_sum_of_both_precisions():
    # One unknown: n samples of white noise of variance 1, and a prior whose standard deviation
    # is 1 / p: the variance is 1 / (n + p^2), and the recordings alone narrow it by sqrt(n) / p.
    normal = np.array([[25.0]])
    precision, scale = np.array([[4.0]]), np.array([0.5])
    entry = VectorEntries(("level",), precision, scale, np.ones(1), np.ones(1, dtype=bool))
    result = uncertainty(entry, normal, normal)
    assert result.covariance[0, 0] == pytest.approx(1 / 29)
    assert result.prior_to_data_ratio[0] == pytest.approx(2.5)
    # With noise of four times the variance the recordings narrow it half as much.
    louder = uncertainty(entry, normal, 4 * normal)
    assert louder.prior_to_data_ratio[0] == pytest.approx(1.25)
    assert louder.covariance[0, 0] == pytest.approx((100 + 4) / 29**2)
