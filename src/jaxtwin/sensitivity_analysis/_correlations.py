"""Correlations of outputs with parameters, as methods of global sensitivity analysis."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from ._correlation_coefficients import pearson, spearman
from ._correlation_intervals import pearson_interval, spearman_interval
from ._method import AbstractPlainMethod, Design, Indices


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
