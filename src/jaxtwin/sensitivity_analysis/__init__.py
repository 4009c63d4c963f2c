"""Sensitivity analysis: which parameters matter, step 4 of the paper."""

from ._indices import pearson, spearman
from ._intervals import pearson_interval, spearman_interval
from ._monte_carlo import sensitivity
from ._sampling import normal_draws
from ._sensitivity import Sensitivity

__all__ = [
    "Sensitivity",
    "normal_draws",
    "pearson",
    "pearson_interval",
    "sensitivity",
    "spearman",
    "spearman_interval",
]
