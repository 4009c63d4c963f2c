"""Sensitivity analysis: which parameters matter, step 4 of the paper.

There are two entries (`_analysis`). `global_sensitivity` simulates the runs that a method
(`_method`) asks for, and hands it the outputs (`_outputs`) for its estimate. `sensitivity` is the
analysis of the paper: on the runs of Pearson's method, the correlations of costs and their
confidence intervals (`_correlation_intervals`). Which file holds what else:

- what is drawn: `_inputs`, `_input_choices`, `_sampling`
- the methods: `_sobol`, `_morris`, `_shapley`, `_polynomial_chaos`, `_correlations`,
  `_derivative_based`
- the results: `_sensitivity`, `_global_sensitivity`
"""

from ._analysis import METHODS, MethodName, global_sensitivity, sensitivity
from ._correlation_intervals import pearson, pearson_interval, spearman, spearman_interval
from ._correlations import PartialRankCorrelation, Pearson, Spearman, StandardisedRegression
from ._derivative_based import DerivativeBased
from ._global_sensitivity import GlobalSensitivity
from ._inputs import AbstractMarginal, Inputs, LogNormal, Normal, Uniform
from ._method import AbstractMethod, Design, indices_of
from ._morris import Morris, OneAtATime
from ._outputs import Output
from ._polynomial_chaos import PolynomialChaos
from ._sampling import normal_draws
from ._sensitivity import Sensitivity
from ._shapley import Shapley
from ._sobol import Sobol

__all__ = [
    "METHODS",
    "AbstractMarginal",
    "AbstractMethod",
    "DerivativeBased",
    "Design",
    "GlobalSensitivity",
    "Inputs",
    "LogNormal",
    "MethodName",
    "Morris",
    "Normal",
    "OneAtATime",
    "Output",
    "PartialRankCorrelation",
    "Pearson",
    "PolynomialChaos",
    "Sensitivity",
    "Shapley",
    "Sobol",
    "Spearman",
    "StandardisedRegression",
    "Uniform",
    "global_sensitivity",
    "indices_of",
    "normal_draws",
    "pearson",
    "pearson_interval",
    "sensitivity",
    "spearman",
    "spearman_interval",
]
