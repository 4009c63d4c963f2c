"""Sensitivity analysis: which parameters matter, step 4 of the paper."""

from ._analysis import sensitivity
from ._correlation_coefficients import pearson, spearman
from ._correlation_intervals import pearson_interval, spearman_interval
from ._correlations import Pearson, Spearman
from ._derivative_based import DerivativeBased
from ._global_sensitivity import GlobalSensitivity
from ._inputs import Inputs
from ._marginals import AbstractMarginal, LogNormal, Normal, Uniform
from ._method import AbstractMethod, Design, indices_of
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
    "AbstractMarginal",
    "AbstractMethod",
    "DerivativeBased",
    "Design",
    "GlobalSensitivity",
    "Inputs",
    "LogNormal",
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
    "indices_of",
    "normal_draws",
    "pearson",
    "pearson_interval",
    "sensitivity",
    "spearman",
    "spearman_interval",
]
