"""Behavioural matching: a twin's parameters from recordings, step 4 of the paper."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import optimistix as optx
from jaxtyping import Float

from .._arguments import check_callable, of_kind, whole_number
from .._errors import MatchError
from .._waiting import announced
from ..io import Experiment
from ..io._experiment import as_experiments
from ..physics import Twin
from ._descent import descend
from ._descent_result import DescentStep
from ._fit import Fit, Iteration
from ._levenberg_marquardt import BoundedLevenbergMarquardt
from ._make_fit import make_fit, make_iteration, make_optimum
from ._masks_and_events import Span
from ._objective import make_objective
from ._problem import Events, MatchProblem, make_match_problem, named_groups, named_recordings
from ._reweighted_least_squares import Estimate, reweighted_least_squares
from ._unknowns import Unknowns, choose_unknowns


@announced("match")
def match(
    twin: Twin | Fit,
    experiments: Experiment | Sequence[Experiment],
    *,
    free: Iterable[str] | None = None,
    fixed: Iterable[str] = (),
    shared: Iterable[str] = (),
    per_recording: Iterable[str] = (),
    groups: Sequence[str] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    events: Events | None = None,
    masks: Mapping[str, Sequence[Span]] | None = None,
    robust: float | None = None,
    starts: int = 1,
    seed: int = 0,
    max_iterations: int = 200,
    solver: optx.AbstractLeastSquaresSolver | None = None,
    on_progress: Callable[[Iteration], None] | None = None,
) -> Fit:
    """Matches a twin to recordings by nonlinear least squares, in float64.

    All recordings count together; missing samples (NaN) count nothing. Positive parameters are
    matched by their logarithm, inside their bounds, with exact derivatives through the simulation.

    Without priors and without a common error of the camera in the rig file this is eq. (11) of the
    paper. With them the residuals are weighted by their noise, which is estimated in a few rounds:
    its standard deviation and autocorrelation time, for the channels and for their common mode. The
    camera's common error is solved for in closed form in each evaluation.

    **Arguments:**

    - `twin`: where the match starts, and what the parameters that are held stay at; of a fit its
      values, and the mean of those that each of its recordings has.
    - `experiments`: recordings of this rig, one or several.
    - `free`: names of the parameters to match, instead of those that the rig's table calls free.
    - `fixed`: names to hold.
    - `shared`, `per_recording`: names to match with one value for all recordings, or one for each
      (ambient and start temperature, typically), beside the free ones and whatever the table's
      scope is.
    - `groups`: the name of each recording's group, such as its day; by default what the recordings
      say themselves. Parameters of `scope = "group"` have a value for each. With a single group
      they are shared.
    - `bounds`: other bounds, name -> (lower, upper) in the parameter's unit.
    - `events`: recording -> times of the camera's flat-field corrections, s; or `"detect"` or
      `"none"`; by default as the rig says. Only for rigs whose camera has a common error.
    - `masks`: recording -> spans (from, to) or (from, to, weight) that count less, or nothing.
    - `robust`: threshold of Huber's loss in robust standard deviations, None for least squares.
    - `starts`: how many starting points; the first is the twin, the others vary each positive
      parameter by a factor of about e (of its prior's width where it has one) and each other one
      by a tenth of its range (its prior's width), inside bounds. They descend in one batch, and
      `Fit.optima` compares where they end.
    - `seed`: of the other starts.
    - `max_iterations`: of each start, over all rounds.
    - `solver`: any least-squares solver of optimistix, such as `optimistix.LevenbergMarquardt(rtol,
      atol)`, which runs through `optimistix.least_squares` with bounds by a transform (see
      `docs/matching.md`); by default a `BoundedLevenbergMarquardt`, whose starts descend side by
      side and which shows its steps.
    - `on_progress`: called with each `Iteration` as it ends; `print` is a good one.

    **Returns:** a `Fit`, the best of all starts. Evaluations take the default solver's longest
    steps, as `response` does; the fit's runs are by `simulate`, which looks at its error, and
    `Fit.solver_gap` says how far apart the two are.

    **Raises:** `MatchError` where nothing is free, a recording has no temperatures, fewer samples
    count than there are unknowns, nothing moves in any recording, bounds exclude the start or the
    prior or change what its spread means, a name that is held has a scope or one that is not free
    bounds, there is no group for each recording, events or masks lie outside their recording, or no
    start gives finite temperatures; `ParameterError` for unknown names and for a parameter with
    several values; `SimulationError` for recordings of another rig.
    """
    began = time.perf_counter()
    twin = twin.mean_twin if isinstance(twin, Fit) else twin
    recordings = named_recordings(
        twin, as_experiments("match: experiments", experiments, MatchError)
    )
    group_names, group_numbers = named_groups(recordings, groups)
    unknowns = choose_unknowns(
        twin,
        group_numbers,
        free=free,
        fixed=fixed,
        shared=shared,
        per_recording=per_recording,
        bounds=bounds,
    )
    whole_number("starts", starts, 1, MatchError)
    whole_number("max_iterations", max_iterations, 1, MatchError)
    whole_number("seed", seed, 0, MatchError)
    check_callable("on_progress", on_progress, MatchError)
    problem = make_match_problem(twin, recordings, unknowns, events, masks, robust, group_names)
    solver = checked_solver(solver, problem)

    def report_step(start: int, step: DescentStep) -> None:
        if on_progress is not None:
            on_progress(make_iteration(problem, step, start))

    first, *others = _start_vectors(unknowns, starts, seed)
    ((result, noise_model),) = reweighted_least_squares(
        [problem], solver, [first], max_iterations, report_step
    )
    results = [result]
    if others:
        # They descend with the same weights, so that their costs can be compared.
        results += descend(
            [make_objective(problem, noise_model)] * len(others),
            solver,
            others,
            unknowns.search_space(),
            max_iterations,
            lambda number, step: report_step(number + 1, step),
        )
    best_first = sorted(
        (start for start, result in enumerate(results) if np.isfinite(result.cost)),
        key=lambda start: results[start].cost,
    )
    if not best_first:
        raise MatchError(
            f"{twin.rig.name}: the start gives no finite temperatures; start from other values"
        )
    best = results[best_first[0]]
    optima = tuple(make_optimum(problem, results[start], start, best) for start in best_first)
    return make_fit(problem, Estimate(best, noise_model), best_first[0], optima, began)


def default_solver(problem: MatchProblem) -> BoundedLevenbergMarquardt:
    """Weighted residuals are counted in standard deviations, and a fall of a thousandth means
    nothing; plain ones may be all that a recording without noise leaves."""
    return BoundedLevenbergMarquardt(rtol=3e-5 if problem.is_weighted else 1e-7)


def checked_solver(
    solver: optx.AbstractLeastSquaresSolver | None, problem: MatchProblem
) -> optx.AbstractLeastSquaresSolver:
    """The solver that was given, or the default one.

    **Raises:** `MatchError` where it is no least-squares solver.
    """
    if solver is None:
        return default_solver(problem)
    expected = (
        "an optimistix least-squares solver, such as optimistix.LevenbergMarquardt(1e-8, 1e-8) or "
        "jaxtwin.matching.BoundedLevenbergMarquardt(), or None"
    )
    return of_kind("solver", solver, optx.AbstractLeastSquaresSolver, expected, MatchError)


def _start_vectors(
    unknowns: Unknowns, starts: int, seed: int
) -> list[Float[np.ndarray, " unknowns"]]:
    """The twin's own values first, then random ones about them inside the bounds."""
    first, scale = unknowns.start(), unknowns.scales()
    rng = np.random.default_rng(seed)
    moved = [first + scale * rng.standard_normal(first.size) for _ in range(starts - 1)]
    return [first, *(np.clip(vector, unknowns.lower(), unknowns.upper()) for vector in moved)]
