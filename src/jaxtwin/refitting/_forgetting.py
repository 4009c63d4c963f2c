r"""What an earlier fit says of a new session: its posterior, less what is forgotten meanwhile.

The rig itself differs between sessions: with the random effects of `matching._between_recordings`
its values take a step $b \sim N(0, D^2)$ from each session to the next, where $D$ are the standard
deviations between recordings. The posterior of the last session becomes the prior of the next one,
as in a Kalman filter of a random walk:

$$u_{k+1} \sim N(u_k, \; \Sigma_k + f^2 D^2).$$

The certainty of a value therefore does not grow beyond what sessions agree on, and what was found
long ago counts less and less. $f = 1$ is what the sessions say; more forgets faster.
"""

from dataclasses import replace
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from ..matching import HELD_SPREAD, Fit, group_and_shared_values, new_group_values, solution_of
from ..rig import Parameter

# A step that is allowed between sessions in any case, of a logarithm or in the value's unit.
MIN_DRIFT = 0.01

# How far a value may change that has no prior in the rig file: a factor of e, or its unit.
UNKNOWN_CHANGE = 1.0


@final
class SessionPrior(NamedTuple):
    """What an earlier fit says of the values that recordings of a session share, on the scale of
    the optimiser's vector.

    - `rows`: the parameters, with the bounds of the fit.
    - `mean`, `covariance`: their prior.
    - `drift`: the covariance of the step from the last session to this one alone.
    - `changes`: how far each may be after a change of the rig: the standard deviation of its own
      prior in the rig file.
    - `group`: the name of the group.
    """

    rows: tuple[Parameter, ...]
    mean: Float[np.ndarray, " rows"]
    covariance: Float[np.ndarray, "rows rows"]
    drift: Float[np.ndarray, "rows rows"]
    changes: Float[np.ndarray, " rows"]
    group: str

    def drift_and(self, places: tuple[int, ...]) -> Float[np.ndarray, "rows rows"]:
        """The covariance if the rig has drifted, and some values have changed: nothing is known of
        these any more but what the rig file says."""
        return self.drift + self._of_changes(places)

    def covariance_and(self, places: tuple[int, ...]) -> Float[np.ndarray, "rows rows"]:
        """The covariance of the last fit, with one step between sessions (without `MIN_DRIFT`) and
        some changed values."""
        return self.covariance + self._of_changes(places)

    def _of_changes(self, places: tuple[int, ...]) -> Float[np.ndarray, "rows rows"]:
        wider = np.zeros(len(self.mean))
        wider[list(places)] = self.changes[list(places)] ** 2
        return np.diag(wider)


def session_prior(fit: Fit, group: str, forgetting: float) -> SessionPrior:
    """The prior of a session: the posterior of a fit, with what is forgotten.

    **Arguments:**

    - `group`: the group of the session, which the fit may know or not.
    - `forgetting`: $f$, the step between sessions in standard deviations between recordings.
    """
    solution = solution_of(fit)
    unknowns, names = solution.problem.unknowns, solution.problem.group_names
    number = names.index(group) if group in names else None
    known = group_and_shared_values(unknowns, solution.vector, number)
    step = np.diag((forgetting * fit.uncertainty.between_recordings) ** 2)
    drift = known.covariance(step) + np.diag(np.full(len(known.mean), MIN_DRIFT**2))
    covariance = known.covariance(fit.uncertainty.vector_covariance + step)
    # A value that was held at a bound stays there.
    covariance += np.diag(np.where(np.diag(covariance) > 0, 0.0, HELD_SPREAD**2))
    table = fit.twin.rig.parameters
    spreads = [table[row.name].standard_deviation for row in known.rows]
    changes = [UNKNOWN_CHANGE if spread is None else spread for spread in spreads]
    return SessionPrior(known.rows, known.mean, covariance, drift, np.array(changes), group)


def rows_with_priors(
    fit: Fit, prior: SessionPrior, covariance: Float[np.ndarray, "rows rows"]
) -> tuple[Parameter, ...]:
    """The rows of a session's fit, with the prior that each had by itself, so that a saved refit
    says what it began with. The prior of a parameter of groups is that of the value which all
    groups share: a later group then begins from what all sessions before have said of it."""
    solution = solution_of(fit)
    shared = new_group_values(solution.problem.unknowns, solution.vector)
    spreads = np.sqrt(
        np.diag(shared.covariance(fit.uncertainty.vector_covariance))
        - shared.variance
        + shared.shared_variance
    )
    of_groups = {
        row.name: (mean, spread)
        for row, mean, spread in zip(shared.rows, shared.mean, spreads, strict=True)
    }
    own = np.sqrt(np.diag(covariance))
    rows = []
    for row, mean, spread in zip(prior.rows, prior.mean, own, strict=True):
        centre, width = of_groups.get(row.name, (mean, spread))
        value = float(np.clip(row.from_entry(centre), row.lower, row.upper))
        rows.append(replace(row, prior_value=value, prior_spread=float(width)))
    return tuple(rows)


def with_spread_of(fit: Fit, earlier: Fit) -> Fit:
    """A fit with the standard deviations between recordings of an earlier one: a single session
    says nothing of them, and a later refit forgets by them."""
    pairs = zip(
        earlier.uncertainty.labels, earlier.uncertainty.between_recordings.tolist(), strict=True
    )
    known: dict[str, float] = {}
    for label, spread in pairs:
        name = label.partition("[")[0]
        known[name] = max(spread, known.get(name, 0.0))
    scopes = {row.name: row.scope for row in earlier.parameters.values()}
    spreads = [
        0.0 if scopes.get(name) == "recording" else known.get(name, 0.0)
        for name in (label.partition("[")[0] for label in fit.uncertainty.labels)
    ]
    uncertainty = replace(fit.uncertainty, between_recordings=np.array(spreads))
    return replace(fit, uncertainty=uncertainty)
