r"""Matches a session from the posterior of an earlier fit, and finds which values have changed.

A prior that follows from earlier sessions is narrow, and a contact that was remounted may be many
of its standard deviations away. The prior would then pull all other values along. Let $C$ be the
covariance of the prior, $P = C^{-1}$ and $d$ the distance of the match from its mean. If nothing
but the usual drift happened, $d^T P d$ is at most a $\chi^2$ with as many degrees of freedom as
there are values. If it is beyond, the prior of a single value is released to what the rig file says
of it: $C + s_j^2 e_j e_j^T$. By the formula of Woodbury the cost then falls by about

$$\frac{(P d)_j^2 / 2}{P_{jj} + s_j^{-2} - (P A^{-1} P)_{jj}},$$

where $A$ is the Hessian of the cost; the values for which this is largest are tried, and the best
one is released. After `MOST_CHANGES` releases the session is not that of this rig.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from .._errors import MatchError
from ..io import Experiment
from ..matching import Fit
from ..matching._descent import descend
from ..matching._descent_result import DescentResult, make_optimum
from ..matching._fit import solution_of
from ..matching._match import default_solver, make_fit
from ..matching._match_group import descend_with_noise
from ..matching._noise_model import NoiseModel
from ..matching._objective import make_objective
from ..matching._problem import LinearPrior, MatchProblem, make_match_problem
from ..matching._reweighted_least_squares import Estimate
from ..matching._unknowns import Unknowns
from ._forgetting import SessionPrior, rows_with_priors, with_spread_of

MOST_CHANGES = 2
"""The largest number of values that change at once on a rig that is still the same."""

SURE = 1e-4
"""The probability of a distance from the prior that still counts as drift."""

TRIED = 3
"""The number of values of which the release is tried."""


@final
class SessionMatch(NamedTuple):
    """A match of a session.

    - `fit`: the fit. `cost`: half the sum of squared residuals and priors. `drift_cost`: the same
      before any value was released.
    - `changed`: the names of the values that have changed.
    - `distance`, `limit`: the squared distance of the others from the prior, and what drift may be.
    - `noise_model`: the noise that was assumed.
    - `start`: the values that the last twin expects, with the session's own ones as found.
    """

    fit: Fit
    cost: float
    drift_cost: float
    changed: tuple[str, ...]
    distance: float
    limit: float
    noise_model: NoiseModel
    start: Float[np.ndarray, " unknowns"]


def session_problem(
    fit: Fit, prior: SessionPrior, recordings: Mapping[str, Experiment]
) -> MatchProblem:
    """The problem of matching recordings of a session from a prior."""
    twin = fit.twin_of_group(prior.group)
    before = solution_of(fit).problem.unknowns
    own = [replace(row, value=float(twin.values[row.name])) for row in before.per_recording]
    shared = [
        replace(row, value=float(np.clip(row.from_entry(mean), row.lower, row.upper)))
        for row, mean in zip(prior.rows, prior.mean, strict=True)
    ]
    unknowns = Unknowns(tuple(shared), (), tuple(own), (0,) * len(recordings))
    problem = make_match_problem(twin, recordings, unknowns, group_names=(prior.group,))
    weights = problem.prior_weights.copy()
    weights[: len(shared)] = 0.0
    problem = replace(problem, prior_weights=weights)
    return _with_covariance(problem, prior, prior.covariance)


def match_session(
    fit: Fit, prior: SessionPrior, recordings: Mapping[str, Experiment], max_iterations: int
) -> SessionMatch:
    """Matches recordings of a session, with the noise that the earlier fit found.

    **Raises:** `MatchError` if the twin gives no finite temperatures; the errors of `match`.
    """
    began = time.perf_counter()
    problem = session_problem(fit, prior, recordings)
    result, noise_model = descend_with_noise(problem, solution_of(fit).noise_model, max_iterations)
    if not np.isfinite(result.cost):
        raise MatchError(
            f"{fit.twin.rig.name}: expected finite temperatures from the last twin, got none; look "
            "for parameters far outside their bounds"
        )
    first, drift_cost = result.vector, result.cost
    places: tuple[int, ...] = ()
    limit = float(chi2.isf(SURE, len(prior.mean)))
    distance = _distance(result, prior, places)
    while distance > limit and len(places) < MOST_CHANGES:
        place, result = _release(problem, noise_model, prior, result, places, max_iterations)
        places = (*places, place)
        distance = _distance(result, prior, places)
    covariance = prior.released(places)
    rows = rows_with_priors(fit, prior, covariance)
    told = replace(problem.unknowns, shared=tuple(
        replace(row, value=own.value)
        for row, own in zip(rows, problem.unknowns.shared, strict=True)
    ))  # fmt: skip
    solved = replace(_with_covariance(problem, prior, covariance), unknowns=told)
    optima = (make_optimum(solved, result, 0, result),)
    found = make_fit(solved, Estimate(result, noise_model), 0, optima, began)
    return SessionMatch(
        with_spread_of(found, fit),
        result.cost,
        drift_cost,
        tuple(prior.rows[place].name for place in places),
        distance,
        limit,
        noise_model,
        np.concatenate([prior.mean, first[len(prior.mean) :]]),
    )


def descend_each(
    problems: Sequence[MatchProblem],
    noise_model: NoiseModel,
    vector: Float[np.ndarray, " unknowns"],
    max_iterations: int,
) -> list[DescentResult]:
    """Solves problems from the same start, one after the other: with the program of the match,
    which is there, whatever their number and the lengths of their time grids."""
    solver, space = default_solver(problems[0]), problems[0].unknowns.search_space()
    return [
        descend([make_objective(problem, noise_model)], solver, [vector], space, max_iterations)[0]
        for problem in problems
    ]


def _release(
    problem: MatchProblem,
    noise_model: NoiseModel,
    prior: SessionPrior,
    result: DescentResult,
    places: tuple[int, ...],
    max_iterations: int,
) -> tuple[int, DescentResult]:
    """Releases the value that explains the session best; returns its place and the descent."""
    gains = _gains(prior, result, places)
    best = np.argsort(gains)[::-1][:TRIED]
    chosen = [int(place) for place in best if gains[place] > 0] or [int(best[0])]
    problems = [
        _with_covariance(problem, prior, prior.released((*places, place))) for place in chosen
    ]
    found = descend_each(problems, noise_model, result.vector, max_iterations)
    costs = [each.cost for each in found]
    number = int(np.nanargmin(costs))
    return chosen[number], found[number]


def _gains(
    prior: SessionPrior, result: DescentResult, places: tuple[int, ...]
) -> Float[np.ndarray, " rows"]:
    """By how much the cost falls if a value is released, about."""
    size = len(prior.mean)
    precision = np.linalg.inv(prior.released(places))
    pull = precision @ (result.vector[:size] - prior.mean)
    jacobian = result.jacobian()
    inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)[:size, :size]
    room = np.diag(precision) + 1 / prior.changes**2
    room = room - np.diag(precision @ inverse @ precision)
    gains = 0.5 * pull**2 / np.maximum(room, 1e-12)
    gains[list(places)] = 0.0
    return gains


def _distance(result: DescentResult, prior: SessionPrior, places: tuple[int, ...]) -> float:
    away = result.vector[: len(prior.mean)] - prior.mean
    return float(away @ np.linalg.solve(prior.released(places), away))


def _with_covariance(
    problem: MatchProblem, prior: SessionPrior, covariance: Float[np.ndarray, "rows rows"]
) -> MatchProblem:
    means = problem.unknowns.prior_means()
    means[: len(prior.mean)] = prior.mean
    return replace(problem, linear_prior=LinearPrior.normal(means, covariance))
