"""Behavioural matching: parameters from recordings, step 4 of the paper.

The way from a recording to a fit: `_problem` checks it, `_noise_model` says how its samples count,
`_objective` stacks it, `_residuals` and `_jacobian` solve the twin and subtract, `_descent`
minimises, `_reweighted_least_squares` repeats, `_make_fit` puts the `Fit` together.

The public names stand in `__init__.pyi` and are imported when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
