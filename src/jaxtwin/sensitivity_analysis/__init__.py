"""Sensitivity analysis: which parameters matter, step 4 of the paper."""

from ._drawn import distinct_names, drawn_values, own_draws, paired_twins
from ._indices import pearson, spearman
from ._intervals import pearson_interval, spearman_interval
from ._monte_carlo import sensitivity
from ._sampling import checked_seed, checked_spread, normal_draws
from ._sensitivity import Sensitivity

__all__ = [
    "Sensitivity",
    "checked_seed",
    "checked_spread",
    "distinct_names",
    "drawn_values",
    "normal_draws",
    "own_draws",
    "paired_twins",
    "pearson",
    "pearson_interval",
    "sensitivity",
    "spearman",
    "spearman_interval",
]
