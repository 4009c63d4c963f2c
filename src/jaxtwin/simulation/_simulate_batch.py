"""Simulates many draws of a twin's parameters."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, TypedDict, Unpack, final

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from .._arguments import check_callable, mapping_of, whole_number
from .._executor import Executor, check_executor
from .._name_suggestions import did_you_mean
from .._progress import announced, counting
from .._result import dataset
from ..errors import JaxtwinError, ParameterError, SimulationError
from ..io import Experiment
from ..physics import Twin
from ._chunk_programs import Precision
from ._draw_solver import DrawSolver
from ._draw_units import solve_draws
from ._initial import Initial, checked_initial
from ._reductions import ReductionChoice, Reductions, checked_reductions
from ._refinement import Results, solve_refined
from ._simulate import FittedTwins, checked_channels, chosen_method, ordered, twin_of_experiment

if TYPE_CHECKING:
    import diffrax
    import xarray


class BatchLabels(NamedTuple):
    """What the temperatures of a batch belong to.

    - `draws`: parameter -> its draws. `units`: parameter -> its unit.
    - `time`: the times of the samples, s. `channels`: the names of the channels.
    - `rig`, `experiment`: their names.
    """

    draws: Mapping[str, Float[np.ndarray, " draws"]]
    units: Mapping[str, str]
    time: Float[np.ndarray, " times"]
    channels: tuple[str, ...]
    rig: str
    experiment: str


@final
class BatchTemperatures(np.ndarray):
    """Temperatures `(draws, times, channels)`, degC: an array with `to_xarray`. What is computed
    from it, and a part of it, is an array without labels."""

    labels: BatchLabels | None
    """What they belong to; None for a part or a result."""

    @classmethod
    def labelled(
        cls, temperatures: Float[np.ndarray, "draws times channels"], labels: BatchLabels
    ) -> "BatchTemperatures":
        """The same numbers, not copied, with labels."""
        result = temperatures.view(cls)
        result.labels = labels
        return result

    def __array_finalize__(self, obj: Any) -> None:
        self.labels = None

    def to_xarray(self) -> "xarray.Dataset":
        """Returns a labelled dataset: temperature (draw, time, channel), with the draws of each
        parameter as a coordinate (draw).

        **Raises:** `SimulationError` for a part of a batch: choose it in the dataset.
        """
        if self.labels is None:
            raise SimulationError(
                "to_xarray: expected the whole result of simulate_batch, got a part of it or what "
                "was computed from it; take the dataset first and choose there"
            )
        draws, units, time, channels, rig, experiment = self.labels
        return dataset(
            {
                "temperature": ("draw time channel", self, "degC"),
                "time": ("time", time, "s"),
                **{name: ("draw", values, units[name]) for name, values in draws.items()},
            },
            {"rig": rig, "experiment": experiment},
            draw=np.arange(len(self)),
            channel=channels,
        ).set_coords(draws)


# Draws that are solved again come in chunks at least as large as those of a 64th of all draws. Of
# thousands of draws a few then fill a whole chunk with copies, which costs some percent of the time
# at most, and share the compiled linear algebra of the first pass.
MIN_PART = 64


class BatchOptions(TypedDict, total=False):
    """The further keywords of `simulate_batch`, which `reduce_batch` takes too."""

    initial: Initial
    precision: Precision
    solver: "diffrax.AbstractSolver | None"
    stepsize_controller: "diffrax.AbstractStepSizeController | None"
    dt0: float | None
    adjoint: "diffrax.AbstractAdjoint | None"
    chunk_size: int | None
    workers: int | None
    executor: Executor | None
    on_progress: Callable[[int], None] | None


@announced("simulation of many draws")
def simulate_batch(
    twin: Twin | FittedTwins,
    experiment: Experiment,
    draws: Mapping[str, ArrayLike],
    *,
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
    out: Float[np.ndarray, "draws times channels"] | None = None,
) -> Float[np.ndarray, "draws times channels"]:
    """Runs a twin through an experiment for many draws of its parameters.

    The draws are solved in chunks by all cores, or by the accelerator if JAX has one. The result of
    a draw that fails (a negative resistance, an overflow) is NaN; the other draws are not affected.
    The error of each draw is estimated as in `simulate`, and the draws that need shorter steps, or
    a stiff solver, are solved again together.

    **Arguments:**

    - `twin`: the twin, whose other parameters keep their values; or a fit, which is run with the
      experiment's own values, see `Fit.twin_for`.
    - `experiment`: the inputs.
    - `draws`: parameter -> draws `(draws,)` in the unit of the rig's table.
    - `initial`: as in `simulate`.
    - `precision`: the precision of the default solver. float32 is accurate to about a millikelvin,
      because the solver computes deviations from ambient. Nonlinear losses of the plate are always
      computed in float32, with an error of a few microkelvins.
    - `solver`, `stepsize_controller`, `dt0`: as in `simulate`. `diffrax.diffeqsolve` runs under
      `jax.vmap`: the draws of a chunk take steps until the last of them is at its end.
    - `adjoint`: the adjoint of that diffrax solve, None for `diffrax.ForwardMode()`. This function
      computes no derivatives (see `response`), but the adjoint determines which loop diffrax runs.
    - `chunk_size`: the number of draws in a chunk; the default depends on the kind of device.
    - `workers`: the number of threads that solve chunks, by default one for each core of a CPU. The
      implicit solvers of diffrax always use one thread on a CPU. With an executor: the number of
      threads of each of its workers, by default one.
    - `executor`: an executor whose workers solve the draws instead of this process, some thousands
      at a time: any `concurrent.futures.Executor` whose workers can import jaxtwin, such as a
      `ProcessPoolExecutor` (by spawn) or `Client(...).get_executor()` of Dask. Results are the same
      to the last bit on machines of the same kind. The work of a worker that is lost is given to
      another.
    - `on_progress`: called with the number of draws in each chunk when it is solved for the first
      time. Draws that are solved again follow after the last call.
    - `out`: an array for the temperatures, in the precision of the call and contiguous, such as
      that of an earlier call: the system fills a new one with zeros first, page by page.

    **Returns:** temperatures `(draws, times, channels)`, degC, for the channels that the experiment
    names, else all: `out` if it is given, otherwise an array whose `to_xarray()` is a dataset with
    the draws of the parameters as coordinates. `reduce_batch` keeps less.

    **Raises:** `ParameterError` for unknown names, for draws that are missing, not one-dimensional,
    not finite or of different numbers, and for a twin with several values of another parameter;
    `SimulationError` if experiment and rig do not match, if an option is invalid, or if an executor
    fails.
    """
    channels, results = _solve_batch(
        twin,
        experiment,
        draws,
        None,
        out=out,
        initial=initial,
        precision=precision,
        solver=solver,
        stepsize_controller=stepsize_controller,
        dt0=dt0,
        adjoint=adjoint,
        chunk_size=chunk_size,
        workers=workers,
        executor=executor,
        on_progress=on_progress,
    )
    temperatures = results["temperatures"]
    if temperatures is out:
        return temperatures
    if out is not None:
        out[...] = temperatures
        return out
    rig = twin_of_experiment(twin, experiment).rig
    labels = BatchLabels(
        {name: np.array(values) for name, values in draws.items()},
        {name: rig.parameters[name].unit or "1" for name in draws},
        experiment.time,
        channels,
        rig.name,
        experiment.name,
    )
    return BatchTemperatures.labelled(temperatures, labels)


@announced("simulation of many draws")
def reduce_batch(
    twin: Twin | FittedTwins,
    experiment: Experiment,
    draws: Mapping[str, ArrayLike],
    reductions: ReductionChoice,
    **options: Unpack[BatchOptions],
) -> Reductions:
    """Runs a twin through an experiment for many draws of its parameters as `simulate_batch` does,
    and keeps some numbers of each draw instead of its trajectory.

    ```python
    drive = jt.Experiment.schedule("0:0.5", duration=600, cells=2)
    kept = jt.reduce_batch(jt.Twin("dual-cell"), drive, {"R_E": [1.9, 2.0]}, ["final", "energy"])
    kept.energy
    ```

    **Arguments:**

    - `twin`, `draws`: as in `simulate_batch`.
    - `experiment`: the inputs; with recorded temperatures for the reduction "cost".
    - `reductions`: what is computed of each draw: some of
      "cost", "final", "minimum", "maximum", "plate_range", "plate_std", "energy", "peak_power"
      (see `Reductions`), or a mapping from names to pure JAX functions of a trajectory
      `(times, channels)` in degC, such as `{"hottest": lambda trajectory: trajectory.max()}`. Such
      a mapping may hold `"cost": "cost"` and the like beside them. Each function is compiled once:
      define it outside of loops.
    - `options`: the further keywords of `simulate_batch`.

    **Returns:** the results, with the draws that failed.

    **Raises:** as `simulate_batch`, and `SimulationError` for an unknown reduction, or if the cost
    is requested without recorded temperatures.
    """
    return Reductions.of(*_solve_batch(twin, experiment, draws, reductions, **options))


def _solve_batch(
    twin: Twin | FittedTwins,
    experiment: Experiment,
    draws: Mapping[str, ArrayLike],
    reductions: ReductionChoice | None,
    *,
    out: Float[np.ndarray, "draws times channels"] | None = None,
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
) -> tuple[tuple[str, ...], Results]:
    """Returns the names of the channels, and the results of the reductions by name; the
    temperatures if there are none."""
    method = chosen_method(solver, stepsize_controller, dt0, adjoint)
    twin = twin_of_experiment(twin, experiment)
    experiment = ordered(experiment, twin)
    names = checked_channels(twin, experiment)
    start = checked_initial(twin, initial)
    arrays = checked_draws(twin, draws)
    wanted = None if reductions is None else checked_reductions(reductions, [experiment], twin.rig)
    for name, number in (("chunk_size", chunk_size), ("workers", workers)):
        if number is not None:
            whole_number(name, number, 1, SimulationError)
    check_callable("on_progress", on_progress, SimulationError)
    check_executor("executor", executor, SimulationError)
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
    total = len(next(iter(arrays.values())))
    if out is not None:
        _check_out(out, (total, len(experiment.time), len(names)), precision)
    # A caller that counts for itself reports the progress of a larger work.
    report = counting(total, None) if on_progress is None else on_progress

    def some(chosen: Int[np.ndarray, " some"]) -> dict[str, Float[np.ndarray, " some"]]:
        return {name: values[chosen] for name, values in arrays.items()}

    def solve(chosen: Int[np.ndarray, " some"], refinement: int) -> Results:
        first, into = (None, None) if refinement else (report, out)
        least = total // MIN_PART
        return solve_draws(batch, some(chosen), refinement, executor, first, least, into)

    def rescue(chosen: Int[np.ndarray, " some"]) -> Results:
        from ._diffeqsolve import stiff_method

        stiff = stiff_method(experiment, twin.rig.inputs)
        return solve_draws(batch, some(chosen), stiff, executor)

    if method is None:
        results = solve_refined(total, solve, rescue)
    else:
        results = solve_draws(batch, arrays, method, executor, report)
    return names, results


def checked_draws(
    twin: Twin, draws: Mapping[str, ArrayLike]
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Returns draws of parameters as arrays.

    **Raises:** `ParameterError` for an unknown name, for draws that are missing, not
    one-dimensional, not finite or of different numbers, and for a twin with several values of a
    parameter that is not drawn.
    """
    rig = twin.rig
    mapping_of(f"{rig.name}: draws", draws, "name -> draws", ParameterError)
    if not len(draws):
        raise ParameterError(f"{rig.name}: draws: expected name -> draws, got none")
    checked: dict[str, np.ndarray] = {}
    held = [name for name in rig.parameters if name not in draws]
    several = [name for name in held if np.ndim(twin.values[name])]
    if several:
        raise ParameterError(
            f"{rig.name}: parameter {several[0]}: expected one value in the twin, as it is not "
            "drawn, got several"
        )
    for name, values in draws.items():
        if name not in rig.parameters:
            raise ParameterError(
                f"{rig.name}: expected some of the parameters {', '.join(rig.parameters)}, got "
                f"{name!r}{did_you_mean([name], rig.parameters)}"
            )
        try:
            array = np.asarray(values)
            if array.dtype.kind in "bcSU":  # conversion would accept them without an error
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
        checked[name] = array
    lengths = {name: len(array) for name, array in checked.items()}
    if len(set(lengths.values())) > 1:
        result = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ParameterError(
            f"{rig.name}: draws: expected the same number of draws for each, got {result}"
        )
    return checked


def _check_out(out: np.ndarray, shape: tuple[int, ...], precision: Precision) -> None:
    """Checks the array of the caller.

    **Raises:** `SimulationError` if it cannot hold the temperatures.
    """
    is_array = isinstance(out, np.ndarray)
    if not is_array or out.shape != shape or out.dtype != precision:
        got = f"shape {out.shape}, {out.dtype}" if is_array else repr(type(out).__name__)
        raise SimulationError(
            f"out: expected an array of shape {shape} (draws, times, channels), {precision}, got "
            f"{got}"
        )
    if not (out.flags.c_contiguous and out.flags.writeable):
        raise SimulationError(
            "out: expected an array that is contiguous and can be written to, got one that is not; "
            f"numpy.empty({shape}) makes one"
        )


def checked_precision(
    precision: Precision, error: type[JaxtwinError] = SimulationError
) -> Precision:
    """Checks a precision.

    **Raises:** `error` if it is neither "float32" nor "float64".
    """
    if not (isinstance(precision, str) and precision in ("float64", "float32")):
        raise error(f'precision: expected "float64" or "float32", got {precision!r}')
    return precision
