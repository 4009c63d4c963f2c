"""The outputs of a global analysis: numbers of each run, by quantity, channel, time, recording."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias, cast, final, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from .._arguments import finite_number, names_of
from .._name_suggestions import did_you_mean
from ..errors import SimulationError
from ..io import Experiment, as_experiments
from ..matching import Fit
from ..physics import Twin, check_twin
from ..simulation import REDUCTIONS, ReductionFunction, ReductionName, Reductions, ordered
from ._sensitivity import MEAN

# The name of a reduction (see `jaxtwin.simulation.Reductions`); the "uniformity", the range over
# the channels on average over time, K; or the "temperature" of each channel at several times.
OutputName: TypeAlias = ReductionName | Literal["uniformity", "temperature"]

# Names of outputs, or name -> the same name, or a JAX function of a trajectory.
OutputChoice: TypeAlias = Iterable[OutputName] | Mapping[str, OutputName | ReductionFunction]

# The default number of times at which temperatures are outputs.
TIMES = 25


@final
@dataclass(frozen=True)
class Output:
    """A number that each run gives.

    - `quantity`: the name of the quantity, such as "cost"; for a user's function with several
      results also the place of the result, such as "rise[0]".
    - `channel`: the channel, or "mean" for the mean cost of all; empty for a quantity that belongs
      to no channel.
    - `time`: the time of the quantity, s; NaN for a quantity of the whole run.
    - `recording`: the name of the recording; empty for a quantity of all recordings.
    - `unit`: the unit; empty if it is not known.
    """

    quantity: str
    channel: str = ""
    time: float = float("nan")
    recording: str = ""
    unit: str = ""

    def label(self, several_recordings: bool) -> str:
        """The output as text, such as "cost T11" or "temperature T11 at 60 s (step A)".

        **Arguments:**

        - `several_recordings`: whether the text contains the name of the recording.
        """
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
    """Computes the difference between the highest and the lowest temperature of the channels, on
    average over time, K."""
    return jnp.mean(trajectory.max(axis=1) - trajectory.min(axis=1))


def checked_outputs(outputs: OutputChoice) -> dict[str, OutputName | ReductionFunction]:
    """Returns the requested outputs by their names.

    **Raises:** `SimulationError` for unknown names, and for no name at all.
    """
    requested: dict[str, Any]
    if isinstance(outputs, Mapping):
        requested = dict(cast(Mapping[str, Any], outputs))
    else:
        names = names_of("sensitivity: outputs", outputs, SimulationError)
        requested = {name: name for name in names}
    known = (*REDUCTIONS, *(name for part in get_args(OutputName)[1:] for name in get_args(part)))
    if not requested:
        raise SimulationError(
            f"sensitivity: outputs: expected some of {', '.join(known)}, or functions by name, got "
            "none"
        )
    for name, value in requested.items():
        if isinstance(value, str) and (value not in known or value != name):
            raise SimulationError(
                f"sensitivity: outputs: expected some of {', '.join(known)}, or functions by name, "
                f"got {value!r}{did_you_mean([value], known)}"
            )
    return requested


def samples_at(times: Sequence[float] | None, experiment: Experiment) -> tuple[int, ...]:
    """Finds the samples of an experiment that are nearest to some times.

    **Arguments:**

    - `times`: the times, s; None for times that divide the experiment evenly.

    **Raises:** `SimulationError` if there is no time, or one outside of the experiment.
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
    outputs: Mapping[str, OutputName | ReductionFunction], samples: tuple[int, ...]
) -> dict[str, ReductionName | ReductionFunction]:
    """Returns the reductions that `reduce_batch` has to compute."""
    functions: dict[Any, ReductionFunction] = {
        "uniformity": mean_range,
        "temperature": TemperatureAt(samples),
    }
    reductions: dict[str, Any] = {
        name: functions.get(value, value) for name, value in outputs.items()
    }
    return reductions


Column = tuple[Output, Float[np.ndarray, " runs"]]


def columns_of(
    results: Reductions, names: Iterable[str], samples: tuple[int, ...], experiment: Experiment
) -> list[Column]:
    """Returns each output of the runs of an experiment; NaN for a failed run."""
    return [
        (output, np.where(results.failed, np.nan, column))
        for name in names
        for output, column in _columns(name, results, samples, experiment)
    ]


def with_mean_cost(columns: list[Column]) -> list[Column]:
    """Appends the mean cost of all channels and recordings, if costs are among the outputs."""
    costs = [column for output, column in columns if output.quantity == "cost"]
    if not costs:
        return columns
    return [*columns, (Output("cost", MEAN, unit="K^2"), np.mean(costs, axis=0))]


def labels_of(outputs: Sequence[Output]) -> tuple[str, ...]:
    """Returns a text for each output. No two texts are equal."""
    recordings = {output.recording for output in outputs if output.recording}
    return tuple(distinct_names(output.label(len(recordings) > 1) for output in outputs))


def failed_runs(columns: Sequence[Column]) -> Bool[np.ndarray, " runs"]:
    """Returns which runs have an output that is not finite."""
    return np.any([~np.isfinite(column) for _, column in columns], axis=0)


def _columns(
    name: str, results: Reductions, samples: tuple[int, ...], experiment: Experiment
) -> list[tuple[Output, Shaped[np.ndarray, " runs"]]]:
    values, recording = results[name], experiment.name
    if name == "temperature":
        return [
            (Output(name, channel, float(experiment.time[sample]), recording, "degC"), column)
            for number, channel in enumerate(results.channels)
            for sample, column in zip(samples, values[:, :, number].T, strict=True)
        ]
    unit = "K" if name == "uniformity" else ""
    if name in REDUCTIONS:
        unit = REDUCTIONS[name].unit
        if REDUCTIONS[name].dimension == "channel":
            return [
                (Output(name, channel, recording=recording, unit=unit), column)
                for channel, column in zip(results.channels, values.T, strict=True)
            ]
    return columns_of_values(Output(name, recording=recording, unit=unit), values)


def columns_of_values(
    output: Output, values: Shaped[np.ndarray, "runs ..."]
) -> list[tuple[Output, Shaped[np.ndarray, " runs"]]]:
    """Returns the column of an output. If each run gives an array, each of its entries has a
    column, named by its place."""
    columns = values.reshape(len(values), -1).T
    places = [f"[{', '.join(map(str, place))}]" for place in np.ndindex(*values.shape[1:])]
    ends = places if values.ndim > 1 else [""]
    return [
        (replace(output, quantity=f"{output.quantity}{end}"), column)
        for end, column in zip(ends, columns, strict=True)
    ]


def paired_twins(
    study: str,
    twin: Twin | Fit | Sequence[Twin],
    experiments: Experiment | Sequence[Experiment] | None,
) -> tuple[list[Twin], list[Experiment]]:
    """Pairs each experiment with its twin.

    **Arguments:**

    - `study`: the name of the calling function, for error messages.
    - `twin`: one twin for all experiments, one for each, or a fit, which has one for each: see
      `Fit.twin_for`.
    - `experiments`: one or several; None for the experiments of the fit.

    **Raises:** `SimulationError` if the numbers of twins and experiments differ, if there are none,
    or if the twins have different rigs; `MatchError` if a recording that was not matched is too
    short to estimate its values.
    """
    if experiments is None:
        if not isinstance(twin, Fit):
            raise SimulationError(
                f"{study}: experiments: expected one or several, got none; only a fit "
                "has experiments"
            )
        experiments = twin.experiments
    recordings = as_experiments(f"{study}: experiments", experiments, SimulationError)
    if isinstance(twin, Fit):
        twins = [twin.twin_for(experiment) for experiment in recordings]
    elif isinstance(twin, Twin):
        twins = [twin] * len(recordings)
    else:
        if isinstance(twin, str) or not isinstance(twin, Iterable):
            check_twin(f"{study}: twin", twin, SimulationError)
        twins = list(twin)
    for candidate in twins:
        check_twin(f"{study}: twin", candidate, SimulationError)
    if not recordings or len(twins) != len(recordings):
        raise SimulationError(
            f"{study}: expected one twin for all experiments or one for each, got {len(twins)} "
            f"twins for {len(recordings)} experiments"
        )
    if any(twin.rig != twins[0].rig for twin in twins):
        raise SimulationError(f"{study}: expected twins of the same rig, got twins of several rigs")
    return twins, [ordered(recording, twins[0]) for recording in recordings]


def distinct_names(names: Iterable[str]) -> list[str]:
    """The names, each made unique: a second `T` becomes `T (2)`."""
    counts: dict[str, int] = {}
    labels = []
    for name in names:
        counts[name] = counts.get(name, 0) + 1
        labels.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return labels
