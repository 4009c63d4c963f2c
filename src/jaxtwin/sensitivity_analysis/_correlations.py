r"""Correlations of outputs with parameters as methods of global sensitivity analysis, and
regression of outputs on parameters: the effect of a parameter while the others are held.

With the correlations $C$ of the parameters with each other and $c$ with the output, the
standardised coefficients are $C^{-1} c$ and their share of the variance $R^2 = c^T C^{-1} c$. With
$P$ the inverse of the correlation matrix of parameters and output together, the partial correlation
is $-P_{jy} / \sqrt{P_{jj} P_{yy}}$ (Saltelli and others, "Sensitivity Analysis in Practice", 2004).
"""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from ._correlation_intervals import pearson, pearson_interval, ranks, spearman, spearman_interval
from ._method import AbstractPlainMethod, Design, Indices, half_width, resample_weights


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
