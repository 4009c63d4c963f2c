r"""What a session by itself says of a parameter: its estimate without the prior.

A match has priors: those of the rig file, or, in a refit, the posterior of the session before. They
draw the values of all sessions to one place and would hide a trend. With the variance $a =
(A^{-1})_{ii}$ of a parameter in the match, and its prior $N(\mu, p^2)$, the part $w = a / p^2$ of
the estimate $u$ is the prior. What remains without it is the maximum of the integrated likelihood,

$$u' = \frac{u - w \mu}{1 - w}, \qquad s'^2 = \frac{s^2 - w^2 p^2}{(1 - w)^2},$$

where $s^2$ is the variance of $u$ (that of the sandwich). This is the cavity of the prior in the
words of expectation propagation (Minka 2001), and exact for normal distributions. The other
parameters keep their priors: a session seldom determines all of them.

An observer has such a prior too: what it knows of a parameter before the first reading, which is
also what it would know at the end without any. Its session says where the parameter is at the end.
"""

import math
from typing import NamedTuple, final

import numpy as np

from .._jax_settings import own_settings
from ..matching import Fit, FittedParameter
from ..observers import Observed
from ..rig import Rig

# A session of whose estimate the prior is a larger part than this says nothing of a parameter.
MAX_PRIOR = 0.9


@final
class SessionEstimate(NamedTuple):
    """An estimate and its standard error, of the logarithm if the parameter is matched by it."""

    value: float
    error: float


@final
class EstimatedSession(NamedTuple):
    """What a session says of its rig.

    - `free`: the parameters that were estimated. `estimates`: of those that the session determines.
    - `has_converged`: whether its match did; true for an observed session.
    """

    rig: Rig
    free: tuple[str, ...]
    estimates: dict[str, SessionEstimate]
    has_converged: bool


def session_of(found: Fit | Observed) -> EstimatedSession:
    """What a match, or an observer, found in a session."""
    if isinstance(found, Observed):
        rig = found.observer.model.twin.rig
        return EstimatedSession(rig, tuple(found.estimates.parameters), _observed(found, rig), True)
    free = (n for n, row in found.parameters.items() if row.free and row.scope != "recording")
    return EstimatedSession(found.twin.rig, tuple(free), _matched(found), found.converged)


def _matched(fit: Fit) -> dict[str, SessionEstimate]:
    """What the recordings of a fit say of each parameter that belongs to the rig, and not to a
    recording. Parameters that were held, ended at a bound or are undetermined are left out."""
    places = {label: place for place, label in enumerate(fit.uncertainty.labels)}
    result = {}
    for name, row in fit.parameters.items():
        if row.scope != "recording" and name in places and math.isfinite(row.standard_error):
            at = (places[name], places[name])
            estimate = _of_match(
                row,
                float(fit.uncertainty.vector_covariance[at]),
                float(fit.uncertainty.inverse_hessian[at]),
            )
            if estimate is not None:
                result[name] = estimate
    return result


def _observed(found: Observed, rig: Rig) -> dict[str, SessionEstimate]:
    """What the readings say of the uncertain values of an observer at the end of the recording."""
    directions = found.estimates.directions
    if directions is None:
        return {}
    with own_settings():
        spreads = np.asarray(directions.spreads(found.noise))
    priors = np.linalg.norm(np.asarray(directions.matrix) * spreads, axis=1)
    moments, estimates = found.estimates.moments.values, {}
    for number, name in enumerate(directions.names):
        change, spread = (float(part[-1, number]) for part in moments)
        estimate = _without_prior(change, spread**2, spread**2, 0.0, float(priors[number]))
        if estimate is not None:
            value = float(directions.values[number])
            is_logarithmic = directions.is_logarithmic[number]
            estimates[name] = _in_entries_of(rig, name, value, is_logarithmic, estimate)
    return estimates


def _in_entries_of(
    rig: Rig, name: str, value: float, is_logarithmic: bool, change: SessionEstimate
) -> SessionEstimate:
    """A change of a value as an estimate, of the logarithm if the rig's table has it so."""
    if rig.parameters[name].is_logarithmic:
        return SessionEstimate(math.log(value) + change.value, change.error)
    if is_logarithmic:
        result = value * math.exp(change.value)
        return SessionEstimate(result, result * change.error)
    return SessionEstimate(value + change.value, change.error)


def _of_match(
    row: FittedParameter, variance: float, model_variance: float
) -> SessionEstimate | None:
    value = math.log(row.value) if row.is_logarithmic else row.value
    if row.prior_value is None or row.prior_spread is None:
        return SessionEstimate(value, math.sqrt(variance)) if variance > 0 else None
    prior = math.log(row.prior_value) if row.is_logarithmic else row.prior_value
    spread = math.hypot(row.prior_spread, row.group_spread or 0.0)
    return _without_prior(value, variance, model_variance, prior, spread)


def _without_prior(
    value: float, variance: float, model_variance: float, prior: float, spread: float
) -> SessionEstimate | None:
    """The estimate without a prior of this mean and standard deviation; None if the prior is most
    of it."""
    part = model_variance / spread**2 if spread > 0 else 1.0
    if not 0 < part < MAX_PRIOR:
        return None
    # Nothing becomes surer without its prior: rounding, and noise below that of the match, could
    # otherwise say so.
    left = max(variance - (part * spread) ** 2, variance * (1 - part) ** 2)
    return SessionEstimate((value - part * prior) / (1 - part), math.sqrt(left) / (1 - part))
