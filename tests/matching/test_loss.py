"""The loss of a match: against published formulas, scipy's robust least squares, and the scatter of
estimates; and a loss of a user's own."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import least_squares

from jaxtwin import Experiment, Fit, Twin, match, response, simulate
from jaxtwin.errors import MatchError, ParameterError
from jaxtwin.matching import AbstractLoss, Cauchy, Huber, register_loss
from jaxtwin.matching._autocovariance import ResidualSeries, fit_noise
from jaxtwin.matching._fit import solution_of
from jaxtwin.matching._loss import (
    checked_loss,
    influence_variance,
    loss_weights,
    saved_loss,
)

FREE = ("C_load", "R_E", "T_amb")
TRUTH = {"C_load": 24.0, "R_E": 1.9, "T_amb": 21.0}


@register_loss
class Tukey(AbstractLoss):
    """Tukey's biweight: an outlier beyond the threshold does not count at all."""

    kind = "own-tukey"
    threshold: float = 4.685

    def cost(self, residual):
        inside = jnp.minimum((residual / self.threshold) ** 2, 1.0)
        return self.threshold**2 / 6 * (1 - (1 - inside) ** 3)


def recording(outlier: float = 3.0) -> Experiment:
    """Four minutes of a known single cell, with white noise and outliers of one sign."""
    drive = Experiment.schedule("0:0.4,120:-0.3", duration=240, channels=("T",))
    rng = np.random.default_rng(0)
    seen = simulate(Twin("single-cell", TRUTH), drive).temperatures
    seen = seen + 0.05 * rng.standard_normal(seen.shape)
    seen[5::12] += outlier * rng.random(seen[5::12].shape)
    return Experiment(drive.time, drive.duty, channels=("T",), temperatures=seen, name="day")


def fitted(loss: AbstractLoss | None, outlier: float = 3.0) -> Fit:
    return match(Twin("single-cell"), recording(outlier), free=FREE, loss=loss)


def every(residuals: np.ndarray) -> np.ndarray:
    return np.ones(residuals.shape, dtype=bool)


def standardised(residuals: np.ndarray) -> np.ndarray:
    return residuals / (1.4826 * np.median(np.abs(residuals)))


def test_hubers_weights_fall_as_one_over_the_residual():
    residuals = np.append(np.random.default_rng(2).normal(size=1000), [10.0, 20.0])
    weights, curvature = loss_weights(Huber(3.0), residuals, every(residuals))
    expected = np.minimum(1.0, 3.0 / np.abs(standardised(residuals)))
    np.testing.assert_allclose(weights, expected, rtol=1e-14)
    np.testing.assert_array_equal(weights == 1.0, expected == 1.0)
    np.testing.assert_array_equal(curvature, weights == 1.0)


def test_cauchys_weights_and_curvature_are_those_of_its_formula():
    residuals = np.append(np.random.default_rng(2).normal(size=1000), [0.0, 20.0, 5000.0])
    weights, curvature = loss_weights(Cauchy(2.0), residuals, every(residuals))
    squared = (standardised(residuals) / 2.0) ** 2
    np.testing.assert_allclose(weights, 1 / (1 + squared), rtol=1e-12)
    np.testing.assert_allclose(curvature, (1 - squared) / (1 + squared) ** 2, rtol=1e-9)


def test_samples_that_do_not_count_do_not_set_the_scale_of_those_that_do():
    residuals = np.concatenate([np.random.default_rng(2).normal(size=100), np.full(200, 50.0)])
    weights, _ = loss_weights(Huber(3.0), residuals, np.arange(300) < 100)
    assert np.all(weights[100:] < 0.1)
    alone, _ = loss_weights(Huber(3.0), residuals[:100], np.ones(100, dtype=bool))
    np.testing.assert_array_equal(weights[:100], alone)


@pytest.mark.parametrize("loss", [None, Huber(3.0)])
def test_residuals_of_zero_have_full_weight(loss: AbstractLoss | None):
    weights, curvature = loss_weights(loss, np.zeros(5), np.ones(5, bool))
    np.testing.assert_array_equal([weights, curvature], np.ones((2, 5)))


@pytest.mark.parametrize("threshold", [0.5, 1.345, 3.0])
def test_the_variance_of_hubers_influence_is_that_of_limited_normal_numbers(threshold: float):
    density = lambda z: np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)  # noqa: E731
    integrand = lambda z: min(z**2, threshold**2) * density(z)  # noqa: E731
    expected = quad(integrand, -12, 12, points=[-threshold, threshold])[0]
    assert influence_variance(Huber(threshold)) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("loss", [Huber(1.345), Cauchy(2.385), Tukey(4.685)])
def test_the_usual_thresholds_are_as_efficient_as_published(loss: AbstractLoss):
    """At normal residuals the efficiency E[psi']^2 / E[psi^2] is 95 % (Holland and Welsch 1977)."""
    numbers = np.random.default_rng(0).standard_normal(400_000)
    _, curvature = loss_weights(loss, numbers, every(numbers))
    efficiency = curvature.mean() ** 2 / influence_variance(loss)
    assert efficiency == pytest.approx(0.95, abs=0.005)


@pytest.mark.slow
@pytest.mark.parametrize("outlier", [0.0, 30.0])
def test_standard_errors_with_cauchys_loss_are_the_scatter_of_its_estimates(outlier: float):
    """Of y = X b + e with white noise and one outlier in 25 samples, of either sign, the estimates
    are those of scipy's `least_squares` for 200 draws of the noise."""
    times, limit = 400, 2.385
    time = np.arange(times) / times
    slopes = np.stack([np.ones(times), time, np.exp(-40 * time)], axis=1)
    estimates, variances = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        is_outlier = rng.random(times) < 0.04
        noise = rng.standard_normal(times) + outlier * is_outlier * rng.choice([-1.0, 1.0], times)
        left = lambda b, noise=noise: noise - slopes @ b  # noqa: E731
        found = least_squares(left, np.zeros(3), loss="cauchy", f_scale=limit)
        # The robust standard deviation that `loss_weights` divides by is multiplied back.
        scale = 1.4826 * np.median(np.abs(found.fun))
        weights, curvature = loss_weights(Cauchy(limit / scale), found.fun, every(found.fun))
        series = ResidualSeries(
            kind=0,
            recording=0,
            residuals=(weights * found.fun)[:, None],
            slopes=slopes[:, None],
            entries=np.arange(3),
            curvature=curvature[:, None],
            roots=np.ones((times, 1)),
            channels=1.0,
            independent=1.0,
        )
        inverse = np.linalg.inv(slopes.T @ (curvature[:, None] * slopes))
        _, meat = fit_noise([series], inverse, np.zeros((3, 3)))
        estimates.append(found.x)
        variances.append(np.diag(inverse @ meat @ inverse))
    ratio = np.mean(variances, axis=0) / np.var(estimates, axis=0)
    assert np.all((ratio > 0.75) & (ratio < 1.5)), ratio


@pytest.mark.slow
@pytest.mark.parametrize(("name", "loss"), [("huber", Huber(2.0)), ("cauchy", Cauchy(2.0))])
def test_a_match_finds_the_estimate_of_scipys_robust_least_squares(
    name: str, loss: Huber | Cauchy, float64
):
    """With the scale of the residuals that the match ends with. Its last rounds change weights by
    a tenth at most, and the values by less than a tenth of their standard errors, which are those
    of the sandwich for white noise from the Jacobian of the simulation."""
    seen, fit, twin = recording(), fitted(loss), Twin("single-cell")
    start = np.array([fit[free].value for free in FREE])

    def errors(values: jax.Array) -> jax.Array:
        given: dict[str, jax.Array] = dict(zip(FREE, values, strict=True))
        found = response(twin.with_values(given), seen)
        return (found - jnp.asarray(seen.temperatures)).ravel()

    solve = jax.jit(errors)
    scale = 1.4826 * np.median(np.abs(solve(jnp.asarray(start))))
    found = least_squares(
        lambda values: np.asarray(solve(jnp.asarray(values))),
        1.01 * start,
        jac="3-point",
        loss=name,
        f_scale=loss.threshold * scale,
        x_scale=start,
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
    )
    left, slopes = found.fun, np.asarray(jax.jacfwd(errors)(jnp.asarray(found.x)))
    weights, curvature = loss_weights(loss, left, every(left))
    inverse = np.linalg.inv(slopes.T @ (curvature[:, None] * slopes))
    sandwich = inverse @ slopes.T @ slopes @ inverse * np.mean((weights * left) ** 2)
    for number, free in enumerate(FREE):
        row, expected = fit[free], np.sqrt(sandwich[number, number])
        assert abs(row.value - found.x[number]) < 0.1 * expected
        assert row.standard_error == pytest.approx(expected, rel=0.2)


@pytest.mark.slow
def test_a_users_own_loss_matches_and_comes_back_from_a_file(tmp_path: Path):
    """Readings that are far away count as if they were missing; the file has kind and fields."""
    fit = fitted(Tukey(5.0), outlier=800.0)
    seen = recording(800.0)
    assert seen.temperatures is not None
    far = np.abs(seen.temperatures - simulate(Twin("single-cell", TRUTH), seen).temperatures) > 1.0
    without = Experiment(
        seen.time,
        seen.duty,
        channels=("T",),
        temperatures=np.where(far, np.nan, seen.temperatures),
        name="day",
    )
    other = match(Twin("single-cell"), without, free=FREE)
    assert np.all(fit.weights["day"][far] < 1e-9)
    for free in FREE:
        row, plain = fit[free], other[free]
        assert abs(row.value - plain.value) < 0.5 * plain.standard_error
        assert row.standard_error == pytest.approx(plain.standard_error, rel=0.15)
        assert abs(row.value - TRUTH[free]) < 4 * row.standard_error
    path = tmp_path / "fit.toml"
    fit.save(path)
    assert 'loss = { kind = "own-tukey", threshold = 5.0 }' in path.read_text("utf-8")
    loaded = Fit.load(path)
    assert solution_of(loaded).problem.loss == Tukey(5.0)
    assert loaded["R_E"].standard_error == fit["R_E"].standard_error
    for old, new, words in (
        (
            'kind = "own-tukey"',
            'kind = "biweight"',
            "expected the kind huber, .*got 'biweight'",
        ),
        ("threshold = 5.0", "limit = 5.0", r"expected the fields \['threshold'\] of Tukey"),
    ):
        path.write_text(path.read_text("utf-8").replace(old, new), "utf-8")
        with pytest.raises(ParameterError, match=f"fit.toml: fit.loss: {words}"):
            Fit.load(path)
        path.write_text(path.read_text("utf-8").replace(new, old), "utf-8")


def test_a_class_that_is_not_registered_is_refused_when_a_fit_is_saved():
    class Mine(AbstractLoss):
        def cost(self, residual):
            return jnp.sqrt(1 + residual**2) - 1

    assert checked_loss(Mine()) == Mine()
    with pytest.raises(MatchError, match=r"Mine: .* not registered; call .*register_loss"):
        saved_loss(Mine())
    with pytest.raises(MatchError, match=r"Mine.kind: expected its name .* got ''"):
        register_loss(Mine)
    Mine.kind = "huber"
    with pytest.raises(MatchError, match=r"Mine.kind: .* not taken, got 'huber' of Huber"):
        register_loss(Mine)


class TooLarge(AbstractLoss):
    def cost(self, residual):
        return residual**2


class Sum(AbstractLoss):
    def cost(self, residual):
        return jnp.abs(residual)


class Branch(AbstractLoss):
    def cost(self, residual):
        return residual if residual > 2 else residual**2 / 2


class Text(AbstractLoss):
    threshold: str = "large"

    def cost(self, residual):
        return residual**2 / 2


@pytest.mark.parametrize(
    ("loss", "words"),
    [
        (TooLarge(), "TooLarge.cost: expected .* weights from 2 to 2"),
        (Sum(), "Sum.cost: expected .* weights from 0.001 to 1e.03"),
        (Branch(), "Branch.cost: .*jnp.where in place of if.*, got TracerBool"),
        (Text(), "Text.threshold: expected a finite number, got 'large'"),
    ],
)
def test_a_cost_that_is_no_loss_is_refused(loss: AbstractLoss, words: str):
    with pytest.raises(MatchError, match=words):
        checked_loss(loss)
