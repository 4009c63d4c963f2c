"""Many sets of recordings matched in one batch."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import optimistix as optx

from .._arguments import check_callable, whole_number
from .._executor import Executor, check_executor, work_in_units
from .._lapack import one_blas_thread
from .._progress import announced
from ..errors import MatchError, ParameterError, SimulationError
from ..io import Experiment, as_experiments
from ..physics import Twin
from ._descent_result import DescentStep, Iteration, MatchEstimate, make_iteration
from ._fit import Fit
from ._loss import AbstractLoss
from ._match import checked_solver, make_fit
from ._nominal_twin import nominal_twin
from ._problem import (
    Events,
    MatchProblem,
    ParameterChoice,
    SampleOptions,
    choose_unknowns,
    make_match_problem,
)
from ._recordings import Span, check_recording_names, named_groups, named_recordings
from ._reweighted_least_squares import reweighted_least_squares

# The number of sets that a worker of an executor matches side by side.
UNIT = 4


@announced("match of several sets")
@one_blas_thread()
def match_many(
    twin: Twin | Fit,
    sets: Sequence[Sequence[Experiment]],
    *,
    free: Iterable[str] | None = None,
    fixed: Iterable[str] = (),
    shared: Iterable[str] = (),
    per_recording: Iterable[str] = (),
    groups: Sequence[str] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    events: Events | None = None,
    masks: Mapping[str, Sequence[Span]] | None = None,
    loss: AbstractLoss | None = None,
    max_iterations: int = 200,
    solver: optx.AbstractLeastSquaresSolver | None = None,
    executor: Executor | None = None,
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
      eighth, or freely if they are small.
    - `groups`: the name of each recording's group in every set, as in `match`; by default the
      groups that the recordings name. The recordings of all sets must be grouped alike.
    - `events`, `masks`: as in `match`, for the recordings of these names in whichever sets they
      are.
    - `executor`: an executor whose workers match the sets instead of this process, four at a time;
      see `simulate_batch`. A fit is the same for any number of workers, and up to rounding the same
      as without an executor.
    - `on_progress`: called with each `Iteration` when it ends, or with an executor when its four
      sets are done; its `start` is the number of the set, counted from 0.
    - the others: as in `match`.

    **Returns:** a `Fit` for each set, in order; None for a set whose temperatures, residuals or
    derivatives are not finite. Such a set does not affect the others.

    **Raises:** the errors of `match`, except that for temperatures that are not finite;
    `MatchError` also if there is no set, the sets differ in shape, or an executor fails.
    """
    twin = nominal_twin("twin", twin, MatchError)
    whole_number("max_iterations", max_iterations, 1, MatchError)
    check_callable("on_progress", on_progress, MatchError)
    check_executor("match_many: executor", executor, MatchError)
    if isinstance(sets, str | bytes | Experiment) or not isinstance(sets, Iterable):
        raise MatchError(f"sets: expected one or several sets of recordings, got {sets!r}")
    listed = [as_experiments("match_many: sets", members, MatchError, twin.rig) for members in sets]
    if not listed:
        raise MatchError("sets: expected one or several sets of recordings, got none")
    recordings = [named_recordings(twin, members) for members in listed]
    grouped = [named_groups(members, groups) for members in recordings]
    (_, places), *others = grouped
    for number, (_, result) in enumerate(others, start=1):
        if len(result) == len(places) and result != places:
            raise MatchError(
                "sets: expected recordings that are grouped alike in all sets, got the groups "
                f"{result} in set {number} and {places} in set 0; pass groups=[...], a name for "
                "each recording"
            )
    unknowns = choose_unknowns(
        twin,
        places,
        ParameterChoice(free, fixed, shared, per_recording, bounds),
    )
    for what, given in (("events", events), ("masks", masks)):
        if isinstance(given, Mapping):
            check_recording_names(what, {n for members in recordings for n in members}, given)
    problems = [
        make_match_problem(
            twin,
            members,
            unknowns,
            group_names=names,
            options=SampleOptions(_of_set(events, members), _of_set(masks, members), loss),
        )
        for members, (names, _) in zip(recordings, grouped, strict=True)
    ]

    def report(iteration: Iteration) -> None:
        if on_progress is not None:
            on_progress(iteration)

    optimiser = checked_solver(solver, problems[0])
    if executor is None:
        return _match_sets(problems, optimiser, max_iterations, report)
    fits: list[Fit | None] = [None] * len(problems)
    # The last unit is padded to the size of the others, so that it uses their compiled programs.
    units = [
        ([*part, *part[-1:] * (min(UNIT, len(problems)) - len(part))], optimiser, max_iterations)
        for part in (problems[first : first + UNIT] for first in range(0, len(problems), UNIT))
    ]
    where = "match_many: executor"
    with closing(work_in_units(where, executor, _match_unit, units, MatchError)) as done:
        for number, (result, iterations) in done:
            first = number * UNIT
            count = min(UNIT, len(problems) - first)
            fits[first : first + count] = result[:count]
            for iteration in iterations:
                if iteration.start < count:
                    report(replace(iteration, start=first + iteration.start))
    return tuple(fits)


def _of_set(given: Any, members: Mapping[str, Experiment]) -> Any:
    """Selects, from an argument given for the recordings of all sets, the part for a single set."""
    if not isinstance(given, Mapping):
        return given
    return {name: value for name, value in given.items() if name in members}


def _match_unit(
    problems: Sequence[MatchProblem],
    optimiser: optx.AbstractLeastSquaresSolver,
    max_iterations: int,
) -> tuple[tuple[Fit | None, ...], list[Iteration]]:
    """Matches some sets, and returns their fits and all iterations."""
    iterations: list[Iteration] = []
    return _match_sets(problems, optimiser, max_iterations, iterations.append), iterations


def _match_sets(
    problems: Sequence[MatchProblem],
    optimiser: optx.AbstractLeastSquaresSolver,
    max_iterations: int,
    report: Callable[[Iteration], None],
) -> tuple[Fit | None, ...]:
    """Matches some sets side by side."""
    began = time.perf_counter()

    def report_step(number: int, step: DescentStep) -> None:
        report(make_iteration(problems[number], step, number))

    starts = [problem.unknowns.start() for problem in problems]
    estimates = reweighted_least_squares(problems, optimiser, starts, max_iterations, report_step)
    return tuple(_fit(*pair, began) for pair in zip(problems, estimates, strict=True))


def _fit(problem: MatchProblem, estimate: MatchEstimate, began: float) -> Fit | None:
    if not np.isfinite(estimate.result.cost):
        return None
    try:
        return make_fit(problem, estimate, 0, (), began)
    except (ParameterError, SimulationError, np.linalg.LinAlgError):
        # Invalid values, and temperatures or derivatives that are not finite: a descent does not
        # check for all of these.
        return None
