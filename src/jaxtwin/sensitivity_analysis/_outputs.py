"""What a global analysis looks at: numbers of each run, by quantity, channel, time, recording."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias, cast, final, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from .._arguments import finite_number, names_of
from .._errors import SimulationError
from .._name_suggestions import did_you_mean
from ..io import Experiment
from ..simulation import REDUCTIONS, ReductionName, Reductions
from ..simulation._reductions import ReductionFunction
from ._draws import distinct_names
from ._sensitivity import MEAN

OutputName: TypeAlias = ReductionName | Literal["uniformity", "temperature"]
"""The name of a reduction (see `jaxtwin.simulation.Reductions`); the "uniformity", the range over
the channels on average over time, K; or the "temperature" of each channel at several times."""

AskedOutputs: TypeAlias = Iterable[OutputName] | Mapping[str, OutputName | ReductionFunction]
"""Names of outputs, or name -> the same name, or a JAX function of a trajectory."""

TIMES = 25
"""At how many times temperatures are looked at unless others are asked for."""


@final
@dataclass(frozen=True)
class Output:
    """A number that each run gives.

    - `quantity`: such as "cost"; of a user's function with several results, such as "rise[0]".
    - `channel`: where it is of one; "mean" of all for the cost; else empty.
    - `time`: s, where it is of one; else NaN.
    - `recording`: its name; empty for what is of all recordings.
    - `unit`: empty where it is not known.
    """

    quantity: str
    channel: str = ""
    time: float = float("nan")
    recording: str = ""
    unit: str = ""

    def label(self, several_recordings: bool) -> str:
        """Such as "cost T11", or "temperature T11 at 60 s (step A)"."""
        words = [self.quantity, self.channel] if self.channel else [self.quantity]
        if not np.isnan(self.time):
            words.append(f"at {self.time:g} s")
        if several_recordings and self.recording:
            words.append(f"({self.recording})")
        return " ".join(words)


@final
@dataclass(frozen=True)
class TemperatureAt:
    """The temperatures of all channels at some samples of a trajectory."""

    samples: tuple[int, ...]

    def __call__(self, trajectory: Float[Array, "times channels"]) -> Float[Array, "some channels"]:
        return trajectory[np.array(self.samples)]


def mean_range(trajectory: Float[Array, "times channels"]) -> Float[Array, ""]:
    """The highest less the lowest temperature of the channels, on average over time, K."""
    return jnp.mean(trajectory.max(axis=1) - trajectory.min(axis=1))


def checked_outputs(outputs: AskedOutputs) -> dict[str, OutputName | ReductionFunction]:
    """Returns the requested outputs by their names.

    **Raises:** `SimulationError` for unknown names, and for no name at all.
    """
    asked: dict[str, Any]
    if isinstance(outputs, Mapping):
        asked = dict(cast(Mapping[str, Any], outputs))
    else:
        names = names_of("sensitivity: outputs", outputs, SimulationError)
        asked = {name: name for name in names}
    known = (*REDUCTIONS, *(name for part in get_args(OutputName)[1:] for name in get_args(part)))
    if not asked:
        raise SimulationError(
            f"sensitivity: outputs: expected some of {', '.join(known)}, or functions by name, got "
            "none"
        )
    for name, value in asked.items():
        if isinstance(value, str) and (value not in known or value != name):
            raise SimulationError(
                f"sensitivity: outputs: expected some of {', '.join(known)}, or functions by name, "
                f"got {value!r}{did_you_mean([value], known)}"
            )
    return asked


def samples_at(times: Sequence[float] | None, experiment: Experiment) -> tuple[int, ...]:
    """The samples of an experiment that are nearest to some times; None for times that divide it
    evenly.

    **Raises:** `SimulationError` for a time outside of the experiment, or none.
    """
    grid = experiment.time
    if times is None:
        wanted = np.linspace(grid[0], grid[-1], TIMES + 1)[1:]
    else:
        if isinstance(times, str) or not isinstance(times, Iterable):
            raise SimulationError(
                f"sensitivity: times: expected several times, s, or None, got {times!r}"
            )
        wanted = np.array(
            [finite_number("sensitivity: times", time, SimulationError) for time in times]
        )
        if not len(wanted) or wanted.min() < grid[0] or wanted.max() > grid[-1]:
            raise SimulationError(
                f"sensitivity: times: expected some from {grid[0]:g} to {grid[-1]:g} s, which "
                f"{experiment.name or 'the experiment'} spans, got {list(times)}"
            )
    nearest = np.abs(grid[:, None] - wanted).argmin(axis=0)
    return tuple(sorted({int(number) for number in nearest}))


def reductions_for(
    asked: Mapping[str, OutputName | ReductionFunction], samples: tuple[int, ...]
) -> dict[str, ReductionName | ReductionFunction]:
    """Returns the reductions that `simulate_batch` has to compute."""
    own: dict[Any, ReductionFunction] = {
        "uniformity": mean_range,
        "temperature": TemperatureAt(samples),
    }
    reductions: dict[str, Any] = {name: own.get(value, value) for name, value in asked.items()}
    return reductions


Column = tuple[Output, Float[np.ndarray, " runs"]]


def columns_of(
    found: Reductions, asked: Iterable[str], samples: tuple[int, ...], experiment: Experiment
) -> list[Column]:
    """Each number that the runs of an experiment gave, NaN where a run failed."""
    return [
        (output, np.where(found.failed, np.nan, column))
        for name in asked
        for output, column in _columns(name, found, samples, experiment)
    ]


def with_mean_cost(columns: list[Column]) -> list[Column]:
    """And the mean cost of all channels and recordings, where it was asked for."""
    costs = [column for output, column in columns if output.quantity == "cost"]
    if not costs:
        return columns
    return [*columns, (Output("cost", MEAN, unit="K2"), np.mean(costs, axis=0))]


def labels_of(outputs: Sequence[Output]) -> tuple[str, ...]:
    """The outputs as text, each its own."""
    recordings = {output.recording for output in outputs if output.recording}
    return tuple(distinct_names(output.label(len(recordings) > 1) for output in outputs))


def failed_runs(columns: Sequence[Column]) -> Bool[np.ndarray, " runs"]:
    """Which runs gave a number that is not finite."""
    return np.any([~np.isfinite(column) for _, column in columns], axis=0)


def _columns(
    name: str, found: Reductions, samples: tuple[int, ...], experiment: Experiment
) -> list[tuple[Output, Shaped[np.ndarray, " runs"]]]:
    values, recording = found[name], experiment.name
    if name == "temperature":
        return [
            (Output(name, channel, float(experiment.time[sample]), recording, "degC"), column)
            for number, channel in enumerate(found.channels)
            for sample, column in zip(samples, values[:, :, number].T, strict=True)
        ]
    unit = "K" if name == "uniformity" else ""
    if name in REDUCTIONS:
        unit = REDUCTIONS[name].unit
        if REDUCTIONS[name].dimension == "channel":
            return [
                (Output(name, channel, recording=recording, unit=unit), column)
                for channel, column in zip(found.channels, values.T, strict=True)
            ]
    return columns_of_values(Output(name, recording=recording, unit=unit), values)


def columns_of_values(
    output: Output, values: Shaped[np.ndarray, "runs ..."]
) -> list[tuple[Output, Shaped[np.ndarray, " runs"]]]:
    """An output's column, or several, named by their place, where each run gives an array."""
    columns = values.reshape(len(values), -1).T
    places = [f"[{', '.join(map(str, place))}]" for place in np.ndindex(*values.shape[1:])]
    ends = places if values.ndim > 1 else [""]
    return [
        (replace(output, quantity=f"{output.quantity}{end}"), column)
        for end, column in zip(ends, columns, strict=True)
    ]
