r"""What a session by itself says of a parameter: its estimate without the prior.

A match has priors: those of the rig file, or, in a refit, the posterior of the session before. They
draw the values of all sessions to one place and would hide a trend. With the variance $a =
(A^{-1})_{ii}$ of a parameter in the match, and its prior $N(\mu, p^2)$, the part $w = a / p^2$ of
the estimate $u$ is the prior. What remains without it is the maximum of the integrated likelihood,

$$u' = \frac{u - w \mu}{1 - w}, \qquad s'^2 = \frac{s^2 - w^2 p^2}{(1 - w)^2},$$

where $s^2$ is the variance of $u$ (that of the sandwich). This is the cavity of the prior in the
words of expectation propagation (Minka 2001), and exact for normal distributions. The other
parameters keep their priors: a session seldom determines all of them.
"""

import math
from typing import NamedTuple, final

from ..matching import Fit, FittedParameter

MOST_PRIOR = 0.9
"""A session of whose estimate the prior is a larger part than this says nothing of a parameter."""


@final
class SessionEstimate(NamedTuple):
    """An estimate and its standard error, of the logarithm if the parameter is matched by it."""

    value: float
    error: float


def session_estimates(fit: Fit) -> dict[str, SessionEstimate]:
    """What the recordings of a fit say of each parameter that belongs to the rig, and not to a
    recording. Parameters that were held, ended at a bound or are undetermined are left out."""
    places = {label: place for place, label in enumerate(fit.uncertainty.labels)}
    found = {}
    for name, row in fit.parameters.items():
        if row.scope != "recording" and name in places and math.isfinite(row.standard_error):
            at = (places[name], places[name])
            estimate = _without_prior(
                row,
                float(fit.uncertainty.vector_covariance[at]),
                float(fit.uncertainty.inverse_hessian[at]),
            )
            if estimate is not None:
                found[name] = estimate
    return found


def _without_prior(
    row: FittedParameter, variance: float, model_variance: float
) -> SessionEstimate | None:
    value = math.log(row.value) if row.is_logarithmic else row.value
    if row.prior_value is None or row.prior_spread is None:
        return SessionEstimate(value, math.sqrt(variance)) if variance > 0 else None
    prior = math.log(row.prior_value) if row.is_logarithmic else row.prior_value
    spread = math.hypot(row.prior_spread, row.group_spread or 0.0)
    part = model_variance / spread**2
    if not 0 < part < MOST_PRIOR:
        return None
    # Nothing becomes surer without its prior: rounding, and noise below that of the match, could
    # otherwise say so.
    left = max(variance - (part * spread) ** 2, variance * (1 - part) ** 2)
    return SessionEstimate((value - part * prior) / (1 - part), math.sqrt(left) / (1 - part))
