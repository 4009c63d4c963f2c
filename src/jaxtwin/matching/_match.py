"""Behavioural matching: a twin's parameters from recordings, step 4 of the paper."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._errors import MatchError
from ..io import Experiment
from ..physics import Twin
from ..simulation import checked_channels, simulate
from ._fit import Fit, FittedParameter, Iteration, Optimum
from ._levenberg_marquardt import RUNNING, STATUS, BoundedLevenbergMarquardt, LMState
from ._residuals import Problem, build_problem, residuals
from ._unknowns import Unknowns, choose_unknowns, is_logarithmic


def match(
    twin: Twin,
    experiments: Experiment | Sequence[Experiment],
    *,
    free: Iterable[str] | None = None,
    fixed: Iterable[str] = (),
    shared: Iterable[str] = (),
    per_recording: Iterable[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    starts: int = 1,
    seed: int = 0,
    max_iterations: int = 200,
    solver: BoundedLevenbergMarquardt | None = None,
    on_iteration: Callable[[Iteration], None] | None = None,
) -> Fit:
    """Matches a twin to recordings by nonlinear least squares, eq. (11) of the paper, in float64.

    All recordings count together. Positive parameters are matched by their logarithm, inside
    their bounds, with exact derivatives through the simulation.

    **Arguments:**

    - `twin`: where the match starts, and what the parameters that are held stay at.
    - `experiments`: recordings of this rig, one or several.
    - `free`: names of the parameters to match, instead of those that the rig's table calls free.
    - `fixed`: names to hold.
    - `shared`, `per_recording`: names whose scope differs from the table's: one value for all
      recordings, or one for each (ambient and start temperature, typically).
    - `bounds`: other bounds, name -> (lower, upper) in the parameter's unit.
    - `starts`: how many starting points; the first is the twin, the others vary each positive
      parameter by a factor of about e and each other one by a tenth of its range, inside bounds.
    - `seed`: of the other starts.
    - `max_iterations`: of each start.
    - `solver`: tolerances; see `BoundedLevenbergMarquardt`.
    - `on_iteration`: called after each iteration, to show progress.

    **Returns:** a `Fit`, the best of all starts.

    **Raises:** `MatchError` where nothing is free, a recording has no temperatures, there are fewer
    samples than unknowns, bounds exclude the start, or no start gives finite temperatures;
    `ParameterError` for unknown names; `SimulationError` for recordings of another rig.
    """
    began = time.perf_counter()
    recordings = [experiments] if isinstance(experiments, Experiment) else list(experiments)
    names = _checked_recordings(twin, recordings)
    unknowns = choose_unknowns(
        twin,
        len(recordings),
        free=free,
        fixed=fixed,
        shared=shared,
        per_recording=per_recording,
        bounds=bounds,
    )
    samples = sum(len(one.time) * len(one.channels) for one in recordings)
    if samples < unknowns.size:
        raise MatchError(
            f"found {samples} samples for {unknowns.size} unknowns, allowed is at least as many"
        )
    _checked_counts(starts=starts, max_iterations=max_iterations)
    problem = build_problem(twin, recordings, unknowns.layout)
    solver = solver or BoundedLevenbergMarquardt(rtol=1e-7)
    with jax.enable_x64(True):
        attempts = [
            _descend(
                solver,
                problem,
                unknowns,
                vector,
                number,
                max_iterations,
                samples,
                names,
                on_iteration,
            )
            for number, vector in enumerate(_starts(unknowns, starts, seed))
        ]
    finite = [attempt for attempt in attempts if np.isfinite(float(attempt[1].cost))]
    if not finite:
        raise MatchError(
            f"{twin.rig.name}: the start gives no finite temperatures; start from other values"
        )
    best = min(finite, key=lambda attempt: float(attempt[1].cost))
    vector, state, history = best
    own, values = _values(unknowns, vector, names)
    fitted = twin.with_parameters(values[0])
    runs = {
        name: simulate(twin.with_parameters(value), experiment)
        for name, value, experiment in zip(names, values, recordings, strict=True)
    }
    fits = {
        (name, channel): value
        for name, run in runs.items()
        for channel, value in run.fit_percent.items()
    }
    return Fit(
        twin=fitted,
        recordings=names,
        experiments=tuple(recordings),
        parameters=_table(twin, unknowns, vector, state, samples),
        recording_values=own,
        fit_percent=fits,
        rmse=float(np.sqrt(2 * float(state.cost) / samples)),
        status=STATUS[int(state.status)],
        converged=int(state.status) != RUNNING,
        history=history,
        optima=tuple(
            Optimum(
                start=attempt[2][0].start,
                rmse=float(np.sqrt(2 * float(attempt[1].cost) / samples)),
                iterations=len(attempt[2]) - 1,
                status=STATUS[int(attempt[1].status)],
                converged=int(attempt[1].status) != RUNNING,
                parameters=attempt[2][-1].parameters,
            )
            for attempt in sorted(finite, key=lambda attempt: float(attempt[1].cost))
        ),
        wall_time=time.perf_counter() - began,
        runs=runs,
    )


Attempt = tuple[Float[np.ndarray, " unknowns"], LMState, tuple[Iteration, ...]]


def _descend(
    solver: BoundedLevenbergMarquardt,
    problem: Problem,
    unknowns: Unknowns,
    start: Float[np.ndarray, " unknowns"],
    number: int,
    max_iterations: int,
    samples: int,
    names: tuple[str, ...],
    on_iteration: Callable[[Iteration], None] | None,
) -> Attempt:
    """Steps the optimiser from here, so that every iteration can be kept and shown."""
    options = {"lower": jnp.asarray(unknowns.lower()), "upper": jnp.asarray(unknowns.upper())}
    vector = jnp.asarray(start)
    state = solver.init(residuals, vector, problem, options, None, None, frozenset())
    history: list[Iteration] = []
    for iteration in range(max_iterations + 1):
        vector, state, _ = _step(solver, vector, problem, options, state)
        cost = float(state.cost) * 2 / samples
        history.append(
            Iteration(
                number=iteration,
                start=number,
                cost=cost,
                rmse=float(np.sqrt(cost)),
                gradient=float(state.gradient),
                accepted=bool(state.accepted),
                parameters=_labelled(unknowns, np.asarray(vector), names),
            )
        )
        if on_iteration is not None:
            on_iteration(history[-1])
        if int(state.status) != RUNNING or not np.isfinite(cost):
            break
    return np.asarray(vector), state, tuple(history)


@eqx.filter_jit
def _step(
    solver: BoundedLevenbergMarquardt,
    vector: Float[Array, " unknowns"],
    problem: Problem,
    options: dict[str, Float[Array, " unknowns"]],
    state: LMState,
) -> tuple[Float[Array, " unknowns"], LMState, None]:
    return solver.step(residuals, vector, problem, options, state, frozenset())


def _starts(unknowns: Unknowns, starts: int, seed: int) -> list[Float[np.ndarray, " unknowns"]]:
    first, lower, upper = unknowns.start(), unknowns.lower(), unknowns.upper()
    logarithmic = np.array([is_logarithmic(row) for row in unknowns.rows])
    with np.errstate(invalid="ignore"):
        range_ = np.where(np.isfinite(upper - lower), upper - lower, np.abs(first) + 1)
    spread = np.where(logarithmic, 1.0, 0.1 * range_)
    rng = np.random.default_rng(seed)
    vectors = [first]
    for _ in range(starts - 1):
        moved = first + spread * rng.standard_normal(first.size)
        vectors.append(np.clip(moved, lower, upper))
    return vectors


def _values(
    unknowns: Unknowns, vector: Float[np.ndarray, " unknowns"], names: tuple[str, ...]
) -> tuple[dict[str, dict[str, float]], list[dict[str, float]]]:
    """Recording -> its own values, and all matched values of each recording."""
    with jax.enable_x64(True):
        traced = unknowns.values(jnp.asarray(vector))
    clipped = {row.name: (row.lower, row.upper) for row in unknowns.rows}
    # A value at a bound has been through a logarithm; it must not come back from beyond.
    values = [
        {name: float(np.clip(float(value), *clipped[name])) for name, value in one.items()}
        for one in traced
    ]
    own_names = {row.name for row in unknowns.own}
    own = {
        name: {key: value for key, value in one.items() if key in own_names}
        for name, one in zip(names, values, strict=True)
    }
    return own, values


def _labelled(
    unknowns: Unknowns, vector: Float[np.ndarray, " unknowns"], names: tuple[str, ...]
) -> dict[str, float]:
    own, values = _values(unknowns, vector, names)
    labelled = {row.name: values[0][row.name] for row in unknowns.shared}
    for recording, one in own.items():
        labelled |= {f"{name}[{recording}]": value for name, value in one.items()}
    return labelled


def _table(
    twin: Twin,
    unknowns: Unknowns,
    vector: Float[np.ndarray, " unknowns"],
    state: LMState,
    samples: int,
) -> tuple[FittedParameter, ...]:
    errors = _standard_errors(unknowns, vector, state, samples)
    lower, upper = unknowns.lower(), unknowns.upper()
    with np.errstate(invalid="ignore"):
        touching = (vector <= lower + 1e-9) | (vector >= upper - 1e-9)
    published = twin.rig.parameter_sets.get("published", {})
    numbers: dict[str, list[int]] = {}
    for number, row in enumerate(unknowns.rows):
        numbers.setdefault(row.name, []).append(number)
    _, values = _values(unknowns, vector, tuple(str(n) for n in range(unknowns.recordings)))
    table = []
    for name, row in twin.rig.parameters.items():
        entries = numbers.get(name, [])
        matched = unknowns.rows[entries[0]] if entries else row
        initial = float(twin.parameters[name])
        table.append(
            FittedParameter(
                name=name,
                unit=row.unit,
                description=row.description,
                free=bool(entries),
                scope=matched.scope,
                initial=initial,
                value=float(np.mean([one[name] for one in values])) if entries else initial,
                published=published.get(name),
                lower=matched.lower,
                upper=matched.upper,
                at_bound=bool(np.any(touching[entries])),
                standard_error=float(np.max(errors[entries])) if entries else float("nan"),
            )
        )
    return tuple(table)


def _standard_errors(
    unknowns: Unknowns,
    vector: Float[np.ndarray, " unknowns"],
    state: LMState,
    samples: int,
) -> Float[np.ndarray, " unknowns"]:
    """From the Gauss-Newton Hessian over the unknowns inside their bounds, in physical units."""
    lower, upper = unknowns.lower(), unknowns.upper()
    inside = (vector > lower + 1e-9) & (vector < upper - 1e-9)
    triangle = np.asarray(state.triangle)[:, inside]
    lengths = np.linalg.norm(triangle, axis=0)
    told = lengths > 0
    variance = 2 * float(state.cost) / max(1, samples - int(inside.sum()))
    _, singular, directions = np.linalg.svd(triangle[:, told] / lengths[told], full_matrices=False)
    # A direction this flat is told by rounding alone.
    flat = singular <= 1e-10 * singular.max(initial=0.0)
    spread = np.where(flat, 0.0, 1 / np.where(flat, 1.0, singular))
    errors = np.full(int(inside.sum()), np.inf)
    scaled = np.sqrt(np.sum((directions.T * spread) ** 2, axis=1))
    lost = np.any(np.abs(directions[flat]) > 1e-3, axis=0)
    errors[told] = np.where(lost, np.inf, np.sqrt(variance) * scaled / lengths[told])
    full = np.full(unknowns.size, np.nan)
    full[inside] = errors
    # Delta method: the standard error of exp(u) is exp(u) times that of u.
    slopes = [
        np.exp(entry) if is_logarithmic(row) else 1.0
        for row, entry in zip(unknowns.rows, vector, strict=True)
    ]
    return full * np.array(slopes)


def _checked_recordings(twin: Twin, recordings: list[Experiment]) -> tuple[str, ...]:
    if not recordings:
        raise MatchError("experiments: found none, allowed is one or several recordings")
    names: list[str] = []
    for number, experiment in enumerate(recordings, start=1):
        name = experiment.name or f"recording {number}"
        if experiment.temperatures is None or not experiment.channels:
            raise MatchError(f"{name}: found no recorded temperatures, allowed is a recording")
        checked_channels(twin, experiment)
        # Two recordings of one name must not share a row of a table.
        names.append(name if name not in names else f"{name} ({number})")
    return tuple(names)


def _checked_counts(**counts: Any) -> None:
    for name, count in counts.items():
        if isinstance(count, bool) or not isinstance(count, int) or count < 1:
            raise MatchError(f"{name}: found {count!r}, allowed is a whole number above 0")
