r"""Profile likelihood: how much worse the match becomes when one parameter is held elsewhere.

All others are matched anew at each value. Where the excess of $2 \,\text{cost}$ stays below
3.84 the value is inside the 95 % interval (Wilks), also where the covariance, which knows the
slope at one point only, says something else.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Float

from .._arguments import check_callable, of_kind, whole_number
from .._errors import MatchError, ParameterError
from ._descend import descend
from ._estimate import make_problem
from ._fit import Fit
from ._match import default_solver

LIMIT = 3.841
"""95 % quantile of chi-squared with one degree of freedom."""

PIN = 1e6
"""Holds an entry: one over the standard deviation that it may move by."""


LEAST = 3
"""Points: one on each side of the match."""


@final
@dataclass(frozen=True, eq=False)
class Profile:
    """A profile likelihood.

    - `name`, `unit`: of the parameter.
    - `values`: at which it was held, `(points,)`.
    - `excess`: twice the cost there less that at the match, `(points,)`; the residuals' correlation
      is in their weights.
    - `interval`: where the excess is below 3.84, between points by straight lines; infinite on a
      side where it never gets above, a bound where that was reached.
    """

    name: str
    unit: str
    values: Float[np.ndarray, " points"]
    excess: Float[np.ndarray, " points"]
    interval: tuple[float, float]


def profile(
    fit: Fit,
    name: str,
    values: Sequence[float] | None = None,
    points: int = 9,
    *,
    on_iteration: Callable[[int, int], None] | None = None,
) -> Profile:
    """The profile likelihood of a shared parameter.

    **Arguments:**

    - `fit`: a match.
    - `name`: of a parameter that it matched for all recordings together.
    - `values`: where to hold it, in its unit; by default `points` within three standard errors
      (where it has none, within a factor of twenty or three tenths of its range), inside its
      bounds.
    - `points`: at least 3.
    - `on_iteration`: called with the number of the point, from 0 on, and of its iteration.

    **Returns:** the profile; its points increase, and those that bounds let coincide are one.

    **Raises:** `ParameterError` for a name that was not matched; `MatchError` for values outside
    the bounds or fewer than 3 points.
    """
    of_kind("profile: fit", fit, Fit, "a Fit, as match gives it", MatchError)
    unknowns, setting = fit.setting.unknowns, fit.setting
    shared = [row.name for row in unknowns.shared]
    if name not in shared:
        raise ParameterError(f"profile: found {name!r}, allowed are {', '.join(shared)}")
    if values is None:
        whole_number("profile: points", points, LEAST, MatchError)
    check_callable("profile: on_iteration", on_iteration, MatchError)
    entry = shared.index(name)
    row = unknowns.shared[entry]
    lower, upper = unknowns.lower()[entry], unknowns.upper()[entry]
    if values is None:
        spread = float(np.sqrt(fit.uncertainty.entries[entry, entry]))
        if not np.isfinite(spread) or spread == 0:
            spread = float(unknowns.widths()[entry])
        at = fit.vector[entry] + np.linspace(-3, 3, points) * spread
        at = np.unique(np.clip(at, lower, upper))
    else:
        given = np.sort(np.asarray(values, dtype=float))
        if given.size == 0 or not np.all((given >= row.lower) & (given <= row.upper)):
            raise MatchError(
                f"profile: {name}: found values {given.tolist()}, allowed are {row.lower:g} to "
                f"{row.upper:g} {row.unit}"
            )
        at = np.log(given) if row.is_logarithmic else given
    problem = make_problem(setting, fit.knowledge)
    problems, starts = [], []
    for value in at:
        centre, precision = problem.centre.copy(), problem.precision.copy()
        centre[entry], precision[entry] = value, PIN
        problems.append(
            eqx.tree_at(lambda p: (p.centre, p.precision), problem, (centre, precision))
        )
        start = fit.vector.copy()
        start[entry] = value
        starts.append(start)
    attempts = descend(
        problems,
        default_solver(setting),
        starts,
        50,
        setting.box,
        setting.scale,
        on_step=None
        if on_iteration is None
        else lambda number, step: on_iteration(number, step[0]),
    )
    prior = 0.5 * ((at - problem.centre[entry]) * problem.precision[entry]) ** 2
    excess = 2 * (np.array([one.cost for one in attempts]) + prior - fit.cost)
    shown = np.exp(at) if row.is_logarithmic else at
    return Profile(name, row.unit, shown, excess, _interval(shown, excess, row.lower, row.upper))


def _interval(
    values: Float[np.ndarray, " points"],
    excess: Float[np.ndarray, " points"],
    lower: float,
    upper: float,
) -> tuple[float, float]:
    best = int(np.argmin(excess))

    def crossing(order: np.ndarray, bound: float, beyond: float) -> float:
        for near, far in pairwise(order):
            if excess[far] > LIMIT:
                part = (LIMIT - excess[near]) / (excess[far] - excess[near])
                return float(values[near] + part * (values[far] - values[near]))
        return bound if np.isclose(values[order[-1]], bound) else beyond

    down = crossing(np.arange(best, -1, -1), lower, -np.inf)
    return down, crossing(np.arange(best, len(values)), upper, np.inf)
