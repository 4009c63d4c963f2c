"""Many draws of a twin's parameters at once."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._arguments import check_callable, mapping_of, names_of, whole_number
from .._display import html_table, picture
from .._errors import JaxtwinError, ParameterError, SimulationError
from .._jax_settings import own_settings
from ..io import Experiment
from ..physics import Twin
from ._chunk import (
    EXTREMES,
    UNIFORMITY,
    Prepared,
    Reduction,
    compressed_cost,
    compressed_errors,
    plate_chunk,
    sample_chunk,
    sample_cost,
    step_chunk,
)
from ._chunk_runner import ChunkRunner, Precision
from ._compressed import compress
from ._delay import delayed_schedule, has_own_delays
from ._initial import Initial, checked_initial
from ._own_twin import FittedTwins, own_twin
from ._padding import padded, padded_schedule
from ._schedule import REFINEMENTS, Schedule
from ._simulate import checked_channels, simulate
from ._solve import too_coarse

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

REDUCTIONS: tuple[Reduction, ...] = (
    "cost",
    "final",
    "minimum",
    "maximum",
    "spread",
    "deviation",
)


UNITS = {
    "cost": "K2",
    "final": "degC",
    "minimum": "degC",
    "maximum": "degC",
    "spread": "K",
    "deviation": "K",
}
"""Of each reduction."""


@final
@dataclass(frozen=True, repr=False, eq=False)
class Reductions:
    """What was asked of many draws instead of their trajectories; None where it was not.

    - `channels`: names.
    - `cost`: mean squared error against the recording, eq. (11), `(draws, channels)`, K^2.
    - `final`: temperature at the end, `(draws, channels)`, degC.
    - `minimum`, `maximum`: over time, `(draws, channels)`, degC.
    - `spread`: largest minus smallest plate element at the end, `(draws,)`, K.
    - `deviation`: standard deviation over the plate's elements at the end, `(draws,)`, K.
    - `failed`: draws with a resistance, a capacitance, or a driver's lag or delay that is not above
      0, whose rates are further apart than float64 can tell, or whose temperatures do not stay
      finite, `(draws,)`; their other entries are NaN.
    """

    channels: tuple[str, ...]
    failed: np.ndarray
    cost: Float[np.ndarray, "draws channels"] | None = None
    final: Float[np.ndarray, "draws channels"] | None = None
    minimum: Float[np.ndarray, "draws channels"] | None = None
    maximum: Float[np.ndarray, "draws channels"] | None = None
    spread: Float[np.ndarray, " draws"] | None = None
    deviation: Float[np.ndarray, " draws"] | None = None

    def plot(self) -> "Figure":
        """How each quantity is distributed over the draws: `jaxtwin.plots.plot_distributions`."""
        return picture("plot_distributions", self.to_xarray())

    def to_xarray(self) -> "xarray.Dataset":
        """What was asked for with labels: failed (draw), and the others (draw, channel) or
        (draw)."""
        import xarray

        kept = {name: values for name in UNITS if (values := getattr(self, name)) is not None}
        dims = ("draw", "channel")
        return xarray.Dataset(
            {name: (dims[: v.ndim], v, {"units": UNITS[name]}) for name, v in kept.items()}
            | {"failed": ("draw", self.failed)},
            coords={"draw": np.arange(len(self.failed)), "channel": list(self.channels)},
        )

    def to_dataframe(self) -> "pandas.DataFrame":
        """A row for each draw and channel, its index, and a column for each quantity; those of the
        plate stand in each row of their draw."""
        return self.to_xarray().to_dataframe().rename_axis(["draw", "channel"])

    def __repr__(self) -> str:
        kept = ", ".join(name for name in UNITS if getattr(self, name) is not None) or "nothing"
        failed = int(np.count_nonzero(self.failed))
        return f"<Reductions of {len(self.failed)} draws: {kept}; {failed} failed>"

    def _repr_html_(self) -> str:
        rows = []
        for name, values in self.to_xarray().data_vars.items():
            if name != "failed" and np.isfinite(values).any():
                middle = np.nanquantile(values, (0.05, 0.5, 0.95))
                unit = str(values.attrs["units"])
                rows.append((str(name), *(f"{value:.4g}" for value in middle), unit))
        return html_table(repr(self), ("", "5 %", "median", "95 %", "unit"), rows)

    @property
    def rmse(self) -> Float[np.ndarray, " draws"]:
        """Over all channels, K.

        **Raises:** `SimulationError` where the cost was not asked for.
        """
        if self.cost is None:
            raise SimulationError('rmse: ask simulate_batch for reductions=["cost"]')
        return np.sqrt(self.cost.mean(axis=1))


@overload
def simulate_batch(
    twin: Twin | FittedTwins,
    experiment: Experiment,
    parameters: Mapping[str, Any],
    *,
    reductions: None = None,
    initial: Initial = None,
    precision: Precision = "float64",
    chunk_size: int | None = None,
    workers: int | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Float[np.ndarray, "draws times channels"]: ...


@overload
def simulate_batch(
    twin: Twin | FittedTwins,
    experiment: Experiment,
    parameters: Mapping[str, Any],
    *,
    reductions: Iterable[Reduction],
    initial: Initial = None,
    precision: Precision = "float64",
    chunk_size: int | None = None,
    workers: int | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Reductions: ...


def simulate_batch(
    twin: Twin | FittedTwins,
    experiment: Experiment,
    parameters: Mapping[str, Any],
    *,
    reductions: Iterable[Reduction] | None = None,
    initial: Initial = None,
    precision: Precision = "float64",
    chunk_size: int | None = None,
    workers: int | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> Float[np.ndarray, "draws times channels"] | Reductions:
    """Runs a twin through an experiment for many draws of its parameters.

    Draws are worked on in chunks by all cores, or by the accelerator where JAX has one. A draw that
    fails (a negative resistance, an overflow) becomes NaN and leaves the others alone. Each draw's
    error is looked at as `simulate` does, and draws that need shorter steps are solved again.

    **Arguments:**

    - `twin`: what is not drawn keeps its values; those of a fit are the experiment's own, see
      `Fit.twin_for`.
    - `experiment`: the inputs; with recorded temperatures where the cost is asked for.
    - `parameters`: name -> draws `(draws,)` in the unit of the rig's table.
    - `reductions`: some of "cost", "final", "minimum", "maximum", "spread", "deviation": computed
      where the draws are, so that no trajectory is kept. See `Reductions`.
    - `initial`: as in `simulate`.
    - `precision`: of the computation. Deviations from ambient keep float32 to about a millikelvin.
    - `chunk_size`: draws at a time, by default by the kind of device.
    - `workers`: threads that work on chunks, by default one a core on a CPU.
    - `on_progress`: called with the number of draws in each chunk when it is done for the first
      time; draws that are solved again come after the last call.

    **Returns:** temperatures `(draws, times, channels)`, degC, for the channels that the experiment
    names, else all; or `Reductions`.

    **Raises:** `ParameterError` for unknown names, draws that are not one row of finite numbers or
    not equally many, or none, or a twin with several values of another parameter;
    `SimulationError` where experiment and rig do not belong together, the cost is asked for
    without recorded temperatures, or an option has no meaning.
    """
    twin = own_twin(twin, experiment)
    names = checked_channels(twin, experiment)
    start = checked_initial(twin, initial)
    draws = _checked_draws(twin, parameters)
    wanted = None if reductions is None else checked_reductions(reductions, [experiment])
    for name, number in (("chunk_size", chunk_size), ("workers", workers)):
        if number is not None:
            whole_number(name, number, 1, SimulationError)
    check_callable("on_progress", on_progress, SimulationError)
    columns = np.array([twin.channels.index(name) for name in names])
    at_rest = isinstance(start, str)
    runner = ChunkRunner(twin, start, checked_precision(precision), chunk_size, workers)

    def solve(draws: dict[str, np.ndarray], refinement: int) -> dict[str, np.ndarray]:
        schedule = padded_schedule(twin, experiment, refinement)
        # All draws alike share how samples are read.
        own_delays = has_own_delays(twin, draws)
        seen = schedule if own_delays else _arriving_alike(twin, schedule, at_rest)
        reduce = _reducer(twin, seen, own_delays, experiment, columns, wanted, at_rest)
        return runner.run(draws, schedule, reduce, None if refinement else on_progress)

    result = solve(draws, 0)
    left = np.flatnonzero(too_coarse(result.pop("coupling"), result.pop("doubt"), 0))
    for refinement in range(1, REFINEMENTS + 1):
        if left.size == 0:
            break
        finer = solve({name: values[left] for name, values in draws.items()}, refinement)
        again = too_coarse(finer.pop("coupling"), finer.pop("doubt"), refinement)
        for name, values in finer.items():
            result[name][left] = values
        left = left[again]
    for draw in left:
        values = {name: float(array[draw]) for name, array in draws.items()}
        one = _solve_stiff(twin.with_parameters(values), experiment, initial, wanted)
        for name, value in one.items():
            result[name][draw] = value
    if wanted is None:
        return result["temperatures"]
    return Reductions(channels=names, **result)


def _arriving_alike(twin: Twin, schedule: Schedule, at_rest: bool) -> Schedule:
    """The schedule as it reaches the cells, behind the twin's own delay if it has one."""
    delay = twin.wiring.delay
    if delay is None:
        return schedule
    with own_settings():
        late = _delayed(schedule, delay(twin.parameters_si)[0], at_rest)
    return jax.tree.map(np.asarray, late)


_delayed = eqx.filter_jit(delayed_schedule)


def _reducer(
    twin: Twin,
    schedule: Schedule,
    own_delays: bool,
    experiment: Experiment,
    columns: Int[np.ndarray, " channels"],
    wanted: tuple[Reduction, ...] | None,
    at_rest: bool,
) -> Callable[[Prepared], dict[str, Array | np.ndarray]]:
    """What is computed of each chunk, from its draws to the results that are kept.

    **Arguments:**

    - `schedule`: as it reaches the cells, or as commanded where draws have their `own_delays`.
    """
    grid: dict[str, Any] = {"schedule": schedule, "at_rest": at_rest}
    of_plate = [name for name in wanted or () if name in UNIFORMITY]
    of_samples = [name for name in wanted or () if name in EXTREMES]
    recorded = experiment.temperatures
    with_cost = wanted is not None and "cost" in wanted
    compressed = None
    if with_cost and recorded is not None:
        # Only where the same weights serve all draws, and nothing but the steps moves the readings.
        drifts = twin.wiring.ambient_drift is not None
        if schedule.ambient_at is None and not own_delays and not drifts:
            compressed = compress(schedule, recorded)
        else:
            of_samples.append("cost")

    def reduce(prepared: Prepared) -> dict[str, Array | np.ndarray]:
        if not own_delays:
            prepared = eqx.tree_at(lambda p: p.systems.delay, prepared, None, is_leaf=_is_none)
        stepped = step_chunk(prepared, columns=columns, with_plate=bool(of_plate), **grid)
        # Neither shorter steps nor another solver help what is no resistance or capacity.
        physical = prepared.systems.physical
        result: dict[str, Array | np.ndarray] = {
            "coupling": jnp.where(physical, prepared.coupling, 0.0),
            "doubt": jnp.where(physical, stepped.channels.doubt, 0.0),
        }
        if wanted is None:
            temperatures = sample_chunk(prepared, stepped, columns=columns, **grid)
            # By NumPy, which compiles nothing for another number of samples.
            return result | {"temperatures": np.asarray(temperatures)[:, : len(experiment.time)]}
        result["failed"] = stepped.failed
        if compressed is not None:
            errors = compressed_errors(prepared, stepped, compressed, columns)
            result["cost"] = compressed_cost(errors, compressed)
        if "final" in wanted and not of_samples:
            last = sample_chunk(prepared, stepped, columns=columns, last=True, **grid)
            result["final"] = last[:, 0]
        if of_samples:
            temperatures = sample_chunk(prepared, stepped, columns=columns, **grid)
            if "final" in wanted:
                result["final"] = temperatures[:, -1]
            for name in of_samples:
                if name == "cost":
                    assert recorded is not None
                    result[name] = sample_cost(temperatures, padded(recorded, np.nan))
                else:
                    result[name] = EXTREMES[name](temperatures)
        if of_plate:
            elements = plate_chunk(prepared, stepped, **grid)
            result |= {name: UNIFORMITY[name](elements) for name in of_plate}
        return result

    return reduce


def _is_none(leaf: Any) -> bool:
    return leaf is None


def _solve_stiff(
    twin: Twin,
    experiment: Experiment,
    initial: Initial,
    wanted: tuple[Reduction, ...] | None,
) -> dict[str, Any]:
    """One draw as `simulate` solves it, by a stiff solver, reduced as the others."""
    try:
        run = simulate(twin, experiment, initial=initial)
    except JaxtwinError:
        # What the steps gave was not trusted.
        if wanted is None:
            return {"temperatures": np.nan}
        return {"failed": True, **dict.fromkeys(wanted, np.nan)}
    if wanted is None:
        return {"temperatures": run.temperatures}
    # The compiled reductions, on a chunk of one.
    recorded = experiment.temperatures
    reduced: dict[str, Any] = {}
    with own_settings():
        temperatures = jnp.asarray(run.temperatures)[None]
        elements = jnp.asarray(run.states)[None, -1, : len(twin.wiring.rig_elements)]
        for name in wanted:
            if name == "cost":
                assert recorded is not None
                reduced[name] = sample_cost(temperatures, recorded)[0]
            elif name == "final":
                reduced[name] = temperatures[0, -1]
            elif name in EXTREMES:
                reduced[name] = EXTREMES[name](temperatures)[0]
            else:
                reduced[name] = UNIFORMITY[name](elements)[0]
    return {"failed": False, **reduced}


def _checked_draws(twin: Twin, parameters: Mapping[str, Any]) -> dict[str, np.ndarray]:
    rig = twin.rig
    mapping_of(f"{rig.name}: parameters", parameters, "name -> draws", ParameterError)
    if not len(parameters):
        raise ParameterError(f"{rig.name}: parameters: found none, allowed is name -> draws")
    draws: dict[str, np.ndarray] = {}
    held = [name for name in rig.parameters if name not in parameters]
    several = [name for name in held if np.ndim(twin.parameters[name])]
    if several:
        raise ParameterError(
            f"{rig.name}: parameter {several[0]}: found several values in the twin, allowed is one "
            "where it is not drawn"
        )
    for name, values in parameters.items():
        if name not in rig.parameters:
            raise ParameterError(
                f"{rig.name}: unknown parameter {name!r}, allowed are {', '.join(rig.parameters)}"
            )
        try:
            array = np.asarray(values)
            if array.dtype.kind in "bcSU":  # conversion would take them, and say nothing
                raise TypeError
            array = array.astype(float)
        except (TypeError, ValueError):
            raise ParameterError(
                f"{rig.name}: parameter {name}: found {values!r}, allowed are numbers"
            ) from None
        if array.ndim != 1 or array.size == 0:
            raise ParameterError(
                f"{rig.name}: parameter {name}: found draws of shape {array.shape}, allowed is one "
                "row of at least one draw"
            )
        if not np.isfinite(array).all():
            raise ParameterError(
                f"{rig.name}: parameter {name}: found {array[~np.isfinite(array)][0]} at draw "
                f"{int(np.flatnonzero(~np.isfinite(array))[0])}, allowed are finite numbers"
            )
        draws[name] = array
    lengths = {name: len(array) for name, array in draws.items()}
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise ParameterError(
            f"{rig.name}: parameters: found unequal numbers of draws ({found}), allowed is the "
            "same number for each"
        )
    return draws


def checked_precision(precision: Precision) -> Precision:
    """**Raises:** `SimulationError` where it is none."""
    if not (isinstance(precision, str) and precision in ("float64", "float32")):
        raise SimulationError(f'precision: found {precision!r}, allowed is "float64" or "float32"')
    return precision


def checked_reductions(
    reductions: Iterable[str], experiments: Iterable[Experiment]
) -> tuple[Reduction, ...]:
    """The reductions that are asked of some experiments.

    **Raises:** `SimulationError` for unknown names, none, or the cost where nothing is recorded, or
    nothing in one of the channels.
    """
    wanted, experiments = names_of("reductions", reductions, SimulationError), list(experiments)
    unknown = [name for name in wanted if name not in REDUCTIONS]
    if unknown or not wanted:
        raise SimulationError(
            f"reductions: found {', '.join(unknown) or 'none'}, allowed are {', '.join(REDUCTIONS)}"
        )
    if "cost" in wanted and any(one.temperatures is None for one in experiments):
        raise SimulationError(
            'reductions: found "cost", allowed only for experiments with recorded temperatures'
        )
    for one in experiments:
        if "cost" in wanted and (bare := one.unsampled):
            raise SimulationError(
                f'reductions: found "cost" for {one.name or "an experiment"}, whose channel '
                f"{bare[0]} has no sample, allowed are channels with one; leave it out by select()"
            )
    return tuple(name for name in REDUCTIONS if name in wanted)
