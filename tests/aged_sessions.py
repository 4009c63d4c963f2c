"""Fits of sessions, as if their recordings said something of a parameter."""

from dataclasses import replace

import numpy as np
from small_results import fit

from jaxtwin.matching import Fit, FittedParameters

NAME = "R_E"

# A prior of R_E.
PRIOR, SPREAD = 1.6, 0.25


def session(value: float, error: float = 0.01, *, prior: bool = False, **fields: object) -> Fit:
    """The small fit as if its recordings said this of R_E, with a relative standard error; with a
    prior, its value is drawn towards that."""
    known, place = fit().uncertainty, fit().uncertainty.labels.index(NAME)
    entry, variance = np.log(value), error**2
    row = replace(fit()[NAME], prior_value=None, prior_spread=None)
    if prior:
        variance = 1 / (1 / error**2 + 1 / SPREAD**2)
        entry = variance * (entry / error**2 + np.log(PRIOR) / SPREAD**2)
        row = replace(row, prior_value=PRIOR, prior_spread=SPREAD)
    row = replace(
        row,
        value=float(np.exp(entry)),
        standard_error=float(np.exp(entry)) * variance**0.5,
        relative_standard_error=variance**0.5,
        at_bound=False,
    )
    covariance = known.vector_covariance.copy()
    covariance[place, place] = variance
    uncertainty = replace(known, vector_covariance=covariance, inverse_hessian=covariance)
    parameters = FittedParameters({**fit().parameters, NAME: row})
    return replace(fit(), parameters=parameters, uncertainty=uncertainty, **fields)
