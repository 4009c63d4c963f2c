"""What a match gives."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Float

from .._by_recording import ByRecording
from .._display import html_table, picture, report
from .._errors import MatchError, ParameterError
from .._measures import mean_fit_percent
from ..io import Experiment
from ..physics import Twin
from ..rig import Parameter, Rig, write_parameters
from ..rig._parameter import Scope
from ..rig._problems import unknown
from ..simulation import Run
from ._noise import Noise
from ._noise_model import NoiseModel
from ._problem import MatchProblem
from ._summary import Style, summary_table
from ._uncertainty import Uncertainty

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


@final
@dataclass(frozen=True)
class FittedParameter:
    r"""One row of Table 4 of the paper.

    **Arguments:**

    - `name`, `unit`, `description`, `free`, `scope`: as in the rig's parameter table.
    - `initial`, `value`: before and after, in `unit`. Where each recording has its own, their mean;
      where each of several groups has its own, what is expected of another group.
    - `published`: what the rig's parameter set `published` says, None where it says nothing.
    - `lower`, `upper`: bounds of the match.
    - `is_logarithmic`: whether it was matched by its logarithm, so that `prior_spread` is relative.
    - `at_bound`: whether it ended on one: what the data would rather have lies outside.
    - `standard_error`: in `unit`, with the residuals' autocorrelation counted; infinite where
      nothing tells it, NaN where the parameter was held or ended at a bound.
    - `prior_value`, `prior_spread`: what was known beforehand, None where nothing was.
    - `prior_distance`: of the value from there in standard deviations; the largest of all
      recordings.
    - `prior_to_data_ratio`: the prior's standard deviation over the one that the recordings alone
      would leave if all other parameters were known.
    - `warnings`: what to know before believing it.
    - `relative_standard_error`: of its natural logarithm, where it was matched by that; else NaN.
    - `interval`: both ends of its 95 % interval, in `unit`: $v e^{\pm 1.96 s}$ where it was matched
      by its logarithm, else $v \pm 1.96 s$, whatever the bounds. Unbounded where nothing tells it,
      NaN where `standard_error` is. Where each recording has its own, with the largest error.
    - `group_spread`: by how much groups are expected to differ, as `prior_spread`; else None.
    """

    name: str
    unit: str
    description: str
    free: bool
    scope: Scope
    initial: float
    value: float
    published: float | None
    lower: float
    upper: float
    is_logarithmic: bool
    at_bound: bool
    standard_error: float
    prior_value: float | None = None
    prior_spread: float | None = None
    prior_distance: float | None = None
    prior_to_data_ratio: float = math.nan
    warnings: tuple[str, ...] = ()
    relative_standard_error: float = math.nan
    interval: tuple[float, float] = (math.nan, math.nan)
    group_spread: float | None = None


@final
@dataclass(frozen=True)
class Iteration:
    """One step of the optimiser, for Fig. 14 of the paper.

    - `number`: 0 is the start. `start`: of which of several starts; for `match_many` the number of
      the set, for `profile` that of the point.
    - `cost`: mean squared error, eq. (11), K^2. `rmse`: its root, K.
    - `gradient`: largest cosine between residual and Jacobian column, 0 at an optimum.
    - `accepted`: whether the step was taken.
    - `parameters`: name -> value; those with a value for each recording as `name[recording]`.
    """

    number: int
    start: int
    cost: float
    rmse: float
    gradient: float
    accepted: bool
    parameters: Mapping[str, float]

    def __str__(self) -> str:
        return f"iteration {self.number}: RMSE {self.rmse:.4f} K"


@final
@dataclass(frozen=True)
class Optimum:
    """Where one of several starts ended.

    - `start`: which one. `cost`: half the sum of squared weighted residuals, priors among them.
    - `apart`: root mean square of the difference between its simulated channels and those of the
      best, K: optima far apart in their parameters may predict the same.
    - `rmse`: K. `iterations`, `status`, `converged`, `parameters`.
    """

    start: int
    cost: float
    apart: float
    rmse: float
    iterations: int
    status: str
    converged: bool
    parameters: Mapping[str, float]


@final
@dataclass(frozen=True, eq=False)
class CameraError:
    """What the camera added to all channels of a recording alike.

    - `events`: times of its flat-field corrections, s.
    - `error`: simulated less recorded temperature that is the camera's, `(times,)`, K.
    """

    events: tuple[float, ...]
    error: Float[np.ndarray, " times"]

    @property
    def offset(self) -> Float[np.ndarray, " times"]:
        """What it read too much, K."""
        return -self.error


@final
@dataclass(frozen=True, eq=False)
class Comparison:
    """The fitted twin beside a recording.

    - `run`: of the fitted twin, without the camera's common error.
    - `camera`: the camera's common error.
    """

    run: Run
    camera: CameraError


@final
class FittedParameters(dict[str, FittedParameter]):
    """Name -> parameter, in the order of the rig's table; an unknown name is a `ParameterError`
    that suggests the nearest one."""

    def __missing__(self, name: object) -> FittedParameter:
        raise ParameterError(f"fit: {unknown('parameter', str(name), self)}")


@final
@dataclass(frozen=True, repr=False, eq=False)
class Fit:
    """A twin matched to recordings.

    `fit["R_E"].value` and `fit["R_E"].standard_error` are what is asked for most. A fit that `load`
    read without its recordings has everything but `experiments`, `runs` and `camera`.

    **Arguments:**

    - `twin`: with the fitted values; those of the first recording where each has its own.
    - `recordings`: names. `fingerprints`: of their contents, SHA-256. `channels`: of each.
    - `parameters`: name -> a row for every parameter of the rig, in the order of its table.
    - `recording_values`: recording -> name -> value, for parameters with one for each recording or
      for each of several groups of them.
    - `fit_percent`: (recording, channel) -> NRMSE fit, %; NaN for a channel that never changes.
    - `rmse`: over all channels, K.
    - `status`, `converged`: why the best start stopped, and whether at an optimum.
    - `history`: all iterations of the best start. `optima`: where every start ended, best first.
    - `wall_time`: s, with compilation.
    - `solver_gap`: largest difference of the runs from what the match's own, longest steps gave, K.
    - `camera_error`: root mean square of the camera's common error, K.
    - `noise`: of what each channel has alone, and of what all share times the root of their number.
    - `uncertainty`: covariance, correlations, what the recordings cannot tell.
    - `cost`: half the sum of squared weighted residuals, priors among them.
    - `problem`, `noise_model`, `vector`: what was matched, the noise model of the last round, and
      the optimiser's vector.
    - `date`: when the match ended, UTC, ISO 8601. `versions`: of jaxtwin and jax.
    - `comparisons`: of the fitted twin with each recording; None where those are not at hand.
    """

    twin: Twin
    recordings: tuple[str, ...]
    fingerprints: tuple[str, ...]
    channels: tuple[tuple[str, ...], ...]
    parameters: FittedParameters
    recording_values: Mapping[str, Mapping[str, float]]
    fit_percent: Mapping[tuple[str, str], float]
    rmse: float
    status: str
    converged: bool
    history: tuple[Iteration, ...]
    optima: tuple[Optimum, ...]
    wall_time: float
    solver_gap: float
    camera_error: float
    noise: tuple[Noise, Noise]
    uncertainty: Uncertainty
    cost: float
    problem: MatchProblem
    noise_model: NoiseModel
    vector: Float[np.ndarray, " unknowns"]
    date: str
    versions: Mapping[str, str]
    comparisons: tuple[Comparison, ...] | None

    @property
    def experiments(self) -> tuple[Experiment, ...]:
        """The recordings.

        **Raises:** `MatchError` where the fit was loaded without them.
        """
        self._compared()
        return self.problem.experiments

    @property
    def runs(self) -> dict[str, Run]:
        """Recording -> the fitted twin's run, without the camera's common error.

        **Raises:** `MatchError` where the fit was loaded without its recordings.
        """
        pairs = zip(self.recordings, self._compared(), strict=True)
        return ByRecording({name: comparison.run for name, comparison in pairs})

    @property
    def camera(self) -> dict[str, CameraError]:
        """Recording -> the camera's common error.

        **Raises:** `MatchError` where the fit was loaded without its recordings.
        """
        pairs = zip(self.recordings, self._compared(), strict=True)
        return ByRecording({name: comparison.camera for name, comparison in pairs})

    @property
    def weights(self) -> dict[str, Float[np.ndarray, "times channels"]]:
        """Recording -> how much each sample counted, 0 to 1, `(times, channels)`."""
        known = self.noise_model
        parts = zip(self.recordings, known.channel_weights, known.common_mode_weights, strict=True)
        return ByRecording({name: weight * moment[:, None] for name, weight, moment in parts})

    @property
    def plant_fit_percent(self) -> dict[tuple[str, str], float]:
        """(recording, channel) -> NRMSE fit without the camera's common error, %."""
        return {
            (name, channel): value
            for name, run in self.runs.items()
            for channel, value in run.fit_percent.items()
        }

    @property
    def mean_fit_percent(self) -> float:
        """Mean of the fits of all channels that ever change, over all recordings, %."""
        return mean_fit_percent(self.fit_percent.values())

    @property
    def twins(self) -> dict[str, Twin]:
        """Recording -> twin with the values of that recording."""
        return ByRecording(
            {
                name: self.twin.with_parameters(values)
                for name, values in self.recording_values.items()
            }
        )

    @property
    def groups(self) -> dict[str, str]:
        """Recording -> name of its group; all the same where the match knew of none."""
        numbers = zip(self.recordings, self.problem.unknowns.groups, strict=True)
        return {name: self.problem.groups[number] for name, number in numbers}

    @property
    def group_values(self) -> dict[str, dict[str, float]]:
        """Group -> name -> value, for parameters with one for each group."""
        rows, _ = self.problem.unknowns.rows_of_groups()
        return {
            group: {row.name: float(self.twins[name].parameters[row.name]) for row in rows}
            for name, group in reversed(self.groups.items())
        }

    @property
    def mean_twin(self) -> Twin:
        """The twin with the mean of what its recordings have each for itself, and what is expected
        of a group where it knows of several."""
        rows = self.parameters.values()
        own = {row.name: row.value for row in rows if row.free and row.scope != "shared"}
        return self.twin.with_parameters(own)

    def twin_of_group(self, group: str) -> Twin:
        """The twin with the values of a group, and the mean of what recordings have each for
        itself.

        Of a group that was not matched nothing is known but what is expected of any: what the
        matched groups share. See `docs/matching.md`.
        """
        if group in self.problem.groups:
            return self.mean_twin.with_parameters(self.group_values[group])
        from ._group_values import new_group_values

        expected = new_group_values(self.problem.unknowns, self.vector)
        return self.mean_twin.with_parameters(expected.values)

    def twin_for(self, experiment: Experiment) -> Twin:
        """The twin with the values that belong to an experiment and not to the rig.

        Whatever takes a twin and experiments takes a fit as well, and then uses this.

        - Of a recording that was matched they are those of the match. It is known by its contents,
          whatever its name.
        - Of another recording they are estimated from its first minute, as `jaxtwin.validate` does:
          see `jaxtwin.matching.estimate_initial_conditions`.
        - Of a drive without recorded temperatures nothing is known: it gets the mean of the matched
          recordings' values.

        What differs between groups of recordings are the values of the experiment's group, where
        that was matched, else what is expected of a new one (`twin_of_group`).

        **Raises:** `MatchError` where a recording that was not matched is too short to take its
        values from; `SimulationError` for a recording of another rig.
        """
        if experiment.fingerprint in self.fingerprints:
            return self.twins[self.recordings[self.fingerprints.index(experiment.fingerprint)]]
        if experiment.temperatures is None:
            return self.twin_of_group(experiment.group)
        from ._initial_conditions import estimate_initial_conditions

        return estimate_initial_conditions(self, experiment).twin

    def __getitem__(self, name: str) -> FittedParameter:
        """The row of one parameter.

        **Raises:** `ParameterError` where the rig has none of this name.
        """
        return self.parameters[name]

    def parameter(self, name: str) -> FittedParameter:
        """The same as `fit[name]`."""
        return self.parameters[name]

    def summary(self, style: Style = "text") -> str:
        """The parameters in the layout of Table 4 of the paper with 95 % intervals, priors and
        warnings; in plain text also the fit of each channel and what the recordings cannot tell.

        **Arguments:**

        - `style`: `"text"`, `"markdown"` or `"latex"` (a `tabular` for the package booktabs).
        """
        return summary_table(self, style)

    def to_dict(self) -> dict[str, Any]:
        """The result in plain types for JSON; infinite and missing numbers become None."""
        rows = [
            {field: _plain(getattr(row, field)) for field in FittedParameter.__dataclass_fields__}
            for row in self.parameters.values()
        ]
        fits: dict[str, dict[str, float | None]] = {name: {} for name in self.recordings}
        for (recording, channel), value in self.fit_percent.items():
            fits[recording][channel] = _plain(value)
        return {
            "rig": self.twin.rig.name,
            "mean_fit_percent": _plain(self.mean_fit_percent),
            "rmse_K": self.rmse,
            "status": self.status,
            "converged": self.converged,
            "iterations": self.history[-1].number,
            "wall_time_s": self.wall_time,
            "parameters": rows,
            "recordings": {name: dict(values) for name, values in self.recording_values.items()},
            "fit_percent": fits,
            "optima": [
                {
                    "start": optimum.start,
                    "cost": _plain(optimum.cost),
                    "apart_K": _plain(optimum.apart),
                    "rmse_K": _plain(optimum.rmse),
                    "iterations": optimum.iterations,
                    "status": optimum.status,
                    "converged": optimum.converged,
                    "parameters": {name: _plain(v) for name, v in optimum.parameters.items()},
                }
                for optimum in self.optima
            ],
        }

    def plot(self) -> "Figure":
        """The twin's response beside the recordings; of a fit that was loaded without them, the
        parameters: `jaxtwin.plots.plot_comparison` and `plot_parameters`."""
        if self.comparisons is None:
            return picture("plot_parameters", self)
        return picture("plot_comparison", list(self.runs.values()))

    def report(self, path: str | os.PathLike[str], *, draws: int = 0) -> Path:
        """Writes the fit as an HTML page that needs no other file: rig, recordings, recorded beside
        simulated temperatures, parameters with priors and intervals, residual tests.

        **Arguments:**

        - `path`: the folder of the report. An older report there is replaced.
        - `draws`: of a sensitivity analysis; 0 leaves it out.

        **Returns:** the path of the page. The fit, the pictures and all numbers are files beside
        it.

        **Raises:** `MatchError` where the fit was loaded without its recordings; `JaxtwinError`
        where the folder holds something else or cannot be written.
        """
        return report(self, path, draws=draws)

    def to_xarray(self) -> "xarray.Dataset":
        """The numbers with labels.

        Of each parameter value, initial, standard_error, lower, upper and interval (parameter,
        bound); recording_value (recording, own_parameter); fit_percent (recording, channel), NaN
        where a recording does not have the channel; covariance and correlation (entry,
        other_entry) of the matched values, whose labels are those of `uncertainty`; rmse
        (iteration). The runs have their own `to_xarray`.
        """
        import xarray

        table = tuple(self.parameters.values())
        numbers = {
            name: ("parameter", [getattr(row, name) for row in table])
            for name in ("value", "initial", "standard_error", "lower", "upper")
        }
        own = list(next(iter(self.recording_values.values())))
        channels = list(dict.fromkeys(channel for names in self.channels for channel in names))
        fits = [
            [self.fit_percent.get((name, channel), math.nan) for channel in channels]
            for name in self.recordings
        ]
        own_values = [[values[n] for n in own] for values in self.recording_values.values()]
        entries = ("entry", "other_entry")
        return xarray.Dataset(
            {
                **numbers,
                "free": ("parameter", [row.free for row in table]),
                "interval": (("parameter", "bound"), [row.interval for row in table]),
                "recording_value": (
                    ("recording", "own_parameter"),
                    np.reshape(own_values, (len(self.recordings), len(own))),
                ),
                "fit_percent": (("recording", "channel"), fits, {"units": "%"}),
                "covariance": (entries, self.uncertainty.covariance),
                "correlation": (entries, self.uncertainty.correlation, {"units": "1"}),
                "rmse": ("iteration", [step.rmse for step in self.history], {"units": "K"}),
            },
            coords={
                "parameter": [row.name for row in table],
                "unit": ("parameter", [row.unit for row in table]),
                "bound": ["lower", "upper"],
                "recording": list(self.recordings),
                "own_parameter": own,
                "channel": channels,
                "entry": list(self.uncertainty.labels),
                "other_entry": list(self.uncertainty.labels),
                "iteration": [step.number for step in self.history],
            },
            attrs={"rig": self.twin.rig.name, "status": self.status, "date": self.date},
        )

    def to_dataframe(self) -> "pandas.DataFrame":
        """A row for every parameter, its name as index, the fields of `FittedParameter` as columns;
        `warnings` as one text."""
        import pandas

        rows = [
            asdict(row) | {"warnings": ", ".join(row.warnings)} for row in self.parameters.values()
        ]
        return pandas.DataFrame(rows).set_index("name")

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the fit as TOML (.toml), as a whole or not at all.

        The file is a parameter file, which `read_parameters`, `Twin` and the command line take, and
        holds in further tables what `load` needs: uncertainty, fits, history, fingerprints of the
        recordings, versions.

        **Raises:** `ParameterError` for another ending, and where the file cannot be written.
        """
        from ._fit_file import fit_tables

        write_parameters(
            path,
            fitted_table(self.twin.rig.parameters, tuple(self.parameters.values())),
            recordings={k: v for k, v in self.recording_values.items() if v} or None,
            comment=(
                f"{self.twin.rig.name} matched to {', '.join(self.recordings)}\n"
                f"mean fit {self.mean_fit_percent:.2f} %, RMSE {self.rmse:.4f} K\n{self.status}"
            ),
            tables=fit_tables(self),
        )

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        rig: Rig | str | os.PathLike[str] | None = None,
        experiments: Experiment | Sequence[Experiment] | None = None,
    ) -> "Fit":
        """Reads a fit that `save` wrote.

        **Arguments:**

        - `path`: of the file.
        - `rig`: the rig, or what `load_rig` takes; by default the bundled rig or the file that the
          fit was made with.
        - `experiments`: the recordings that were matched, in any order and under any name: they are
          known by their fingerprints. With them the fit has its runs again and `profile` works.

        **Raises:** `ParameterError` where the file cannot be read, something in it is missing or
        damaged, or the rig is another; `MatchError` where a recording that was matched is not among
        the experiments; `RigError` where the rig cannot be read.
        """
        from ._load_fit import load_fit

        return load_fit(path, rig, experiments)

    def _compared(self) -> tuple[Comparison, ...]:
        if self.comparisons is None:
            raise MatchError(
                f"fit of {self.twin.rig.name}: expected its recordings, got none, as it was "
                f"loaded without them; pass {', '.join(self.recordings)} to Fit.load(path, "
                "experiments=...)"
            )
        return self.comparisons

    def _repr_html_(self) -> str:
        rows = [
            (
                row.name,
                f"{row.value:.4g}",
                f"{row.standard_error:.2g}",
                row.unit,
                ", ".join(row.warnings),
            )
            for row in self.parameters.values()
            if row.free
        ]
        head = ("parameter", "value", "standard error", "unit", "warnings")
        return html_table(repr(self), head, rows)

    def __repr__(self) -> str:
        return (
            f"<Fit of {self.twin.rig.name} to {len(self.recordings)} recordings: "
            f"{self.mean_fit_percent:.2f} %, RMSE {self.rmse:.3f} K, {self.status}>"
        )


def fitted_table(
    table: Mapping[str, Parameter], rows: tuple[FittedParameter, ...]
) -> list[Parameter]:
    """The rig's parameter table with fitted values, bounds, free flags and scopes."""
    return [
        replace(
            table[row.name],
            value=row.value,
            lower=row.lower,
            upper=row.upper,
            free=row.free,
            scope=row.scope,
        )
        for row in rows
    ]


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
