"""Iteratively reweighted least squares: minimise, estimate the noise from the residuals, update the
weights."""

from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np
import optimistix as optx

from ..errors import MatchError
from ._descent import descend
from ._descent_result import MatchEstimate, OnStep, Start
from ._levenberg_marquardt import BoundedLevenbergMarquardt
from ._noise_model import NoiseModel, has_settled, initial_noise_model, update_noise_model
from ._objective import MatchObjective, make_objective, shapes_needed
from ._problem import MatchProblem

# Relative tolerances of the cost for the rounds before the last. There is one more round, and not
# as many as it takes until the weights no longer change: part of the errors of a twin that is not
# exact is then taken for parameters, the noise becomes too small, and the predictions of
# `dual-cell` for another day become worse (docs/two-cell-rig.md).
LOOSE = (3e-2, 1e-2)

# The largest number of rounds after the third. Each brings the weight of a gross outlier nearer to
# its limit; without one, none is needed.
MORE_ROUNDS = 10


def reweighted_least_squares(
    problems: Sequence[MatchProblem],
    solver: optx.AbstractLeastSquaresSolver,
    starts: Sequence[Start],
    max_iterations: int,
    on_step: OnStep | None = None,
) -> list[MatchEstimate]:
    """Matches in three rounds, whose weights follow from the residuals of the round before; in a
    single round if the weights do not depend on the noise. With a robust loss, there are as many
    more as the weights of gross outliers need.

    **Arguments:**

    - `problems`: one or several problems that differ only in their recordings' temperatures,
      samples and events.
    - `solver`: the solver, with the tolerances of the last round.
    - `starts`: the starts. `max_iterations`: the limit for each, over all rounds.
    - `on_step`: called with the number of the problem and each step.

    **Raises:** `MatchError` if the recordings of two problems differ in shape.
    """
    noise_models = [initial_noise_model(problem) for problem in problems]
    if not problems[0].is_weighted:
        return _descend(problems, noise_models, solver, starts, max_iterations, on_step)
    first, second = (_loosened(solver, rtol) for rtol in LOOSE)
    estimates = _descend(problems, noise_models, first, starts, max_iterations, on_step)
    for of_round in (second, solver):
        estimates = another_round(problems, of_round, estimates, max_iterations, on_step)
    for _ in range(MORE_ROUNDS * (problems[0].loss is not None)):
        updated = _updated_noise_models(problems, estimates)
        before = [estimate.noise_model for estimate in estimates]
        if all(map(has_settled, before, updated)):
            break
        estimates = another_round(problems, solver, estimates, max_iterations, on_step)
    return estimates


def another_round(
    problems: Sequence[MatchProblem],
    solver: optx.AbstractLeastSquaresSolver,
    estimates: Sequence[MatchEstimate],
    max_iterations: int,
    on_step: OnStep | None = None,
) -> list[MatchEstimate]:
    """Continues matches with the weights that follow from their residuals. The arguments are those
    of `reweighted_least_squares`."""
    noise_models = _updated_noise_models(problems, estimates)
    results = [estimate.result for estimate in estimates]
    return _descend(problems, noise_models, solver, results, max_iterations, on_step)


def _updated_noise_models(
    problems: Sequence[MatchProblem], estimates: Sequence[MatchEstimate]
) -> list[NoiseModel]:
    return [
        update_noise_model(problem, noise_model, result.recording_errors())
        if np.isfinite(result.cost)
        else noise_model
        for problem, (result, noise_model) in zip(problems, estimates, strict=True)
    ]


def _descend(
    problems: Sequence[MatchProblem],
    noise_models: Sequence[NoiseModel],
    solver: optx.AbstractLeastSquaresSolver,
    starts: Sequence[Start],
    max_iterations: int,
    on_step: OnStep | None,
) -> list[MatchEstimate]:
    pairs = list(zip(problems, noise_models, strict=True))
    # All problems have the same number of the camera's shapes, so that they share compiled steps.
    shapes = max(shapes_needed(*pair) for pair in pairs)
    objectives = [make_objective(*pair, shapes) for pair in pairs]
    _check_alike(objectives)
    space = problems[0].unknowns.search_space()
    results = descend(problems, objectives, solver, starts, space, max_iterations, on_step)
    return [MatchEstimate(*pair) for pair in zip(results, noise_models, strict=True)]


def _loosened(
    solver: optx.AbstractLeastSquaresSolver, rtol: float
) -> optx.AbstractLeastSquaresSolver:
    """The default solver with another tolerance; any other solver unchanged."""
    return replace(solver, rtol=rtol) if isinstance(solver, BoundedLevenbergMarquardt) else solver


def _check_alike(objectives: Sequence[MatchObjective]) -> None:
    first, *others = [
        (jax.tree.structure(objective), [np.shape(leaf) for leaf in jax.tree.leaves(objective)])
        for objective in objectives
    ]
    for number, other in enumerate(others, start=1):
        if other != first:
            raise MatchError(
                "sets: expected equally many recordings, alike in how many channels they have "
                "and in whether the ambient temperature is recorded, and nearly alike in how "
                f"many samples they have and how often their inputs change, got set {number} with "
                "recordings of other shapes than set 0"
            )
