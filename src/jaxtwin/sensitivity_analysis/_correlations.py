r"""Correlations of outputs with parameters as methods of global sensitivity analysis, and
regression of outputs on parameters: the effect of a parameter while the others are held.

With the correlations $C$ of the parameters with each other and $c$ with the output, the
standardised coefficients are $C^{-1} c$ and their share of the variance $R^2 = c^T C^{-1} c$. With
$P$ the inverse of the correlation matrix of parameters and output together, the partial correlation
is $-P_{jy} / \sqrt{P_{jj} P_{yy}}$ (Saltelli and others, "Sensitivity Analysis in Practice", 2004).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float, Int
from scipy.special import stdtrit

from ._method import AbstractPlainMethod, Design, Indices, half_width, resample_weights

# Correlation coefficients of outputs with the parameters of their draws, and their 95 % confidence
# intervals, for outputs with heavy tails.
#
# Fisher's interval is for two normal variables. A cost is not normal: a few extreme draws
# contribute most of its variance, and the interval is then too short (Yuan and Bentler 2000, on the
# distribution-free variance of a correlation). Here
#
# - the standard error is that of the infinitesimal jackknife (Efron 1982), the root mean square of
#   the draws' influences, taken on Fisher's scale, z = artanh r;
# - the quantile is Student's, with Satterthwaite's degrees of freedom for a mean square of n
#   influences with kurtosis k, 2 n / (k - 1): if the standard error depends on a few draws, it is
#   itself uncertain;
# - the interval of Pearson's correlation is extended in the direction in which the correlation
#   changes with the number of draws, because with heavy tails more draws contain more extreme ones.
#   Twice the change by a tenfold number of draws is added: the correlation of all draws minus the
#   mean correlation of ten parts.
#
# How often such intervals hold the value of very many draws, beside those of other methods, stands
# in benchmarks/NOTES.md ("Intervals of sensitivity indices").


def pearson(
    outputs: Float[np.ndarray, "draws outputs"], samples: Float[np.ndarray, "draws parameters"]
) -> Float[np.ndarray, "outputs parameters"]:
    """Computes the Pearson correlation of each output with each parameter; it is 0 if the output or
    the parameter is constant."""
    return standardised(outputs).T @ standardised(samples) / len(samples)


def spearman(
    outputs: Float[np.ndarray, "draws outputs"], samples: Float[np.ndarray, "draws parameters"]
) -> Float[np.ndarray, "outputs parameters"]:
    """Computes the Spearman rank correlation of each output with each parameter; it is 0 if the
    output or the parameter is constant."""
    return pearson(ranks(outputs), ranks(samples))


def ranks(values: Float[np.ndarray, "draws columns"]) -> Float[np.ndarray, "draws columns"]:
    """Computes the ranks in each column, from 0 to 1; equal values share their mean rank."""
    order = np.argsort(values, axis=0)
    places = [  # found faster in the order of the columns themselves
        np.searchsorted(column, column, "left") + np.searchsorted(column, column, "right")
        for column in np.take_along_axis(values, order, axis=0).T
    ]
    result = np.empty(values.shape)
    np.put_along_axis(result, order, np.stack(places, axis=1) / (2 * len(values)), axis=0)
    return result


def standardised(
    values: Float[np.ndarray, "draws columns"],
) -> Float[np.ndarray, "draws columns"]:
    """Scales columns to mean 0 and standard deviation 1; constant columns become 0."""
    centred = np.where(np.ptp(values, axis=0) > 0, values - values.mean(axis=0), 0.0)
    scale = np.sqrt(np.mean(centred**2, axis=0))
    return np.divide(centred, scale, out=np.zeros_like(centred), where=scale > 0)


# The number of parts into which draws are divided to estimate how a correlation changes with the
# number of draws.
JACKKNIFE_PARTS = 10

# The smallest number of draws in a part. With fewer, correlations are near -1 or 1 by chance.
MIN_DRAWS_IN_PART = 5

# The number of further tenfold increases of the draws after which the correlation is to remain
# inside the interval.
TENFOLDS = 2.0


def pearson_interval(
    outputs: Float[np.ndarray, "draws outputs"], samples: Float[np.ndarray, "draws parameters"]
) -> Float[np.ndarray, "outputs parameters 2"]:
    """Computes the 95 % confidence interval of each Pearson correlation.

    **Returns:** lower and upper end; -1 and 1 below four draws, or if an output or a parameter
    is constant.
    """
    y, x = standardised(outputs), standardised(samples)
    correlation = pearson(outputs, samples)
    influences = (
        y * x[:, [column]] - correlation[:, column] * (y**2 + x[:, [column]] ** 2) / 2
        for column in range(x.shape[1])
    )
    return _interval(y, x, influences, _trend(outputs, samples))


def spearman_interval(
    outputs: Float[np.ndarray, "draws outputs"], samples: Float[np.ndarray, "draws parameters"]
) -> Float[np.ndarray, "outputs parameters 2"]:
    """Computes the 95 % confidence interval of each Spearman rank correlation.

    The influence of a draw includes the shift that it causes in the ranks of the others (Croux and
    Dehon 2010, "Influence functions of the Spearman and Kendall correlation measures").

    **Returns:** lower and upper end; -1 and 1 below four draws, or if an output or a parameter
    is constant.
    """
    y, x = standardised(ranks(outputs)), standardised(ranks(samples))
    orders = np.argsort(-y, axis=0, kind="stable")
    influences = (_rank_influences(y, orders, x[:, column]) for column in range(x.shape[1]))
    return _interval(y, x, influences, 0.0)


def _rank_influences(
    y: Float[np.ndarray, "draws outputs"],
    orders: Int[np.ndarray, "draws outputs"],
    x: Float[np.ndarray, " draws"],
) -> Float[np.ndarray, "draws outputs"]:
    """The influence of each draw on the rank correlations of the outputs with one parameter, from
    standardised ranks. Its presence shifts the ranks of all draws above it by 1 / n.

    `orders` sort each output, the largest first.
    """
    # A step of one rank, in units of the standard deviation of ranks.
    step = np.sqrt(12.0) / len(y)
    own = y * x[:, None]
    order = np.argsort(-x, kind="stable")
    own[order] += step * np.cumsum(y[order], axis=0)
    shifts = np.empty_like(own)
    np.put_along_axis(shifts, orders, np.cumsum(x[orders], axis=0), axis=0)
    return own + step * shifts


def _interval(
    y: Float[np.ndarray, "draws outputs"],
    x: Float[np.ndarray, "draws parameters"],
    influences: Iterable[Float[np.ndarray, "draws outputs"]],
    trend: Float[np.ndarray, "outputs parameters"] | float,
) -> Float[np.ndarray, "outputs parameters 2"]:
    """Computes the interval from standardised columns and the influence of each draw.

    Influences are computed for one parameter at a time, because those of all parameters would take
    gigabytes for many draws.
    """
    draws = len(y)
    unknown = ~np.outer(np.any(y, axis=0), np.any(x, axis=0))
    if draws < 4:
        return np.stack([-np.ones(unknown.shape), np.ones(unknown.shape)], axis=-1)
    half = np.empty(unknown.shape)
    for column, influence in enumerate(influences):
        squares = (influence - influence.mean(axis=0)) ** 2
        square, fourth = np.mean(squares, axis=0), np.mean(squares**2, axis=0)
        kurtosis = np.divide(fourth, square**2, out=np.ones(len(square)), where=square > 0)
        freedom = np.clip(2 * draws / np.maximum(kurtosis - 1, 1e-9), 1, draws - 2)
        half[:, column] = stdtrit(freedom, 0.975) * np.sqrt(square / (draws - 1))
    z = _fisher(y.T @ x / draws)
    half *= np.cosh(z) ** 2  # how fast z changes with the correlation
    lower = np.tanh(z - half + np.minimum(trend, 0.0))
    upper = np.tanh(z + half + np.maximum(trend, 0.0))
    return np.stack([np.where(unknown, -1.0, lower), np.where(unknown, 1.0, upper)], axis=-1)


def _trend(
    outputs: Float[np.ndarray, "draws outputs"], samples: Float[np.ndarray, "draws parameters"]
) -> Float[np.ndarray, "outputs parameters"] | float:
    """The change of a correlation that more draws may bring, on Fisher's scale."""
    parts = min(JACKKNIFE_PARTS, len(outputs) // MIN_DRAWS_IN_PART)
    if parts < 2:
        return 0.0
    size = len(outputs) // parts
    spans = [slice(part * size, (part + 1) * size) for part in range(parts)]
    small = np.mean([_fisher(pearson(outputs[span], samples[span])) for span in spans], axis=0)
    return TENFOLDS * (_fisher(pearson(outputs, samples)) - small)


def _fisher(correlation: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    return np.arctanh(np.clip(correlation, -1 + 1e-12, 1 - 1e-12))


@final
@dataclass(frozen=True)
class Pearson(AbstractPlainMethod):
    """Pearson's correlation `pearson`, with its 95 % interval, `pearson_low` and `pearson_high`."""

    name = "pearson"
    main = "pearson"
    default_draws = 1000

    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        values = pearson(outputs, design.samples)
        return _with_interval("pearson", values, pearson_interval(outputs, design.samples))


@final
@dataclass(frozen=True)
class Spearman(AbstractPlainMethod):
    """Spearman's rank correlation `spearman`, with its 95 % interval, `spearman_low` and
    `spearman_high`."""

    name = "spearman"
    main = "spearman"
    default_draws = 1000

    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        values = spearman(outputs, design.samples)
        return _with_interval("spearman", values, spearman_interval(outputs, design.samples))


def _with_interval(
    name: str,
    values: Float[np.ndarray, "outputs parameters"],
    interval: Float[np.ndarray, "outputs parameters bounds"],
) -> Indices:
    return {name: values, f"{name}_low": interval[..., 0], f"{name}_high": interval[..., 1]}


@final
@dataclass(frozen=True)
class StandardisedRegression(AbstractPlainMethod):
    """Standardised regression coefficients `SRC`, with `SRC_conf`, half of their 95 % bootstrap
    interval, and `R2`, the part of the variance that the linear model explains."""

    name = "src"
    main = "SRC"
    default_draws = 1024
    default_samples = "latin-hypercube"

    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        together = np.concatenate([design.samples, outputs], axis=1)
        count = design.unit.shape[1]
        correlation = correlations(together)
        coefficients = _coefficients(correlation, count)
        again = [
            _coefficients(correlations(together, weights), count)
            for weights in resample_weights(len(together), seed)
        ]
        return {
            "SRC": coefficients,
            "SRC_conf": half_width(np.stack(again)),
            "R2": np.sum(coefficients * correlation[count:, :count], axis=1),
        }


@final
@dataclass(frozen=True)
class PartialRankCorrelation(AbstractPlainMethod):
    """Partial rank correlation coefficients `PRCC`, with `PRCC_conf`, half of their 95 % bootstrap
    interval."""

    name = "prcc"
    main = "PRCC"
    default_draws = 1024
    default_samples = "latin-hypercube"

    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        together = np.concatenate([ranks(design.samples), ranks(outputs)], axis=1)
        count = design.unit.shape[1]
        again = [
            _partial(correlations(together, weights), count)
            for weights in resample_weights(len(together), seed)
        ]
        return {
            "PRCC": _partial(correlations(together), count),
            "PRCC_conf": half_width(np.stack(again)),
        }


def correlations(
    columns: Float[np.ndarray, "runs columns"], weights: Float[np.ndarray, " runs"] | None = None
) -> Float[np.ndarray, "columns columns"]:
    """Computes the correlations of columns over runs, which may have weights whose sum is 1."""
    weights = np.full(len(columns), 1 / len(columns)) if weights is None else weights
    centred = columns - weights @ columns
    covariance = (centred.T * weights) @ centred
    scale = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):  # a resample of a few runs may not vary
        return covariance / np.outer(scale, scale)


def _coefficients(
    correlation: Float[np.ndarray, "columns columns"], count: int
) -> Float[np.ndarray, "outputs parameters"]:
    return _times_inverse(correlation[count:, :count], correlation[:count, :count])


def _partial(
    correlation: Float[np.ndarray, "columns columns"], count: int
) -> Float[np.ndarray, "outputs parameters"]:
    """Computes partial correlations of parameters and each output by block inversion."""
    with_output = correlation[count:, :count]
    each = _times_inverse(with_output, correlation[:count, :count])
    unexplained = np.maximum(1 - np.sum(each * with_output, axis=1), 0.0)[:, None]
    inverse = np.diag(_times_inverse(np.eye(count), correlation[:count, :count]))
    with np.errstate(invalid="ignore", divide="ignore"):
        return each / np.sqrt(unexplained * inverse + each**2)


def _times_inverse(
    rows: Float[np.ndarray, "rows parameters"], matrix: Float[np.ndarray, "parameters parameters"]
) -> Float[np.ndarray, "rows parameters"]:
    """Multiplies by the inverse of a matrix; the result is NaN if fewer runs than parameters leave
    no inverse."""
    if not np.isfinite(matrix).all() or np.linalg.matrix_rank(matrix) < len(matrix):
        return np.full(rows.shape, np.nan)
    return np.linalg.solve(matrix, rows.T).T
