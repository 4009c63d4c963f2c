"""Matches parameters of a twin to recordings: step 4 of the paper, from arguments to a `Fit`."""

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime

import jax
import numpy as np
import optimistix as optx
from jaxtyping import Float

from .. import __version__
from .._arguments import check_callable, names_of, of_kind, whole_number
from .._lapack import one_blas_thread
from .._progress import advanced, announced
from .._statistics import fit_percent
from ..errors import MatchError
from ..io import Gaps, Recordings, as_experiments
from ..physics import Twin
from ..simulation import Initial, checked_initial
from ._camera_error import CameraError, Comparison
from ._descent import descend
from ._descent_result import (
    DescentStep,
    Iteration,
    MatchEstimate,
    Optimum,
    make_iteration,
    make_optimum,
)
from ._fit import Fit, Solution
from ._fitted_parameters import fitted_parameters
from ._levenberg_marquardt import BoundedLevenbergMarquardt
from ._loss import AbstractLoss
from ._model_error import estimate_model_error
from ._native_recordings import NativeRecordings
from ._nominal_twin import nominal_twin
from ._objective import make_objective
from ._problem import (
    Events,
    MatchProblem,
    ParameterChoice,
    SampleOptions,
    choose_unknowns,
    make_match_problem,
)
from ._recording_notes import influential_readings, recording_notes
from ._recordings import (
    Span,
    check_distinct,
    check_start,
    divided,
    named_groups,
    named_recordings,
)
from ._reweighted_least_squares import another_round, reweighted_least_squares
from ._start import first_sample, starts_without_effect
from ._uncertainty import estimate_uncertainty
from ._unknowns import Unknowns

# The relative difference below which two weighted costs are taken as equal.
SAME_COST = 1e-3


@announced("match")
@one_blas_thread()
def match(
    twin: Twin | Fit,
    experiments: Recordings,
    *,
    free: Iterable[str] | None = None,
    fixed: Iterable[str] = (),
    shared: Iterable[str] = (),
    per_recording: Iterable[str] = (),
    groups: Sequence[str] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    events: Events | None = None,
    masks: Mapping[str, Sequence[Span]] | None = None,
    gaps: Gaps = "hold",
    loss: AbstractLoss | None = None,
    initial: Initial = None,
    starts: int = 1,
    seed: int = 0,
    max_iterations: int = 200,
    solver: optx.AbstractLeastSquaresSolver | None = None,
    on_progress: Callable[[Iteration], None] | None = None,
) -> Fit:
    """Matches a twin to recordings by nonlinear least squares, in float64.

    All recordings count together; missing samples (NaN) have no weight. Positive parameters are
    matched by their logarithm, inside their bounds. Derivatives of the simulation are central
    differences of draws in C, or exact ones by JAX where there is no C compiler.

    Without priors and without a common error of the camera in the rig file, the cost is eq. (11) of
    the paper. With them the residuals are weighted by their noise. Its standard deviation and
    autocorrelation time, for the channels and for their common mode, are estimated in a few rounds.
    The camera's common error is solved for in closed form in each evaluation.

    **Arguments:**

    - `twin`: the start of the match, with the values of the parameters that are held. For a fit
      these are its values, and the mean of its recordings' own values.
    - `experiments`: one or several recordings of this rig, or their files.
    - `free`: names of the parameters to match, in place of those that the rig's table marks as
      free.
    - `fixed`: names of parameters to hold.
    - `shared`, `per_recording`: names of parameters to match in addition to the free ones, with a
      single value for all recordings or a value for each (typically ambient and start temperature),
      whatever their scope in the table.
    - `groups`: the name of each recording's group, such as its day; by default the groups that the
      recordings name. Parameters of `scope = "group"` have a value for each group. With a single
      group they are shared.
    - `bounds`: bounds that replace those of the table, name -> (lower, upper) in the parameter's
      unit.
    - `events`: recording -> times of the camera's flat-field corrections, s; or `"detect"` or
      `"none"`; by default as the rig file says. Only for rigs whose camera has a common error.
    - `masks`: recording -> spans (from, to) or (from, to, weight) with a smaller weight, 0 by
      default.
    - `gaps`: `"hold"`: over a gap in the times the duty is held, and a recording is divided only at
      a gap that is too long for that; `"split"`: the parts between all gaps (`Experiment.parts`)
      count as recordings of their own, each with its own room.
    - `loss`: how much a residual counts by its size, such as `jaxtwin.matching.Huber(3.0)` with its
      threshold in robust standard deviations; None for plain squares.
    - `initial`: the temperatures at the start of each recording, as in `simulate`: `"steady"`, a
      number or a temperature for each node. The parameters of the temperatures at the start are
      then held, because they have no effect.
    - `starts`: the number of starts. The first is the twin. The others vary each positive parameter
      by a factor of about e (or the width of its prior) and each other parameter by a tenth of its
      range (or the width of its prior), inside the bounds. They run in one batch; `Fit.optima`
      compares their ends.
    - `seed`: the seed of the other starts.
    - `max_iterations`: the limit for each start, over all rounds.
    - `solver`: any least-squares solver of optimistix, such as `optimistix.LevenbergMarquardt(rtol,
      atol)`, which runs through `optimistix.least_squares` with bounds by a transform (see
      `docs/matching.md`). The default is a `BoundedLevenbergMarquardt`, which runs all starts side
      by side and shows its steps.
    - `on_progress`: called with each `Iteration` when it ends, for example `print`.

    **Returns:** a `Fit`, the best of all starts. Evaluations use the default solver's longest
    steps, as `response` does. `Fit.solver_gap` is the difference from a solution with shorter ones.

    **Raises:** `MatchError` if nothing is free; if a recording has no temperatures or is there
    twice; if there are fewer samples than unknowns; if nothing changes in any recording; if a
    recording begins outside the bounds of its start; if bounds exclude the start or the prior, or
    change the meaning of the prior's spread; if a held parameter has a scope, or a parameter that
    is not free has bounds; if groups are not given for each recording; if values that each
    recording of a fit has are neither free nor fixed; if events or masks lie outside their
    recording; or if no start gives finite temperatures. `ParameterError` for unknown names and for
    a parameter with several values; `SimulationError` for recordings of another rig.
    """
    began = time.perf_counter()
    fit = twin if isinstance(twin, Fit) else None
    twin = nominal_twin("twin", twin, MatchError)
    given = as_experiments("match: experiments", experiments, MatchError, twin.rig)
    given, groups = divided(given, groups, gaps)
    recordings = named_recordings(twin, given)
    group_names, group_numbers = named_groups(recordings, groups)
    check_distinct(recordings)
    held = without_starts(twin, fixed, initial)
    choice = ParameterChoice(free, held, shared, per_recording, bounds)
    unknowns = choose_unknowns(twin, group_numbers, choice)
    for name, experiment in recordings.items():
        check_start(twin.rig, unknowns.entry_parameters, name, experiment)
    if fit is not None:
        _check_own_values(fit, unknowns, held)
    whole_number("starts", starts, 1, MatchError)
    whole_number("max_iterations", max_iterations, 1, MatchError)
    whole_number("seed", seed, 0, MatchError)
    check_callable("on_progress", on_progress, MatchError)
    problem = make_match_problem(
        twin,
        recordings,
        unknowns,
        group_names=group_names,
        options=SampleOptions(events, masks, loss),
        initial=initial,
    )
    solver = checked_solver(solver, problem)

    def report_step(start: int, step: DescentStep) -> None:
        advanced(step.number, None, f"RMSE {math.sqrt(step.mean_square):.4g} K")
        if on_progress is not None:
            on_progress(make_iteration(problem, step, start))

    first, *others = _start_vectors(unknowns, starts, seed)
    ((result, noise_model),) = reweighted_least_squares(
        [problem], solver, [first], max_iterations, report_step
    )
    results = [result]
    if others:
        # All starts use the weights of the first, so that their costs can be compared.
        results += descend(
            [problem] * len(others),
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
            f"{twin.rig.name}: expected finite temperatures from the start values, got none; start "
            "from other values"
        )
    number = best_first[0]
    best = results[number]
    optima = tuple(make_optimum(problem, results[start], start, best) for start in best_first)
    estimate = MatchEstimate(best, noise_model)
    if problem.is_weighted and not results[0].cost <= (1 + SAME_COST) * best.cost:
        # The weights come from a worse start, or from one without finite temperatures.
        (estimate,) = another_round(
            [problem], solver, [estimate], max_iterations, lambda _, step: report_step(number, step)
        )
    return make_fit(problem, estimate, number, optima, began)


def make_fit(
    problem: MatchProblem,
    estimate: MatchEstimate,
    start: int,
    optima: tuple[Optimum, ...],
    began: float,
) -> Fit:
    """Makes the fit of the best descent.

    **Arguments:**

    - `start`: the number of the start of the best descent.
    - `optima`: the ends of the descents from all starts, best first.
    - `began`: the time at which the match began, by `time.perf_counter`.
    """
    twin, unknowns, names = problem.twin, problem.unknowns, problem.names
    result, noise_model = estimate
    values = [
        {name: float(value) for name, value in of_recording.items()}
        for of_recording in unknowns.recording_values(result.vector)
    ]
    cameras = [
        CameraError(events, errors.camera)
        for events, errors in zip(noise_model.events, result.recording_errors(), strict=True)
    ]
    comparisons = tuple(
        Comparison(twin.with_values(of_recording), experiment, problem.initial, camera)
        for of_recording, experiment, camera in zip(
            values, problem.experiments, cameras, strict=True
        )
    )
    simulated = result.temperatures()
    readings = [
        temperatures + camera.offset[:, None]
        for temperatures, camera in zip(simulated, cameras, strict=True)
    ]
    uncertainty, noise = estimate_uncertainty(problem, estimate)
    model_error = estimate_model_error(problem, estimate)
    return Fit(
        twin=twin.with_values(values[0]),
        recordings=names,
        fingerprints=tuple(experiment.fingerprint for experiment in problem.experiments),
        channels=tuple(experiment.channels for experiment in problem.experiments),
        first_samples=tuple(map(first_sample, problem.experiments)),
        parameters=fitted_parameters(problem, result.vector, uncertainty),
        recording_values={
            name: {
                row.name: of_recording[row.name]
                for row in unknowns.per_group + unknowns.per_recording
            }
            for name, of_recording in zip(names, values, strict=True)
        },
        fit_percent={
            (name, channel): percent
            for name, experiment, reading in zip(names, problem.experiments, readings, strict=True)
            for channel, percent in zip(
                experiment.channels,
                fit_percent(np.asarray(experiment.temperatures), reading).tolist(),
                strict=True,
            )
            if channel not in experiment.unsampled
        },
        rmse=float(np.sqrt(result.mean_square)),
        status=result.status,
        converged=result.converged,
        history=tuple(make_iteration(problem, step, start) for step in result.steps),
        optima=optima,
        wall_time=time.perf_counter() - began,
        solver_gap=_solver_gap(problem, result.vector, comparisons, simulated),
        camera_error=float(
            np.sqrt(np.mean(np.concatenate([camera.error for camera in cameras]) ** 2))
        ),
        noise=noise,
        uncertainty=uncertainty,
        model_error=model_error,
        cost=result.cost,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        versions={"jaxtwin": __version__, "jax": jax.__version__},
        notes=(
            *(note for each in problem.experiments for note in recording_notes(each, twin)),
            *influential_readings(problem.experiments, readings),
        ),
        comparisons=comparisons,
        _solution=Solution(problem, noise_model, result.vector),
    )


def _solver_gap(
    problem: MatchProblem,
    vector: Float[np.ndarray, " unknowns"],
    comparisons: Sequence[Comparison],
    simulated: Sequence[Float[np.ndarray, "_times _channels"]],
) -> float:
    """The largest difference between simulated readings and those of shorter steps, K: of C where
    it solves them, of `simulate` elsewhere."""
    native = NativeRecordings.of(problem)
    gaps = []
    for number, (comparison, of_match) in enumerate(zip(comparisons, simulated, strict=True)):
        errors = None
        if native is not None:
            errors = native.errors_of_short_steps(vector, number)
        if errors is None:
            gap = comparison.run.temperatures - of_match
        else:
            recorded = np.nan_to_num(np.asarray(comparison.experiment.temperatures))
            gap = errors[: len(recorded)] + recorded - of_match
        gaps.append(float(np.abs(gap).max()))
    return max(gaps)


def without_starts(twin: Twin, fixed: Iterable[str], initial: Initial) -> tuple[str, ...]:
    """The parameters to hold: the fixed ones, and those of the temperatures at the start if these
    are given.

    **Raises:** `SimulationError` for invalid temperatures.
    """
    held = names_of("fixed", fixed, MatchError)
    given = starts_without_effect(twin, checked_initial(twin, initial))
    return (*held, *sorted(given - {*held}))


def default_solver(problem: MatchProblem) -> BoundedLevenbergMarquardt:
    """The default solver. Its tolerance is looser for weighted residuals, which are in units of
    standard deviations: a change of the cost by a thousandth means nothing there. Plain residuals
    may be exact, for a recording without noise."""
    return BoundedLevenbergMarquardt(rtol=3e-5 if problem.is_weighted else 1e-7)


def checked_solver(
    solver: optx.AbstractLeastSquaresSolver | None, problem: MatchProblem
) -> optx.AbstractLeastSquaresSolver:
    """The given solver, or the default one.

    **Raises:** `MatchError` if it is not a least-squares solver.
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
    """The twin's own values, followed by random ones around them inside the bounds."""
    first, scale = unknowns.start(), unknowns.scales()
    rng = np.random.default_rng(seed)
    moved = [first + scale * rng.standard_normal(first.size) for _ in range(starts - 1)]
    return [first, *(np.clip(vector, unknowns.lower(), unknowns.upper()) for vector in moved)]


def _check_own_values(fit: Fit, unknowns: Unknowns, held: Iterable[str]) -> None:
    """Refuses to hold a value that each recording of a fit has for itself, unless that is said: all
    recordings would get their mean, and the other parameters would make up for it.

    **Raises:** `MatchError` that names the parameters.
    """
    free = {row.name for row in unknowns.shared + unknowns.per_group + unknowns.per_recording}
    own = [row.name for row in fit.parameters.values() if row.free and row.scope == "recording"]
    lost = [name for name in own if name not in free | set(held)]
    if lost:
        names = ", ".join(lost)
        raise MatchError(
            f"match: {names}: expected parameters with a value for each recording of the fit in "
            "per_recording, or in fixed for their mean, got neither"
        )
