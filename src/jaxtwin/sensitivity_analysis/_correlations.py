"""Correlations of outputs with parameters, as methods beside the others."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from ._indices import pearson, spearman
from ._intervals import pearson_interval, spearman_interval
from ._method import AbstractPlainMethod, Design, Indices


@final
@dataclass(frozen=True)
class Pearson(AbstractPlainMethod):
    """Pearson's correlation `pearson`, with its 95 % interval, `pearson_low` and `pearson_high`."""

    name = "pearson"
    main = "pearson"
    usual_draws = 1000

    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        interval = pearson_interval(outputs, design.samples)
        return {
            "pearson": pearson(outputs, design.samples),
            "pearson_low": interval[..., 0],
            "pearson_high": interval[..., 1],
        }


@final
@dataclass(frozen=True)
class Spearman(AbstractPlainMethod):
    """Spearman's rank correlation `spearman`, with its 95 % interval, `spearman_low` and
    `spearman_high`."""

    name = "spearman"
    main = "spearman"
    usual_draws = 1000

    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        interval = spearman_interval(outputs, design.samples)
        return {
            "spearman": spearman(outputs, design.samples),
            "spearman_low": interval[..., 0],
            "spearman_high": interval[..., 1],
        }
