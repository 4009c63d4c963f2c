"""What is kept of many draws instead of their trajectories.

Each reduction is a pure JAX function of what one draw gives. The same table serves draws that the
default solver ran, draws that a diffrax solver ran, and sweeps.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

from .._arguments import names_of
from .._compilation import persistent_jit
from .._display import html_table, picture
from .._errors import SimulationError
from ..io import Experiment
from ..rig._problems import nearest

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

ReductionName: TypeAlias = Literal[
    "cost", "final", "minimum", "maximum", "plate_range", "plate_std", "energy", "peak_power"
]
"""Of a reduction that `simulate_batch` knows; `Reductions` says what each is."""

ReductionFunction: TypeAlias = Callable[[Float[Array, "times channels"]], Shaped[Array, "..."]]
"""A user's own reduction: a pure JAX function of the temperatures of one draw's channels, degC."""

AskedReductions: TypeAlias = (
    Iterable[ReductionName] | Mapping[str, ReductionName | ReductionFunction]
)
"""Names of reductions, or name of the result -> a name of a reduction, or a function."""


@final
@dataclass(frozen=True)
class Reduction:
    """One reduction.

    **Arguments:**

    - `reads`: which of the `Readings` its function takes.
    - `function`: of the readings of one draw; with the recorded temperatures as its second argument
      where it `needs_recording`.
    - `dimension`: of its result: "channel", or "recording" for a single number.
    - `unit`: of its result.
    """

    reads: Literal["trajectory", "padded_trajectory", "end", "plate_end", "energy", "peak_power"]
    function: Callable[..., Array]
    dimension: Literal["channel", "recording", "unknown"] = "unknown"
    unit: str = ""
    needs_recording: bool = False


class Readings(NamedTuple):
    """What reductions read of a chunk of draws; None for what none of them needs.

    - `trajectory`: temperatures of the channels at the samples, degC.
    - `padded_trajectory`: the same with samples added that repeat the last one, so that recordings
      share compiled code.
    - `end`: temperatures of the channels at the last sample, degC.
    - `plate_end`: temperatures of the plate's elements at the last sample, from any zero, K.
    - `energy`, `peak_power`: what the cells together draw from the supply, J and W.
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
    """The cost of each channel over its samples that are not missing (NaN), eq. (11), K^2."""
    target = jnp.asarray(recorded, trajectory.dtype)
    is_sampled = ~jnp.isnan(target)
    errors = jnp.where(is_sampled, trajectory - target, 0.0)
    return jnp.sum(errors**2, axis=0) / jnp.sum(is_sampled, axis=0)


def _as_read(values: Array) -> Array:
    return values


def _minimum(trajectory: Array) -> Array:
    return trajectory.min(axis=0)


def _maximum(trajectory: Array) -> Array:
    return trajectory.max(axis=0)


def _range(temperatures: Array) -> Array:
    return temperatures.max() - temperatures.min()


def _std(temperatures: Array) -> Array:
    return temperatures.std()


REDUCTIONS: dict[ReductionName, Reduction] = {
    "cost": Reduction("padded_trajectory", mean_squared_error, "channel", "K2", True),
    "final": Reduction("end", _as_read, "channel", "degC"),
    "minimum": Reduction("padded_trajectory", _minimum, "channel", "degC"),
    "maximum": Reduction("padded_trajectory", _maximum, "channel", "degC"),
    "plate_range": Reduction("plate_end", _range, "recording", "K"),
    "plate_std": Reduction("plate_end", _std, "recording", "K"),
    "energy": Reduction("energy", _as_read, "recording", "J"),
    "peak_power": Reduction("peak_power", _as_read, "recording", "W"),
}
"""The reductions that have a name; see `Reductions`."""


@final
@dataclass(frozen=True, repr=False, eq=False)
class Reductions:
    """What was asked of many draws instead of their trajectories; None where it was not.

    `reductions["hottest"]` is the result of that name.

    - `channels`: names.
    - `failed`: draws with a resistance, a capacitance, or a driver's lag or delay that is not above
      0, whose rates are further apart than float64 can tell, or whose temperatures do not stay
      finite, `(draws,)`; their other entries are NaN.
    - `cost`: mean squared error against the recording, eq. (11), `(draws, channels)`, K^2.
    - `final`: temperature at the end, `(draws, channels)`, degC.
    - `minimum`, `maximum`: over time, `(draws, channels)`, degC.
    - `plate_range`: largest minus smallest temperature of the plate's elements at the end,
      `(draws,)`, K.
    - `plate_std`: standard deviation of the temperatures of the plate's elements at the end,
      `(draws,)`, K.
    - `energy`: drawn from the supply by all cells together, `(draws,)`, J.
    - `peak_power`: the largest power that they draw together at any time, `(draws,)`, W.
    - `own`: results of a user's own functions by name, `(draws, ...)`; those of failed draws are
      what the function makes of a trajectory of NaN.
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
    own: Mapping[str, Shaped[np.ndarray, "draws ..."]] = field(default_factory=dict)

    @classmethod
    def of(cls, channels: tuple[str, ...], results: Mapping[str, np.ndarray]) -> "Reductions":
        """From what `reduce_readings` gave for all draws, and which of them `failed`."""
        named = {name: values for name, values in results.items() if name in REDUCTIONS}
        own = {name: v for name, v in results.items() if name not in {"failed", *REDUCTIONS}}
        return cls(channels, results["failed"], **named, own=own)

    def __getitem__(self, name: str) -> Shaped[np.ndarray, "draws ..."]:
        """One result by its name.

        **Raises:** `SimulationError` where it was not asked for.
        """
        found = self.own.get(name, getattr(self, name) if name in REDUCTIONS else None)
        if found is None:
            present = [known for known in REDUCTIONS if getattr(self, known) is not None]
            raise SimulationError(
                f"reductions: expected one of {', '.join([*present, *self.own])}, got {name!r}; "
                f"ask simulate_batch for it{nearest([name], [*present, *self.own])}"
            )
        return found

    def plot(self) -> "Figure":
        """How each quantity is distributed over the draws: `jaxtwin.plots.plot_distributions`."""
        return picture("plot_distributions", self.to_xarray())

    def to_xarray(self) -> "xarray.Dataset":
        """What was asked for with labels: failed (draw), and the others (draw, channel) or (draw);
        a user's own quantities have their own further dimensions."""
        import xarray

        variables: dict[str, Any] = {"failed": ("draw", self.failed)}
        for name, reduction in REDUCTIONS.items():
            if (values := getattr(self, name)) is not None:
                dims = ("draw", "channel")[: values.ndim]
                variables[name] = (dims, values, {"units": reduction.unit})
        for name, values in self.own.items():
            dims = ("draw", *(f"{name}_{axis}" for axis in range(1, values.ndim)))
            variables[name] = (dims, values)
        draws = np.arange(len(self.failed))
        return xarray.Dataset(variables, coords={"draw": draws, "channel": list(self.channels)})

    def to_dataframe(self) -> "pandas.DataFrame":
        """A row for each draw and channel, its index, and a column for each quantity.

        A quantity with one value a draw, such as those of the plate, stands in each row of its
        draw. A user's own quantity with several values a draw has a column for each of them, such
        as `rise[0]` and `rise[1]`.
        """
        table = self.to_xarray()
        for name, values in self.own.items():
            if values.ndim > 1:
                columns = {
                    f"{name}[{', '.join(map(str, place))}]": ("draw", values[:, *place])
                    for place in np.ndindex(*values.shape[1:])
                }
                table = table.drop_vars(name).assign(columns)
        return table.to_dataframe()

    def __repr__(self) -> str:
        kept = [name for name in REDUCTIONS if getattr(self, name) is not None]
        named = ", ".join([*kept, *self.own]) or "nothing"
        failed = int(np.count_nonzero(self.failed))
        return f"<Reductions of {len(self.failed)} draws: {named}; {failed} failed>"

    def _repr_html_(self) -> str:
        rows = []
        for name, values in self.to_xarray().data_vars.items():
            if name != "failed" and np.isfinite(values).any():
                quantiles = np.nanquantile(values, (0.05, 0.5, 0.95))
                unit = str(values.attrs.get("units", ""))
                rows.append((str(name), *(f"{value:.4g}" for value in quantiles), unit))
        return html_table(repr(self), ("", "5 %", "median", "95 %", "unit"), rows)

    @property
    def rmse(self) -> Float[np.ndarray, " draws"]:
        """Over all channels, K.

        **Raises:** `SimulationError` where the cost was not asked for.
        """
        return np.sqrt(self["cost"].mean(axis=1))


def reduce_readings(
    reductions: Mapping[str, Reduction],
    readings: Readings,
    recorded: Float[np.ndarray, "times channels"] | None,
) -> dict[str, Shaped[Array, "draws ..."]]:
    """The results of a chunk of draws, by name.

    **Arguments:**

    - `reductions`: by the name of their result.
    - `readings`: at least what the reductions read.
    - `recorded`: temperatures with as many samples as the trajectories have, degC.
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
) -> dict[str, Reduction]:
    """The reductions that are asked of some experiments, by the name of their result.

    **Raises:** `SimulationError` for unknown names, none, what is no function, or the cost where
    nothing is recorded, or nothing in one of the channels.
    """
    experiments = list(experiments)
    if isinstance(reductions, Mapping):
        wanted = {name: _checked_reduction(name, asked) for name, asked in reductions.items()}
    else:
        names = names_of("reductions", reductions, SimulationError)
        wanted = {name: _checked_reduction(name, name) for name in names}
    if not wanted:
        raise SimulationError(
            f"reductions: expected some of {', '.join(REDUCTIONS)}, or functions by name, got none"
        )
    if any(reduction.needs_recording for reduction in wanted.values()):
        for experiment in experiments:
            _check_recorded(experiment)
    return wanted


def _checked_reduction(name: str, asked: str | ReductionFunction) -> Reduction:
    known = ", ".join(REDUCTIONS)
    if isinstance(asked, str):
        if asked not in REDUCTIONS or asked != name:
            raise SimulationError(
                f"reductions: expected some of {known}, got {asked}{nearest([asked], REDUCTIONS)}"
            )
        return REDUCTIONS[asked]
    if not callable(asked):
        raise SimulationError(
            f"reductions: {name}: expected one of {known}, or a JAX function of a trajectory "
            f"(times, channels), got {asked!r}"
        )
    if name in REDUCTIONS or name == "failed":
        raise SimulationError(
            f"reductions: expected another name for a function than {name!r}, which is taken; "
            "rename it"
        )
    return Reduction("trajectory", asked)


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
