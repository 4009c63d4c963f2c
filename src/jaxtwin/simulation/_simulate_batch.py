"""Many draws of a twin's parameters at once."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, overload

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from .._arguments import check_callable, mapping_of, whole_number
from .._errors import JaxtwinError, ParameterError, SimulationError
from .._executor import Executor, check_executor
from .._waiting import announced
from ..io import Experiment
from ..physics import Twin
from ..rig._problems import nearest
from ._draw_units import solve_draws
from ._draws import DrawSolver, Precision
from ._initial import Initial, checked_initial
from ._own_twin import FittedTwins, own_twin
from ._reductions import AskedReductions, Reductions, checked_reductions
from ._refinement import Results, solve_refined
from ._simulate import checked_channels, chosen_method

if TYPE_CHECKING:
    import diffrax


@overload
def simulate_batch(
    twin: Twin | FittedTwins,
    experiment: Experiment,
    parameters: Mapping[str, ArrayLike],
    *,
    reductions: None = None,
    initial: Initial = None,
    precision: Precision = "float64",
    solver: "diffrax.AbstractSolver | None" = None,
    stepsize_controller: "diffrax.AbstractStepSizeController | None" = None,
    dt0: float | None = None,
    adjoint: "diffrax.AbstractAdjoint | None" = None,
    chunk_size: int | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Float[np.ndarray, "draws times channels"]: ...


@overload
def simulate_batch(
    twin: Twin | FittedTwins,
    experiment: Experiment,
    parameters: Mapping[str, ArrayLike],
    *,
    reductions: AskedReductions,
    initial: Initial = None,
    precision: Precision = "float64",
    solver: "diffrax.AbstractSolver | None" = None,
    stepsize_controller: "diffrax.AbstractStepSizeController | None" = None,
    dt0: float | None = None,
    adjoint: "diffrax.AbstractAdjoint | None" = None,
    chunk_size: int | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Reductions: ...


@announced("simulation of many draws")
def simulate_batch(
    twin: Twin | FittedTwins,
    experiment: Experiment,
    parameters: Mapping[str, ArrayLike],
    *,
    reductions: AskedReductions | None = None,
    initial: Initial = None,
    precision: Precision = "float64",
    solver: "diffrax.AbstractSolver | None" = None,
    stepsize_controller: "diffrax.AbstractStepSizeController | None" = None,
    dt0: float | None = None,
    adjoint: "diffrax.AbstractAdjoint | None" = None,
    chunk_size: int | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Float[np.ndarray, "draws times channels"] | Reductions:
    """Runs a twin through an experiment for many draws of its parameters.

    Draws are worked on in chunks by all cores, or by the accelerator where JAX has one. A draw that
    fails (a negative resistance, an overflow) becomes NaN and leaves the others alone. The error of
    each draw is estimated as in `simulate`, and the draws that need shorter steps, or a stiff
    solver, are solved again together.

    **Arguments:**

    - `twin`: what is not drawn keeps its values; those of a fit are the experiment's own, see
      `Fit.twin_for`.
    - `experiment`: the inputs; with recorded temperatures where the cost is asked for.
    - `parameters`: name -> draws `(draws,)` in the unit of the rig's table.
    - `reductions`: what to keep instead of the trajectories, computed where the draws are: some of
      "cost", "final", "minimum", "maximum", "plate_range", "plate_std", "energy", "peak_power"
      (see `Reductions`), or a mapping from names to pure JAX functions of a trajectory
      `(times, channels)` in degC, such as `{"hottest": lambda trajectory: trajectory.max()}`. Such
      a mapping may hold `"cost": "cost"` and the like beside them. Each function is compiled once:
      define it outside of loops.
    - `initial`: as in `simulate`.
    - `precision`: of the default solver. Deviations from ambient keep float32 to about a
      millikelvin.
    - `solver`, `stepsize_controller`, `dt0`: as in `simulate`. `diffrax.diffeqsolve` runs under
      `jax.vmap`: the draws of a chunk take steps until the last of them is at its end.
    - `adjoint`: of that solve, None for `diffrax.ForwardMode()`. No derivatives are taken here (see
      `response`), but it decides which loop diffrax runs.
    - `chunk_size`: draws at a time, by default by the kind of device.
    - `workers`: threads that work on chunks, by default one a core on a CPU. The implicit solvers
      of diffrax have one there, whatever is said. Beside an executor: of each of its workers, by
      default one.
    - `executor`: who works on the draws instead of this process, some thousands at a time: any
      `concurrent.futures.Executor` whose workers can import jaxtwin, such as a
      `ProcessPoolExecutor` (by spawn) or `Client(...).get_executor()` of Dask. Results are the same
      to the last bit on machines of the same kind. What is lost with a worker is done by another.
    - `on_progress`: called with the number of draws in each chunk when it is done for the first
      time; draws that are solved again come after the last call.

    **Returns:** temperatures `(draws, times, channels)`, degC, for the channels that the experiment
    names, else all; or `Reductions`.

    **Raises:** `ParameterError` for unknown names, draws that are not one row of finite numbers or
    not equally many, or none, or a twin with several values of another parameter;
    `SimulationError` where experiment and rig do not belong together, the cost is asked for
    without recorded temperatures, an option has no meaning, or an executor fails.
    """
    method = chosen_method(solver, stepsize_controller, dt0, adjoint)
    twin = own_twin(twin, experiment)
    names = checked_channels(twin, experiment)
    start = checked_initial(twin, initial)
    draws = _checked_draws(twin, parameters)
    wanted = None if reductions is None else checked_reductions(reductions, [experiment])
    for name, number in (("chunk_size", chunk_size), ("workers", workers)):
        if number is not None:
            whole_number(name, number, 1, SimulationError)
    check_callable("on_progress", on_progress, SimulationError)
    check_executor("simulate_batch: executor", executor, SimulationError)
    if checked_precision(precision) == "float32" and method is not None:
        raise SimulationError(
            'precision: expected "float64" beside a solver, got "float32"; only the default '
            "solver computes in float32"
        )
    batch = DrawSolver(
        twin=twin,
        experiment=experiment,
        initial=start,
        columns=np.array([twin.channels.index(name) for name in names]),
        reductions=wanted,
        precision=precision,
        chunk_size=chunk_size,
        workers=workers,
    )

    def some(chosen: Int[np.ndarray, " some"]) -> dict[str, Float[np.ndarray, " some"]]:
        return {name: values[chosen] for name, values in draws.items()}

    def solve(chosen: Int[np.ndarray, " some"], refinement: int) -> Results:
        report = None if refinement else on_progress
        return solve_draws(batch, some(chosen), refinement, executor, report)

    def rescue(chosen: Int[np.ndarray, " some"]) -> Results:
        from ._diffeqsolve import stiff_method

        return solve_draws(batch, some(chosen), stiff_method(experiment), executor)

    if method is None:
        results = solve_refined(len(next(iter(draws.values()))), solve, rescue)
    else:
        results = solve_draws(batch, draws, method, executor, on_progress)
    return results["temperatures"] if wanted is None else Reductions.of(names, results)


def _checked_draws(twin: Twin, parameters: Mapping[str, ArrayLike]) -> dict[str, np.ndarray]:
    rig = twin.rig
    mapping_of(f"{rig.name}: parameters", parameters, "name -> draws", ParameterError)
    if not len(parameters):
        raise ParameterError(f"{rig.name}: parameters: expected name -> draws, got none")
    draws: dict[str, np.ndarray] = {}
    held = [name for name in rig.parameters if name not in parameters]
    several = [name for name in held if np.ndim(twin.parameters[name])]
    if several:
        raise ParameterError(
            f"{rig.name}: parameter {several[0]}: expected one value in the twin, as it is not "
            "drawn, got several"
        )
    for name, values in parameters.items():
        if name not in rig.parameters:
            raise ParameterError(
                f"{rig.name}: expected some of the parameters {', '.join(rig.parameters)}, got "
                f"{name!r}{nearest([name], rig.parameters)}"
            )
        try:
            array = np.asarray(values)
            if array.dtype.kind in "bcSU":  # conversion would take them, and say nothing
                raise TypeError
            array = array.astype(float)
        except (TypeError, ValueError):
            raise ParameterError(
                f"{rig.name}: parameter {name}: expected numbers, got {values!r}"
            ) from None
        if array.ndim != 1 or array.size == 0:
            raise ParameterError(
                f"{rig.name}: parameter {name}: expected draws of shape (draws,), at least one, "
                f"got shape {array.shape}"
            )
        if not np.isfinite(array).all():
            raise ParameterError(
                f"{rig.name}: parameter {name}: expected finite numbers, got "
                f"{array[~np.isfinite(array)][0]} at draw "
                f"{int(np.flatnonzero(~np.isfinite(array))[0])}"
            )
        draws[name] = array
    lengths = {name: len(array) for name, array in draws.items()}
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ParameterError(
            f"{rig.name}: parameters: expected the same number of draws for each, got {found}"
        )
    return draws


def checked_precision(
    precision: Precision, error: type[JaxtwinError] = SimulationError
) -> Precision:
    """The precision that was given, where it is a known one.

    **Raises:** `error` where it is none.
    """
    if not (isinstance(precision, str) and precision in ("float64", "float32")):
        raise error(f'precision: expected "float64" or "float32", got {precision!r}')
    return precision
