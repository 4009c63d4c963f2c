"""Sensitivity analysis: which parameters matter, step 4 of the paper.

There are two entries (`_analysis`). `global_sensitivity` simulates the runs that a method
(`_method`) asks for, and hands it the outputs (`_outputs`) for its estimate. `sensitivity` is the
analysis of the paper: on the runs of Pearson's method, the correlations of costs and their
confidence intervals (`_correlations`). Which file holds what else:

- what is drawn: `_inputs`, `_sampling`
- the methods: `_sobol`, `_morris`, `_shapley`, `_polynomial_chaos`, `_correlations`,
  `_derivative_based`
- the results: `_sensitivity`, `_global_sensitivity`
"""

from .._faces import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
