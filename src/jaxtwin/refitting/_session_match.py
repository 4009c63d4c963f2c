r"""Matches a session from the posterior of an earlier fit, and finds which values have changed.

A fit that is honest about the errors of its model leaves many values open, and a match from its
posterior alone would explain nearly any session by moving all of them a little, also that of
another rig. A rig that is still the same drifts, and from time to time a single part of it changes:
a contact is remounted. The session is therefore first matched with all values at those of the last
fit, but for the drift between sessions. If its error is then that of the last fit, the values are
as near to those as its posterior and the drift allow (a $\chi^2$), and no single value that changed
would explain the session far better, nothing has changed, and the posterior is the prior of a match
of all values. If not, a single value is released to what the rig file says of it. With the
precision of the drift $P$, the distance $d$ of the match from the last fit, the rig file's spread
$s_j$ and the Hessian $A$, the cost then falls by about

$$\frac{(P d)_j^2 / 2}{P_{jj} + s_j^{-2} - (P A^{-1} P)_{jj}}$$

(the formula of Woodbury), which for a value that has not changed is half a $\chi^2$ of one degree
of freedom; the values for which it is largest are tried, and the best one is released. If the
allowed number of releases does not explain the session, it is not that of this rig. Values that
were not released keep what was known of them.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from ..errors import MatchError
from ..io import Experiment
from ..matching import (
    DescentResult,
    Fit,
    LinearPrior,
    MatchEstimate,
    MatchProblem,
    NoiseModel,
    Unknowns,
    default_solver,
    descend,
    descend_with_noise,
    make_fit,
    make_match_problem,
    make_objective,
    make_optimum,
    solution_of,
)
from ._forgetting import MIN_DRIFT, SessionPrior, rows_with_priors, with_spread_of

# A session is explained by an error of at most this multiple of that of the last fit.
MAX_ERROR_RATIO = 1.5

# The probability of a distance from the last fit that still counts as drift.
DRIFT_PROBABILITY = 1e-4

# The probability that any of the values of a rig which has only drifted seems to have changed.
CHANCE = 0.1

# The number of values of which the release is tried.
MAX_RELEASED = 3


@final
class SessionExplanation(NamedTuple):
    """How well drift and the values that have changed explain a session, and what is enough.

    - `error`, `limit`: the root mean square error that they leave, K.
    - `distance`, `furthest`: the squared distance of the values that have not changed from those of
      the last fit, in standard deviations.
    - `gains`, `most_gain`: by how much the cost would fall, about, if one more value had changed,
      each of them.
    - `next_name`: the value for which it would fall most.
    """

    error: float
    limit: float
    distance: float
    furthest: float
    gains: Float[np.ndarray, " rows"]
    most_gain: float
    next_name: str

    @property
    def is_enough(self) -> bool:
        """Whether nothing else needs to have changed."""
        return (
            self.error <= self.limit
            and self.distance <= self.furthest
            and float(self.gains.max()) <= self.most_gain
        )


@final
class SessionMatch(NamedTuple):
    """A match of a session.

    - `fit`: the fit.
    - `cost`, `drift_cost`: half the sum of squared residuals and priors, if the rig has drifted and
      changed, or has only drifted.
    - `changed`: the names of the values that have changed.
    - `explanation`: how well they explain the session.
    - `noise_model`: the noise that was assumed.
    - `start`: the values that the last twin expects, with the session's own ones as found.
    """

    fit: Fit
    cost: float
    drift_cost: float
    changed: tuple[str, ...]
    explanation: SessionExplanation
    noise_model: NoiseModel
    start: Float[np.ndarray, " unknowns"]


def session_problem(
    fit: Fit, prior: SessionPrior, recordings: Mapping[str, Experiment]
) -> MatchProblem:
    """The problem of matching recordings of a session if the rig has only drifted."""
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
    return _with_covariance(problem, prior, prior.drift)


def match_session(
    fit: Fit,
    prior: SessionPrior,
    recordings: Mapping[str, Experiment],
    changes: int,
    max_iterations: int,
) -> SessionMatch:
    """Matches recordings of a session, with the noise that the earlier fit found.

    **Arguments:**

    - `changes`: the number of values that may have changed at once.

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
    explanation = _explanation(fit, prior, result, places)
    while len(places) < changes and not explanation.is_enough:
        gains = explanation.gains
        place, result = _release(problem, noise_model, prior, result, places, gains, max_iterations)
        places = (*places, place)
        explanation = _explanation(fit, prior, result, places)
    cost = result.cost
    covariance = prior.covariance_and(places)
    solved = _with_covariance(problem, prior, covariance)
    if not places:
        (result,) = descend_each([solved], noise_model, result.vector, max_iterations)
    rows = rows_with_priors(fit, prior, covariance)
    pairs = zip(rows, problem.unknowns.shared, strict=True)
    shared = tuple(replace(row, value=own.value) for row, own in pairs)
    solved = replace(solved, unknowns=replace(problem.unknowns, shared=shared))
    optima = (make_optimum(solved, result, 0, result),)
    solution = make_fit(solved, MatchEstimate(result, noise_model), 0, optima, began)
    return SessionMatch(
        with_spread_of(solution, fit),
        cost,
        drift_cost,
        tuple(prior.rows[place].name for place in places),
        explanation,
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
        descend(
            [problem],
            [make_objective(problem, noise_model)],
            solver,
            [vector],
            space,
            max_iterations,
        )[0]
        for problem in problems
    ]


def _release(
    problem: MatchProblem,
    noise_model: NoiseModel,
    prior: SessionPrior,
    result: DescentResult,
    places: tuple[int, ...],
    gains: Float[np.ndarray, " rows"],
    max_iterations: int,
) -> tuple[int, DescentResult]:
    """Releases the value that explains the session best; returns its place and the descent."""
    best = np.argsort(gains)[::-1][:MAX_RELEASED]
    chosen = [int(place) for place in best if gains[place] > 0] or [int(best[0])]
    problems = [
        _with_covariance(problem, prior, prior.drift_and((*places, place))) for place in chosen
    ]
    solution = descend_each(problems, noise_model, result.vector, max_iterations)
    costs = [each.cost for each in solution]
    number = int(np.nanargmin(costs))
    return chosen[number], solution[number]


def _gains(
    prior: SessionPrior, result: DescentResult, places: tuple[int, ...]
) -> Float[np.ndarray, " rows"]:
    """By how much the cost falls if a value is released, about."""
    size = len(prior.mean)
    precision = np.linalg.inv(prior.drift_and(places))
    pull = precision @ (result.vector[:size] - prior.mean)
    jacobian = result.jacobian()
    inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)[:size, :size]
    room = np.diag(precision) + 1 / prior.changes**2
    room = room - np.diag(precision @ inverse @ precision)
    gains = 0.5 * pull**2 / np.maximum(room, 1e-12)
    gains[list(places)] = 0.0
    return gains


def _explanation(
    fit: Fit, prior: SessionPrior, result: DescentResult, places: tuple[int, ...]
) -> SessionExplanation:
    from scipy.stats import chi2  # takes a while to import

    values, gains = len(prior.mean), _gains(prior, result, places)
    return SessionExplanation(
        error=float(np.sqrt(result.mean_square)),
        limit=MAX_ERROR_RATIO * fit.rmse,
        distance=_distance(result, prior, places),
        furthest=float(chi2.isf(DRIFT_PROBABILITY, values)),
        gains=gains,
        most_gain=0.5 * float(chi2.isf(CHANCE / values, 1)),
        next_name=prior.rows[int(np.argmax(gains))].name,
    )


def _distance(result: DescentResult, prior: SessionPrior, places: tuple[int, ...]) -> float:
    away = result.vector[: len(prior.mean)] - prior.mean
    known = prior.covariance_and(places) + MIN_DRIFT**2 * np.eye(len(away))
    return float(away @ np.linalg.solve(known, away))


def _with_covariance(
    problem: MatchProblem, prior: SessionPrior, covariance: Float[np.ndarray, "rows rows"]
) -> MatchProblem:
    means = problem.unknowns.prior_means()
    means[: len(prior.mean)] = prior.mean
    return replace(problem, linear_prior=LinearPrior.normal(means, covariance))
