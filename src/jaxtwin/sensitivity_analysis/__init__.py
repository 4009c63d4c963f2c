"""Sensitivity analysis: which parameters matter, step 4 of the paper.

There are two entries. `global_sensitivity` (`_global_analysis`) simulates the runs that a method
(`_method`) asks for, with the twins of `_paired_twins` and around the values of `_central_values`,
and hands it the outputs (`_outputs`) for its estimate. `sensitivity` (`_monte_carlo`) is the
analysis of the paper: on the runs of Pearson's method, the correlations of costs
(`_correlation_coefficients`) and their confidence intervals (`_correlation_intervals`). Which file
holds what else:

- what is drawn: `_inputs`, `_input_choices`, `_marginals`, `_sampling`, `_unit_samples`
- the methods by name (`_methods`): `_sobol`, `_morris`, `_shapley`, `_polynomial_chaos`,
  `_regression`, `_correlations`, `_derivative_based` (by `_slopes`), `_one_at_a_time`
- the results: `_sensitivity`, `_global_sensitivity`; intervals of indices: `_bootstrap`
- a model of the user in place of a twin: `_model`
"""

from ._correlation_coefficients import pearson, spearman
from ._correlation_intervals import pearson_interval, spearman_interval
from ._correlations import Pearson, Spearman
from ._derivative_based import DerivativeBased
from ._global_analysis import global_sensitivity
from ._global_sensitivity import GlobalSensitivity
from ._inputs import Inputs
from ._marginals import AbstractMarginal, LogNormal, Normal, Uniform
from ._method import AbstractMethod, Design, indices_of
from ._methods import METHODS, MethodName
from ._monte_carlo import sensitivity
from ._morris import Morris
from ._one_at_a_time import OneAtATime
from ._outputs import Output
from ._polynomial_chaos import PolynomialChaos
from ._regression import PartialRankCorrelation, StandardisedRegression
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
