"""Matches further recordings of a group with the result of an earlier match as the prior.

The posterior of the earlier match is the prior of this one (sequential Bayesian estimation): shared
parameters and those of a group that was matched have its values and covariance, and a new group has
the values expected of any group. A day of which one zone was recorded thus learns from the first
minutes of another recording what that zone did not show. The earlier recordings are not needed. The
shared parameters are not held, because they are known only in combination with the values of the
earlier groups: a small change of both explains what a change of either cannot.

The residuals are weighted by the noise that the earlier match estimated. The first part of a
recording is too short to estimate it.
"""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .._lapack import one_blas_thread
from ..errors import MatchError
from ..io import Experiment
from ..physics import Twin
from ..rig import Parameter
from ._descent import descend
from ._descent_result import MatchEstimate, make_optimum
from ._fit import Fit, solution_of
from ._group_values import group_and_shared_values
from ._initial_conditions import WARM_UP, InitialConditions, estimate_initial_conditions
from ._match import default_solver, make_fit
from ._noise_model import NoiseModel, initial_noise_model, update_noise_model
from ._objective import make_objective
from ._problem import LinearPrior, MatchProblem, make_match_problem
from ._recordings import check_distinct, named_recordings
from ._unknowns import Unknowns

# Standard deviation of a value that the earlier match held at a bound.
HELD_SPREAD = 1e-6

# The name of a group that has no name and was not matched.
NEW_GROUP = "another group"

# Rounds of the search for corrections of the camera.
EVENT_ROUNDS = 3


@one_blas_thread()
def match_group(
    fit: Fit,
    experiments: Sequence[Experiment],
    group: str,
    start: InitialConditions | None = None,
    max_iterations: int = 200,
) -> Fit:
    """Matches a twin to recordings that an earlier match has not seen, all of one group.

    **Arguments:**

    - `fit`: the earlier match.
    - `experiments`: recordings of a single group.
    - `group`: the name of the group, which the earlier match may know or not.
    - `start`: room, start and delay of a single recording as estimated from its first minute; they
      replace the rig file's priors. The samples of this minute are matched again, which counts
      little beside the noise that the earlier match estimated.
    - `max_iterations`: the limit of the match.

    **Returns:** a fit that contains this group alone.

    **Raises:** `MatchError` if the twin gives no finite temperatures; the errors of `match`.
    """
    solution, twin = solution_of(fit), fit.twin_of_group(group)
    before = solution.problem.unknowns
    recordings = named_recordings(twin, experiments)
    check_distinct(recordings)
    names = solution.problem.group_names
    number = names.index(group) if group in names else None
    known = group_and_shared_values(before, solution.vector, number)

    def started(row: Parameter) -> Parameter:
        return replace(row, value=float(twin.values[row.name]))

    own = {} if start is None else _rows_of_start(before.per_recording, start)
    unknowns = Unknowns(
        shared=tuple(map(started, known.rows)),
        per_group=(),
        per_recording=tuple(own.get(row.name) or started(row) for row in before.per_recording),
        group_numbers=(0,) * len(recordings),
    )
    size = len(known.rows)
    covariance = known.covariance(
        fit.uncertainty.vector_covariance + np.diag(fit.uncertainty.between_recordings**2)
    )
    # A value that was held at a bound stays there.
    covariance += np.diag(np.where(np.diag(covariance) > 0, 0.0, HELD_SPREAD**2))
    mean = np.concatenate([known.mean, unknowns.prior_means()[size:]])
    problem = make_match_problem(twin, recordings, unknowns, group_names=(group,))
    weights = problem.prior_weights.copy()
    weights[:size] = 0.0
    prior = LinearPrior.normal(mean, covariance)
    problem = replace(problem, prior_weights=weights, linear_prior=prior)
    began = time.perf_counter()
    estimate = descend_with_noise(problem, solution.noise_model, max_iterations)
    if not np.isfinite(estimate.result.cost):
        raise MatchError(
            f"{twin.rig.name}: {group}: expected finite temperatures from the twin, got none; look "
            "for parameters far outside their bounds"
        )
    optima = (make_optimum(problem, estimate.result, 0, estimate.result),)
    return make_fit(problem, estimate, 0, optima, began)


def check_given(
    fit: Twin | Fit, groups: Sequence[str], experiments: Sequence[Experiment] = ()
) -> Fit:
    """The fit, if it can be used to match further recordings.

    **Arguments:**

    - `groups`: the groups of the recordings.
    - `experiments`: the recordings that are given or predicted.

    **Raises:** `MatchError` if it is not a fit, if it has already seen one of the recordings, which
    would count twice, or if there are several groups.
    """
    if not isinstance(fit, Fit):
        raise MatchError(
            "given: expected beside a Fit, which knows what is expected of a group of recordings, "
            "got beside a Twin"
        )
    for experiment in experiments:
        if experiment.fingerprint in fit.fingerprints:
            raise MatchError(
                f"given: expected recordings that the fit has not seen, got {experiment.name!r}, "
                "which it was matched to; leave given out"
            )
    if len({*groups}) > 1:
        raise MatchError(
            "given: expected recordings of a single group, got "
            f"{', '.join(sorted({*groups}))}; name the group with group=..."
        )
    return fit


def match_first_part(fit: Fit, experiment: Experiment, given: float, group: str) -> Fit:
    """Applies `match_group` to the first part of a single recording.

    **Arguments:**

    - `given`: the length of that part, s.

    **Raises:** `MatchError` if the part has too few samples; the errors of `match_group`.
    """
    start = estimate_initial_conditions(fit, experiment, min(WARM_UP, given), group=group)
    part = experiment.without_glitches().between(None, experiment.time[0] + given)
    return match_group(fit, [part], group, start)


def descend_with_noise(
    problem: MatchProblem, noise_model: NoiseModel, max_iterations: int
) -> MatchEstimate:
    """Minimises with the given noise; corrections of the camera are detected."""
    noise_model = replace(
        initial_noise_model(problem),
        channel=noise_model.channel,
        common_mode=noise_model.common_mode,
    )
    vector, space = problem.unknowns.start(), problem.unknowns.search_space()
    solver, estimates = default_solver(problem), []
    for _ in range(EVENT_ROUNDS):
        objective = make_objective(problem, noise_model)
        (result,) = descend([problem], [objective], solver, [vector], space, max_iterations)
        estimates.append(MatchEstimate(result, noise_model))
        if not np.isfinite(result.cost):
            break
        solution = update_noise_model(problem, noise_model, result.recording_errors()).events
        if solution == noise_model.events:
            break
        vector, noise_model = result.vector, replace(noise_model, events=solution)
    return estimates[-1]


def _rows_of_start(rows: Sequence[Parameter], start: InitialConditions) -> dict[str, Parameter]:
    """The parameters of one recording, with the estimates from its first minute as priors."""
    standard_deviations = dict(
        zip(start.values, np.sqrt(np.diag(start.covariance)).tolist(), strict=True)
    )
    result = {}
    for row in rows:
        if row.name in start.values:
            value, standard_deviation = start.values[row.name], standard_deviations[row.name]
            lower, upper = row.lower, row.upper
            if not row.is_logarithmic:
                lower, upper = (
                    min(lower, value - 5 * standard_deviation),
                    max(upper, value + 5 * standard_deviation),
                )
            result[row.name] = replace(
                row,
                value=value,
                lower=lower,
                upper=upper,
                prior_value=value,
                prior_spread=standard_deviation,
            )
    return result
