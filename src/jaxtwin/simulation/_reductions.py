"""Reductions: the numbers that are kept of many draws instead of their trajectories.

Each reduction is a pure JAX function of the readings of one draw. Draws of the default solver,
draws of a diffrax solver and sweeps use the same table.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

from .._arguments import names_of
from .._compilation import persistent_jit
from .._display import picture
from .._name_suggestions import did_you_mean
from .._result import AbstractResult, dataset, table
from ..errors import SimulationError
from ..io import Experiment
from ..rig import Rig, check_has_plate

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

ReductionName: TypeAlias = Literal[
    "cost", "final", "minimum", "maximum", "plate_range", "plate_std", "energy", "peak_power"
]
"""The name of a reduction of `reduce_batch`; `Reductions` explains each."""

# A reduction by the user: a pure JAX function of the trajectory of one draw, degC.
ReductionFunction: TypeAlias = Callable[[Float[Array, "times channels"]], Shaped[Array, "..."]]

# Names of reductions; or a mapping from the name of a result to a reduction or a function.
ReductionChoice: TypeAlias = (
    Iterable[ReductionName] | Mapping[str, ReductionName | ReductionFunction]
)


@final
@dataclass(frozen=True)
class Reduction:
    """A function of the readings of a draw, and a description of its result.

    **Arguments:**

    - `reads`: the field of `BatchReadings` that the function takes.
    - `function`: a JAX function of that field for one draw. If it `needs_recording`, its second
      argument is the recorded temperatures.
    - `dimension`: the dimension of the result: "channel", or "recording" for a single number.
    - `unit`: the unit of the result.
    """

    reads: Literal["trajectory", "padded_trajectory", "end", "plate_end", "energy", "peak_power"]
    function: Callable[..., Array]
    dimension: Literal["channel", "recording", "unknown"] = "unknown"
    unit: str = ""
    needs_recording: bool = False


class BatchReadings(NamedTuple):
    """The readings of a chunk of draws from which reductions are computed; None for a field that no
    reduction needs.

    - `trajectory`: the temperatures of the channels at the samples, degC.
    - `padded_trajectory`: the trajectory with copies of its last sample appended, so that
      recordings of different lengths share compiled programs.
    - `end`: the temperatures of the channels at the last sample, degC.
    - `plate_end`: the temperatures of the plate's elements at the last sample, K, from an arbitrary
      zero.
    - `energy`, `peak_power`: the energy and the largest power that all cells together draw from the
      supply, J and W.
    """

    trajectory: Float[Array | np.ndarray, "draws times channels"] | None = None
    padded_trajectory: Float[Array | np.ndarray, "draws filled channels"] | None = None
    end: Float[Array | np.ndarray, "draws channels"] | None = None
    plate_end: Float[Array | np.ndarray, "draws elements"] | None = None
    energy: Float[Array | np.ndarray, " draws"] | None = None
    peak_power: Float[Array | np.ndarray, " draws"] | None = None


def mean_squared_error(
    trajectory: Float[Array, "times channels"],
    recorded: Float[Array | np.ndarray, "times channels"],
) -> Float[Array, " channels"]:
    """Computes the mean squared error of each channel, eq. (11) of the paper, K^2. Missing samples
    are NaN in the recording and are left out."""
    target = jnp.asarray(recorded, trajectory.dtype)
    is_sampled = ~jnp.isnan(target)
    errors = jnp.where(is_sampled, trajectory - target, 0.0)
    return jnp.sum(errors**2, axis=0) / jnp.sum(is_sampled, axis=0)


def _as_read(values: Array) -> Array:
    return values


def _minimum(trajectory: Array) -> Array:
    return _unless_failed(trajectory, trajectory.min(axis=0))


def _maximum(trajectory: Array) -> Array:
    return _unless_failed(trajectory, trajectory.max(axis=0))


def _unless_failed(trajectory: Array, values: Array) -> Array:
    """NaN for the trajectory of a failed draw, of which XLA:CPU finds infinite extremes."""
    return jnp.where(jnp.isnan(trajectory[0]), jnp.nan, values)


def _range(temperatures: Array) -> Array:
    return temperatures.max() - temperatures.min()


def _std(temperatures: Array) -> Array:
    return temperatures.std()


REDUCTIONS: dict[ReductionName, Reduction] = {
    "cost": Reduction("padded_trajectory", mean_squared_error, "channel", "K^2", True),
    "final": Reduction("end", _as_read, "channel", "degC"),
    "minimum": Reduction("padded_trajectory", _minimum, "channel", "degC"),
    "maximum": Reduction("padded_trajectory", _maximum, "channel", "degC"),
    "plate_range": Reduction("plate_end", _range, "recording", "K"),
    "plate_std": Reduction("plate_end", _std, "recording", "K"),
    "energy": Reduction("energy", _as_read, "recording", "J"),
    "peak_power": Reduction("peak_power", _as_read, "recording", "W"),
}
"""Name -> reduction; `Reductions` explains each."""


@final
@dataclass(frozen=True, repr=False, eq=False)
class Reductions(AbstractResult):
    """The results of the reductions that were requested of many draws. A field that was not
    requested is None; `reductions["hottest"]` returns a result by its name.

    - `channels`: the names of the channels.
    - `failed`: whether the draw failed, `(draws,)`; its other entries are then NaN. A draw fails if
      a resistance, a heat capacity, or the driver's lag or delay is not above 0, if float64 cannot
      resolve its rates, or if its temperatures do not stay finite.
    - `cost`: the mean squared error against the recording, eq. (11) of the paper,
      `(draws, channels)`, K^2.
    - `final`: the temperature at the end, `(draws, channels)`, degC.
    - `minimum`, `maximum`: the extremes over time, `(draws, channels)`, degC.
    - `plate_range`: the difference between the hottest and the coldest element of the plate at the
      end, `(draws,)`, K.
    - `plate_std`: the standard deviation of the temperatures of the plate's elements at the end,
      `(draws,)`, K.
    - `energy`: the energy that all cells together draw from the supply, `(draws,)`, J. Draws in C
      are integrated over their steps. By JAX, temperatures are linear between samples, as for
      `Run.energy`; that of coarse samples may differ by a thousandth.
    - `peak_power`: the largest power that they draw together at any time, `(draws,)`, W.
    - `custom`: the results of the user's functions by name, `(draws, ...)`. A function receives a
      trajectory of NaN for a failed draw.
    - `custom_units`: the unit of a result in `custom`, by its name, where it is known: those of the
      measures of `simulate_closed_loops`.
    """

    channels: tuple[str, ...]
    failed: np.ndarray
    cost: Float[np.ndarray, "draws channels"] | None = None
    final: Float[np.ndarray, "draws channels"] | None = None
    minimum: Float[np.ndarray, "draws channels"] | None = None
    maximum: Float[np.ndarray, "draws channels"] | None = None
    plate_range: Float[np.ndarray, " draws"] | None = None
    plate_std: Float[np.ndarray, " draws"] | None = None
    energy: Float[np.ndarray, " draws"] | None = None
    peak_power: Float[np.ndarray, " draws"] | None = None
    custom: Mapping[str, Shaped[np.ndarray, "draws ..."]] = field(default_factory=dict)
    custom_units: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, channels: tuple[str, ...], results: Mapping[str, np.ndarray]) -> "Reductions":
        """Makes the result from the arrays of `reduce_readings`, with `failed` among them."""
        named = {name: values for name, values in results.items() if name in REDUCTIONS}
        custom = {name: v for name, v in results.items() if name not in {"failed", *REDUCTIONS}}
        return cls(channels, results["failed"], **named, custom=custom, custom_units={})

    def __getitem__(self, name: str) -> Shaped[np.ndarray, "draws ..."]:
        """The result of this name.

        **Raises:** `SimulationError` if it was not requested.
        """
        result = self.custom.get(name, getattr(self, name) if name in REDUCTIONS else None)
        if result is None:
            raise SimulationError(
                f"reductions: expected one of {', '.join(self)}, got {name!r}; ask reduce_batch "
                f"for it{did_you_mean([name], list(self))}"
            )
        return result

    def __iter__(self) -> Iterator[str]:
        """The names of the results."""
        return iter(
            [*(name for name in REDUCTIONS if getattr(self, name) is not None), *self.custom]
        )

    def plot(self) -> "Figure":
        """Plots the distribution of each result over the draws
        (`jaxtwin.plots.plot_distributions`)."""
        return picture("plot_distributions", self.to_xarray())

    def to_xarray(self) -> "xarray.Dataset":
        """Returns a labelled dataset: failed (draw), and each result (draw, channel) or (draw),
        with its unit in the attributes if it is known. The result of a user's function has the
        dimension draw and further dimensions with its name."""
        variables: dict[str, Any] = {"failed": ("draw", self.failed)}
        for name, reduction in REDUCTIONS.items():
            if (values := getattr(self, name)) is not None:
                dimensions = "draw channel" if values.ndim > 1 else "draw"
                variables[name] = (dimensions, values, reduction.unit)
        for name, values in self.custom.items():
            dimensions = " ".join(["draw", *(f"{name}_{axis}" for axis in range(1, values.ndim))])
            unit = [self.custom_units[name]] if name in self.custom_units else []
            variables[name] = (dimensions, values, *unit)
        return dataset(variables, {}, draw=np.arange(len(self.failed)), channel=self.channels)

    def to_dataframe(self) -> "pandas.DataFrame":
        """Returns a table with a row for each draw, and a column for each result: `energy`, or, for
        one with several values for each draw, `final[T11]`, `rise[0]`."""
        return draws_table(self.to_xarray())

    def __repr__(self) -> str:
        named = ", ".join(self) or "nothing"
        failed = int(np.count_nonzero(self.failed))
        return f"<Reductions of {len(self.failed)} draws: {named}; {failed} failed>"

    def _overview(self) -> "pandas.DataFrame":
        rows = []
        for name, values in self.to_xarray().data_vars.items():
            if name != "failed" and np.isfinite(values).any():
                # Between two infinite values, such as settling times, nothing can be interpolated.
                method = "nearest" if np.isinf(values).any() else "linear"
                quantiles = np.nanquantile(values, (0.05, 0.5, 0.95), method=method)
                rows.append((name, *quantiles, values.attrs.get("units", "")))
        return table(rows, columns=("", "5 %", "median", "95 %", "unit"))

    @property
    def rmse(self) -> Float[np.ndarray, " draws"]:
        """The root mean square error of each draw over all channels, K.

        **Raises:** `SimulationError` if the cost was not requested.
        """
        return np.sqrt(self["cost"].mean(axis=1))


def reduce_readings(
    reductions: Mapping[str, Reduction],
    readings: BatchReadings,
    recorded: Float[np.ndarray, "times channels"] | None,
) -> dict[str, Shaped[Array, "draws ..."]]:
    """Computes the results of a chunk of draws, by name.

    **Arguments:**

    - `reductions`: name of the result -> reduction.
    - `readings`: the readings; a field that a reduction reads must not be None.
    - `recorded`: the recorded temperatures at the samples of the padded trajectory, degC; None
      without a recording.
    """
    results = {}
    for name, reduction in reductions.items():
        values = getattr(readings, reduction.reads)
        more = (recorded,) if reduction.needs_recording else ()
        results[name] = _of_each_draw(reduction.function, values, *more)
    return results


@persistent_jit
def _of_each_draw(
    function: Callable[..., Array], values: Array, *more: Array | np.ndarray | None
) -> Array:
    return jax.vmap(lambda draw: jnp.asarray(function(draw, *more)))(values)


def checked_reductions(
    reductions: Iterable[str] | Mapping[str, str | ReductionFunction],
    experiments: Iterable[Experiment],
    rig: Rig,
) -> dict[str, Reduction]:
    """Returns the requested reductions by the names of their results.

    **Raises:** `SimulationError` for an unknown name, for no name at all, for a value that is not a
    function, for the cost if an experiment has no recorded temperatures, or none in one of its
    channels, and for those of the plate if the rig has none.
    """
    experiments = list(experiments)
    if isinstance(reductions, Mapping):
        wanted = {name: _checked_reduction(name, choice) for name, choice in reductions.items()}
    else:
        names = names_of("reductions", reductions, SimulationError)
        wanted = {name: _checked_reduction(name, name) for name in names}
    if not wanted:
        raise SimulationError(
            f"reductions: expected some of {', '.join(REDUCTIONS)}, or functions by name, got none"
        )
    for name, reduction in wanted.items():
        if reduction.reads == "plate_end":
            check_has_plate(f"reductions: {name}", rig, SimulationError)
    if any(reduction.needs_recording for reduction in wanted.values()):
        for experiment in experiments:
            _check_recorded(experiment)
    return wanted


def _checked_reduction(name: str, choice: str | ReductionFunction) -> Reduction:
    known = ", ".join(REDUCTIONS)
    if isinstance(choice, str):
        if choice not in REDUCTIONS or choice != name:
            raise SimulationError(
                f"reductions: expected some of {known}, got {choice}"
                f"{did_you_mean([choice], REDUCTIONS)}"
            )
        return REDUCTIONS[choice]
    if not callable(choice):
        raise SimulationError(
            f"reductions: {name}: expected one of {known}, or a JAX function of a trajectory "
            f"(times, channels), got {choice!r}"
        )
    if name in REDUCTIONS or name == "failed":
        raise SimulationError(
            f"reductions: expected another name for a function than {name!r}, which is the name of "
            "a known reduction; rename it"
        )
    return Reduction("trajectory", choice)


def _check_recorded(experiment: Experiment) -> None:
    if experiment.temperatures is None:
        raise SimulationError(
            'reductions: expected recorded temperatures for "cost", got none; use another reduction'
        )
    if unsampled := experiment.unsampled:
        raise SimulationError(
            'reductions: expected a sample in each channel for "cost", got none in channel '
            f"{unsampled[0]} of {experiment.name or 'an experiment'}; leave the channel out with "
            "Experiment.select"
        )


def draws_table(dataset: "xarray.Dataset") -> "pandas.DataFrame":
    """A dataset as a table with a row for each draw, in which nothing is repeated: a column for
    each variable, or for each of its values that one draw has, such as `cost[day 1, T11]`.
    Variables that all draws share, such as the units of parameters, are left out."""
    import pandas

    columns: dict[str, np.ndarray] = {}
    for name, values in dataset.data_vars.items():
        if "draw" not in values.dims:
            continue
        others = [dim for dim in values.dims if dim != "draw"]
        flat = values.transpose("draw", *others).values.reshape(values.sizes["draw"], -1)
        labels = itertools.product(*(values[dim].values.tolist() for dim in others))
        for label, column in zip(labels, flat.T, strict=True):
            columns[f"{name}[{', '.join(map(str, label))}]" if others else str(name)] = column
    return pandas.DataFrame(columns, index=pandas.Index(dataset["draw"].values, name="draw"))
