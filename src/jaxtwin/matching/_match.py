"""Behavioural matching: a twin's parameters from recordings, step 4 of the paper."""

import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import count as count_from
from typing import Any, Literal

import jax
import numpy as np
from jaxtyping import Float

from .. import __version__
from .._arguments import check_callable, finite_number, of_kind, whole_number
from .._errors import MatchError
from ..io import Experiment
from ..io._experiment import as_experiments
from ..physics import Twin, check_twin
from ..simulation import Run, checked_channels, simulate
from ._confidence import confidence
from ._descend import DescentResult, Step, descend
from ._estimate import (
    MatchProblem,
    NoiseModel,
    estimate,
    make_objective,
    solved_temperatures,
    split_residuals,
)
from ._events import Span, given_events, span_weights
from ._fit import (
    CameraError,
    Comparison,
    Fit,
    FittedParameter,
    FittedParameters,
    Iteration,
    Optimum,
)
from ._interval import interval_95
from ._levenberg_marquardt import RUNNING, STATUS, BoundedLevenbergMarquardt
from ._uncertainty import Uncertainty
from ._unknowns import Unknowns, choose_unknowns
from ._warnings import parameter_warnings

Events = Mapping[str, Sequence[float]] | Literal["detect", "none"]
"""Recording -> times of the camera's corrections (s), or whether to look for them."""


def match(
    twin: Twin | Fit,
    experiments: Experiment | Sequence[Experiment],
    *,
    free: Iterable[str] | None = None,
    fixed: Iterable[str] = (),
    shared: Iterable[str] = (),
    per_recording: Iterable[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    events: Events | None = None,
    masks: Mapping[str, Sequence[Span]] | None = None,
    robust: float | None = None,
    starts: int = 1,
    seed: int = 0,
    max_iterations: int = 200,
    solver: BoundedLevenbergMarquardt | None = None,
    on_progress: Callable[[Iteration], None] | None = None,
) -> Fit:
    """Matches a twin to recordings by nonlinear least squares, in float64.

    All recordings count together; missing samples (NaN) count nothing. Positive parameters are
    matched by their logarithm, inside their bounds, with exact derivatives through the simulation.

    Without priors and without a common error of the camera in the rig file this is eq. (11) of the
    paper. With them the residuals are weighted by what they turn out to be like, in a few rounds:
    by their size and by how long they keep their sign, for what a channel has alone and for what
    all share; the camera's common error is solved for in closed form in each evaluation.

    **Arguments:**

    - `twin`: where the match starts, and what the parameters that are held stay at; of a fit its
      values, and the mean of those that each of its recordings has.
    - `experiments`: recordings of this rig, one or several.
    - `free`: names of the parameters to match, instead of those that the rig's table calls free.
    - `fixed`: names to hold.
    - `shared`, `per_recording`: names to match with one value for all recordings, or one for each
      (ambient and start temperature, typically), beside the free ones and whatever the table's
      scope is.
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
    - `max_iterations`: of each start.
    - `solver`: tolerances; see `BoundedLevenbergMarquardt`.
    - `on_progress`: called with each `Iteration` as it ends; `print` is a good one.

    **Returns:** a `Fit`, the best of all starts. Evaluations take the default solver's longest
    steps, as `response` does; the fit's runs are by `simulate`, which looks at its error, and
    `Fit.solver_gap` says how far apart the two are.

    **Raises:** `MatchError` where nothing is free, a recording has no temperatures, fewer samples
    count than there are unknowns, nothing moves in any recording, bounds exclude the start or the
    prior or change what its spread means, a name that is held has a scope or one that is not free
    bounds, events or masks lie outside their recording, or no start gives finite temperatures;
    `ParameterError` for unknown names and for a parameter with several values; `SimulationError`
    for recordings of another rig.
    """
    began = time.perf_counter()
    twin = twin.mean_twin if isinstance(twin, Fit) else twin
    recordings = as_experiments("match: experiments", experiments, MatchError)
    names = checked_recordings(twin, recordings)
    unknowns = choose_unknowns(
        twin,
        len(recordings),
        free=free,
        fixed=fixed,
        shared=shared,
        per_recording=per_recording,
        bounds=bounds,
    )
    check_counts(starts=starts, max_iterations=max_iterations)
    whole_number("seed", seed, 0, MatchError)
    check_callable("on_progress", on_progress, MatchError)
    problem = make_match_problem(twin, recordings, names, unknowns, events, masks, robust)
    solver = checked_solver(solver, problem)

    def report_step(start: int, step: Step) -> None:
        if on_progress is not None:
            on_progress(make_iteration(step, start, unknowns, names))

    vectors = _starts(unknowns, starts, seed)
    ((first, noise_model),) = estimate([problem], solver, vectors[:1], max_iterations, report_step)
    results = [first]
    if starts > 1:
        # The others descend on the same cost, so that they can be compared.
        objective = make_objective(problem, noise_model)
        results += descend(
            [objective] * (starts - 1),
            solver,
            vectors[1:],
            max_iterations,
            problem.bounds,
            problem.scale,
            on_step=lambda number, step: report_step(number + 1, step),
        )
    order = sorted(
        (number for number, one in enumerate(results) if np.isfinite(one.cost)),
        key=lambda number: results[number].cost,
    )
    if not order:
        raise MatchError(
            f"{twin.rig.name}: the start gives no finite temperatures; start from other values"
        )
    best = results[order[0]]
    optima = tuple(_optimum(results[number], number, best, unknowns, names) for number in order)
    return make_fit(problem, noise_model, best, order[0], names, optima, began)


def make_match_problem(
    twin: Twin,
    recordings: Sequence[Experiment],
    names: tuple[str, ...],
    unknowns: Unknowns,
    events: Events | None,
    masks: Mapping[str, Sequence[Span]] | None,
    robust: float | None,
) -> MatchProblem:
    """Checks what is said about single recordings and puts a match together."""
    weights = tuple(span_weights(names, recordings, masks))
    samples = sum(int(np.count_nonzero(one)) for one in weights)
    if samples <= unknowns.size:
        masked = ", the others are masked" if masks else ""
        raise MatchError(
            f"found {samples} samples for {unknowns.size} unknowns{masked}, allowed is at least "
            "one more than unknowns, because the rest of the residuals tells the noise"
        )
    if not any(_is_excited(one, weight) for one, weight in zip(recordings, weights, strict=True)):
        raise MatchError(
            f"{', '.join(names)}: found no excitation, every duty cycle is 0 and no reading ever "
            "changes; allowed is at least one recording in which something happens"
        )
    error = twin.rig.common_error
    if events is not None and error is None:
        raise MatchError(
            f"{twin.rig.name}: events: found {events!r}, allowed only where the rig file has a "
            "table [camera.common_error]"
        )
    if not (events is None or isinstance(events, Mapping) or events in ("detect", "none")):
        raise MatchError(
            f'events: found {events!r}, allowed is "detect", "none" or recording -> times'
        )
    if robust is not None and not finite_number("robust", robust, MatchError) > 0:
        raise MatchError(f"robust: found {robust!r}, allowed is a number above 0 or None")
    none = tuple(() for _ in recordings)
    if isinstance(events, Mapping):
        times = tuple(given_events(names, recordings, events))
    else:
        detect = error is not None and (error.detect if events is None else events == "detect")
        times = None if detect else none
    return MatchProblem(
        twin=twin,
        experiments=tuple(recordings),
        unknowns=unknowns,
        sample_weights=weights,
        events=times,
        common_error=error,
        robust=robust,
    )


def _is_excited(recording: Experiment, weight: Float[np.ndarray, "times channels"]) -> bool:
    """Whether a recording is driven, or any of its channels changes where it counts."""
    assert recording.temperatures is not None
    counted = np.where(weight > 0, recording.temperatures, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of channels that are masked throughout
        spread = np.nanmax(counted, axis=0) - np.nanmin(counted, axis=0)
    return bool(np.any(recording.duty) or np.any(spread > 0))


def default_solver(problem: MatchProblem) -> BoundedLevenbergMarquardt:
    """Weighted residuals are counted in standard deviations, and a fall of a thousandth means
    nothing; plain ones may be all that a recording without noise leaves."""
    return BoundedLevenbergMarquardt(rtol=3e-5 if problem.is_weighted else 1e-7)


def checked_solver(
    solver: BoundedLevenbergMarquardt | None, problem: MatchProblem
) -> BoundedLevenbergMarquardt:
    """The solver that was given, or the default one.

    **Raises:** `MatchError` where another thing was given.
    """
    if solver is None:
        return default_solver(problem)
    allowed = "a BoundedLevenbergMarquardt or None"
    return of_kind("solver", solver, BoundedLevenbergMarquardt, allowed, MatchError)


def make_fit(
    problem: MatchProblem,
    noise_model: NoiseModel,
    result: DescentResult,
    start: int,
    names: tuple[str, ...],
    optima: tuple[Optimum, ...],
    began: float,
) -> Fit:
    """The fit of the best descent."""
    twin, unknowns = problem.twin, problem.unknowns
    values = [
        {name: float(value) for name, value in one.items()}
        for one in unknowns.recording_values(result.vector)
    ]
    own = {
        name: {row.name: one[row.name] for row in unknowns.per_recording}
        for name, one in zip(names, values, strict=True)
    }
    runs = {
        name: simulate(twin.with_parameters(value), experiment)
        for name, value, experiment in zip(names, values, problem.experiments, strict=True)
    }
    residuals = split_residuals(result)
    solved = solved_temperatures(result)
    gaps = [run.temperatures - own for run, own in zip(runs.values(), solved, strict=True)]
    camera = {
        name: CameraError(events, error)
        for name, events, error in zip(names, noise_model.events, residuals.camera, strict=True)
    }
    fits = {
        (name, channel): value
        for name, run in runs.items()
        for channel, value in _seen(run, camera[name].offset).fit_percent.items()
    }
    known, noise = confidence(result, residuals, unknowns, noise_model, names)
    state = result.state
    return Fit(
        twin=twin.with_parameters(values[0]),
        recordings=names,
        fingerprints=tuple(one.fingerprint for one in problem.experiments),
        channels=tuple(one.channels for one in problem.experiments),
        parameters=_table(twin, unknowns, result.vector, known),
        recording_values=own,
        fit_percent=fits,
        rmse=float(np.sqrt(result.mean_square)),
        status=STATUS[int(state.status)],
        converged=int(state.status) != RUNNING,
        history=tuple(make_iteration(step, start, unknowns, names) for step in result.steps),
        optima=optima,
        wall_time=time.perf_counter() - began,
        solver_gap=max(float(np.abs(gap).max()) for gap in gaps),
        camera_error=float(np.sqrt(np.mean(np.concatenate(residuals.camera) ** 2))),
        noise=noise,
        uncertainty=known,
        cost=result.cost,
        problem=problem,
        noise_model=noise_model,
        vector=result.vector,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        versions={"jaxtwin": __version__, "jax": jax.__version__},
        comparisons=tuple(Comparison(runs[name], camera[name]) for name in names),
    )


def _seen(run: Run, offset: Float[np.ndarray, " times"]) -> Run:
    """A run with the camera's common error in its readings."""
    return replace(run, temperatures=run.temperatures + offset[:, None])


def make_iteration(step: Step, start: int, unknowns: Unknowns, names: tuple[str, ...]) -> Iteration:
    """One step of a descent in the parameters' units."""
    number, mean_square, gradient, accepted, vector = step
    return Iteration(
        number=number,
        start=start,
        cost=mean_square,
        rmse=float(np.sqrt(mean_square)),
        gradient=gradient,
        accepted=accepted,
        parameters=labelled(unknowns, vector, names),
    )


def _optimum(
    result: DescentResult,
    number: int,
    best: DescentResult,
    unknowns: Unknowns,
    names: tuple[str, ...],
) -> Optimum:
    # Samples that fill up recordings differ by nothing.
    pairs = zip(result.differences, best.differences, strict=True)
    squares = sum(float(np.sum((one - other) ** 2)) for one, other in pairs)
    samples = sum(int(g.lengths.sum()) * g.temperatures.shape[-1] for g in best.objective.groups)
    return Optimum(
        start=number,
        cost=result.cost,
        apart=float(np.sqrt(squares / samples)),
        rmse=float(np.sqrt(result.mean_square)),
        iterations=len(result.steps) - 1,
        status=STATUS[int(result.state.status)],
        converged=int(result.state.status) != RUNNING,
        parameters=labelled(unknowns, result.vector, names),
    )


def _starts(unknowns: Unknowns, starts: int, seed: int) -> list[Float[np.ndarray, " unknowns"]]:
    first, lower, upper = unknowns.start(), unknowns.lower(), unknowns.upper()
    precision = unknowns.prior_weights()
    spread = np.where(
        precision > 0, 1 / np.where(precision > 0, precision, 1), unknowns.default_scales()
    )
    rng = np.random.default_rng(seed)
    vectors = [first]
    for _ in range(starts - 1):
        moved = first + spread * rng.standard_normal(first.size)
        vectors.append(np.clip(moved, lower, upper))
    return vectors


def labelled(
    unknowns: Unknowns, vector: Float[np.ndarray, " unknowns"], names: tuple[str, ...]
) -> dict[str, float]:
    """Label -> value in the parameter's unit."""
    return dict(zip(unknowns.labels(names), unknowns.to_values(vector).tolist(), strict=True))


def _table(
    twin: Twin,
    unknowns: Unknowns,
    vector: Float[np.ndarray, " unknowns"],
    known: Uncertainty,
) -> FittedParameters:
    errors = np.sqrt(np.diag(known.covariance))
    # What nothing tells has a finite share in the vector's covariance.
    vector_errors = np.where(np.isinf(errors), np.inf, np.sqrt(np.diag(known.vector_covariance)))
    lower, upper = unknowns.lower(), unknowns.upper()
    with np.errstate(invalid="ignore"):
        touching = (vector <= lower + 1e-9) | (vector >= upper - 1e-9)
    centre, precision = unknowns.prior_means(), unknowns.prior_weights()
    away = (vector - centre) * precision
    published = twin.rig.parameter_sets.get("published", {})
    numbers: dict[str, list[int]] = {}
    for number, row in enumerate(unknowns.entry_parameters):
        numbers.setdefault(row.name, []).append(number)
    values = unknowns.to_values(vector)
    table = FittedParameters()
    for name, row in twin.rig.parameters.items():
        entries = numbers.get(name, [])
        matched = unknowns.entry_parameters[entries[0]] if entries else row
        initial = float(twin.parameters[name])
        value = float(np.mean(values[entries])) if entries else initial
        error = float(np.max(vector_errors[entries])) if entries else float("nan")
        logarithmic = matched.is_logarithmic
        has_prior = bool(entries) and matched.prior_spread is not None
        one = FittedParameter(
            name=name,
            unit=row.unit,
            description=row.description,
            free=bool(entries),
            scope=matched.scope,
            initial=initial,
            value=value,
            published=published.get(name),
            lower=matched.lower,
            upper=matched.upper,
            is_logarithmic=logarithmic,
            at_bound=bool(np.any(touching[entries])),
            standard_error=float(np.max(errors[entries])) if entries else float("nan"),
            prior_value=matched.prior_value if has_prior else None,
            prior_spread=matched.prior_spread if has_prior else None,
            prior_distance=max(away[entries].tolist(), key=abs) if has_prior else None,
            prior_to_data_ratio=float(np.min(known.prior_to_data_ratio[entries]))
            if entries
            else float("nan"),
            relative_standard_error=error if logarithmic else float("nan"),
            interval=interval_95(value, error, is_logarithmic=logarithmic),
        )
        table[name] = replace(one, warnings=parameter_warnings(one, known))
    return table


def checked_recordings(twin: Twin, recordings: list[Experiment]) -> tuple[str, ...]:
    """The names under which the results of recordings are kept.

    **Arguments:**

    - `twin`: of the rig that they must belong to.
    - `recordings`: one or several.

    **Returns:** a name for each, no two alike: its own, or its number where it has none; a name
    that occurs again is followed by its number, or by the next that no other name has.

    **Raises:** `MatchError` where there is none, one has no temperatures, or none in one of its
    channels; `SimulationError` for one of another rig.
    """
    check_twin("twin", twin, MatchError)
    if not recordings:
        raise MatchError("experiments: found none, allowed is one or several recordings")
    names: list[str] = []
    for number, experiment in enumerate(recordings, start=1):
        name = experiment.name or f"recording {number}"
        if experiment.temperatures is None or not experiment.channels:
            raise MatchError(f"{name}: found no recorded temperatures, allowed is a recording")
        checked_channels(twin, experiment)
        if experiment.unsampled:
            raise MatchError(
                f"{name}: channel {experiment.unsampled[0]}: found no sample that is not missing, "
                "allowed is at least one; leave the channel out by select()"
            )
        names.append(name)
    # Two recordings of one name must not share a row of a table.
    found: list[str] = []
    for number, name in enumerate(names, start=1):
        free = (f"{name} ({other})" for other in count_from(number))
        found.append(name if name not in found else next(one for one in free if one not in names))
    return tuple(found)


def check_counts(**counts: Any) -> None:
    """What is counted must be a whole number above 0.

    **Raises:** `MatchError` where it is not.
    """
    for name, count in counts.items():
        whole_number(name, count, 1, MatchError)
