"""Many sets of recordings matched in one batch."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
import optimistix as optx

from .._arguments import check_callable, whole_number
from .._errors import MatchError, ParameterError, SimulationError
from .._waiting import announced
from ..io import Experiment
from ..io._experiment import as_experiments
from ..physics import Twin
from ._descent_result import DescentStep
from ._fit import Fit
from ._iterations import Iteration, make_iteration
from ._make_fit import make_fit
from ._match import checked_solver
from ._problem import Events, MatchProblem, make_match_problem, named_recordings
from ._reweighted_least_squares import Estimate, reweighted_least_squares
from ._unknowns import choose_unknowns


@announced("match of several sets")
def match_many(
    twin: Twin | Fit,
    sets: Sequence[Sequence[Experiment]],
    *,
    free: Iterable[str] | None = None,
    fixed: Iterable[str] = (),
    shared: Iterable[str] = (),
    per_recording: Iterable[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    events: Events | None = None,
    robust: float | None = None,
    max_iterations: int = 200,
    solver: optx.AbstractLeastSquaresSolver | None = None,
    on_progress: Callable[[Iteration], None] | None = None,
) -> tuple[Fit | None, ...]:
    """Matches the same twin to many sets of recordings, each on its own, in batches.

    All matches run together through one compiled program: for example hundreds of synthetic
    recordings for a study of coverage, resampled recordings for a bootstrap, or the same test on
    many benches.

    **Arguments:**

    - `twin`: the start of each match.
    - `sets`: the recordings of each match. All sets need the same number of recordings, with the
      same number of channels, and all or none with a recorded ambient temperature. The numbers of
      samples and of changes of the inputs, from which the solver's steps follow, may differ by an
      eighth, or freely where they are small.
    - `on_progress`: called with each `Iteration` when it ends; its `start` is the number of the
      set, counted from 0.
    - the others: as in `match`.

    **Returns:** a `Fit` for each set, in order; None for a set whose temperatures, residuals or
    derivatives are not finite. Such a set does not affect the others.

    **Raises:** the errors of `match`, except that for temperatures that are not finite;
    `MatchError` also if there is no set or the sets differ in shape.
    """
    began = time.perf_counter()
    twin = twin.mean_twin if isinstance(twin, Fit) else twin
    whole_number("max_iterations", max_iterations, 1, MatchError)
    check_callable("on_progress", on_progress, MatchError)
    if isinstance(sets, str | bytes | Experiment) or not isinstance(sets, Iterable):
        raise MatchError(f"sets: expected one or several sets of recordings, got {sets!r}")
    listed = [as_experiments("match_many: sets", members, MatchError) for members in sets]
    if not listed:
        raise MatchError("sets: expected one or several sets of recordings, got none")
    recordings = [named_recordings(twin, members) for members in listed]
    unknowns = choose_unknowns(
        twin,
        (0,) * len(recordings[0]),
        free=free,
        fixed=fixed,
        shared=shared,
        per_recording=per_recording,
        bounds=bounds,
    )
    problems = [
        make_match_problem(twin, members, unknowns, events=events, robust=robust)
        for members in recordings
    ]

    def report_step(number: int, step: DescentStep) -> None:
        if on_progress is not None:
            on_progress(make_iteration(problems[number], step, number))

    estimates = reweighted_least_squares(
        problems,
        checked_solver(solver, problems[0]),
        [unknowns.start()] * len(problems),
        max_iterations,
        report_step,
    )
    return tuple(_fit(*pair, began) for pair in zip(problems, estimates, strict=True))


def _fit(problem: MatchProblem, estimate: Estimate, began: float) -> Fit | None:
    if not np.isfinite(estimate.result.cost):
        return None
    try:
        return make_fit(problem, estimate, 0, (), began)
    except (ParameterError, SimulationError, np.linalg.LinAlgError):
        # Values without a meaning, temperatures or derivatives that are not finite: descents do not
        # look at all of that.
        return None
