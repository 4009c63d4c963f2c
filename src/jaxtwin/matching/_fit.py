"""The result of a match."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Float

from .._by_recording import ByRecording
from .._display import picture, report
from .._result import AbstractResult, table
from .._statistics import mean_fit_percent
from ..errors import MatchError, SimulationError
from ..io import Experiment, of_rig
from ..physics import Twin
from ..rig import Rig
from ..simulation import Run
from ._camera_error import CameraError, Comparison
from ._descent_result import Iteration, Optimum
from ._fitted_parameters import FittedParameter, FittedParameters
from ._group_values import new_group_values
from ._model_error import ModelError
from ._noise_model import Noise, NoiseModel
from ._problem import MatchProblem
from ._start import FirstSample
from ._summary import Style, fit_dataset, summary_table
from ._uncertainty import Uncertainty

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


@final
@dataclass(frozen=True, eq=False)
class Solution:
    """A match problem with its solution, from which profiles, bands and draws are computed.

    **Arguments:**

    - `problem`: the problem that was solved. Its `experiments` are empty if the fit was loaded
      without its recordings.
    - `noise_model`: the noise model of the last round.
    - `vector`: the optimiser's vector at the optimum.
    """

    problem: MatchProblem
    noise_model: NoiseModel
    vector: Float[np.ndarray, " unknowns"]


@final
@dataclass(frozen=True, repr=False, eq=False)
class Fit(AbstractResult):
    """A twin matched to recordings.

    `fit["R_E"].value` and `fit["R_E"].standard_error` are the matched values. A fit that `load`
    read without its recordings has no `experiments`, `runs` and `camera`.

    **Arguments:**

    - `twin`: the twin with the fitted values, and with the own values of the first recording.
    - `recordings`: names of the recordings. `fingerprints`: SHA-256 of their contents. `channels`:
      the channels of each.
    - `first_samples`: the temperatures with which each begins.
    - `parameters`: name -> `FittedParameter` for every parameter of the rig, in the order of its
      table.
    - `recording_values`: recording -> name -> value, for parameters with a value for each recording
      or for each of several groups of recordings.
    - `fit_percent`: (recording, channel) -> NRMSE fit, %; NaN for a constant channel.
    - `rmse`: the root mean square error over all channels, K.
    - `status`, `converged`: the reason why the best descent stopped, and whether its end is an
      optimum.
    - `history`: all iterations of the best start. `optima`: the ends of all starts, best first.
    - `wall_time`: the duration of the match including compilation, s.
    - `solver_gap`: the largest difference between the readings that the match simulates, with the
      longest steps, and those of shorter steps, K.
    - `camera_error`: root mean square of the camera's common error, K.
    - `noise`: the noise of the channels without their common mode, and the noise of the common mode
      times the root of the number of channels.
    - `uncertainty`: the covariance, correlations and identifiability of the values.
    - `model_error`: the error of the network itself, as predictions of the recordings' later parts
      show it.
    - `cost`: half the sum of squared weighted residuals and priors.
    - `date`: the end of the match, UTC, ISO 8601. `versions`: the versions of jaxtwin and jax.
    - `notes`: what should be looked at in the recordings, such as gaps and readings that hold much
      of the misfit, in sentences.
    - `comparisons`: the comparison of the fitted twin with each recording; None without the
      recordings.
    """

    twin: Twin
    recordings: tuple[str, ...]
    fingerprints: tuple[str, ...]
    channels: tuple[tuple[str, ...], ...]
    first_samples: tuple[FirstSample, ...]
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
    model_error: ModelError
    cost: float
    date: str
    versions: Mapping[str, str]
    notes: tuple[str, ...]
    comparisons: tuple[Comparison, ...] | None
    _solution: Solution

    @property
    def experiments(self) -> tuple[Experiment, ...]:
        """The recordings.

        **Raises:** `MatchError` if the fit was loaded without them.
        """
        self._compared()
        return self._solution.problem.experiments

    @property
    def runs(self) -> dict[str, Run]:
        """Recording -> the fitted twin's run, without the camera's common error.

        **Raises:** `MatchError` if the fit was loaded without its recordings.
        """
        pairs = zip(self.recordings, self._compared(), strict=True)
        return ByRecording({name: comparison.run for name, comparison in pairs})

    @property
    def camera(self) -> dict[str, CameraError]:
        """Recording -> the camera's common error.

        **Raises:** `MatchError` if the fit was loaded without its recordings.
        """
        pairs = zip(self.recordings, self._compared(), strict=True)
        return ByRecording({name: comparison.camera for name, comparison in pairs})

    @property
    def events(self) -> dict[str, tuple[float, ...]]:
        """Recording -> times of the camera's corrections, s."""
        events = self._solution.noise_model.events
        return ByRecording(dict(zip(self.recordings, events, strict=True)))

    @property
    def weights(self) -> dict[str, Float[np.ndarray, "times channels"]]:
        """Recording -> the weight of each sample, 0 to 1, `(times, channels)`."""
        known = self._solution.noise_model
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
        """Mean fit of all channels that are not constant, over all recordings, %."""
        return mean_fit_percent(self.fit_percent.values())

    @property
    def twins(self) -> dict[str, Twin]:
        """Recording -> the twin with the values of that recording."""
        return ByRecording(
            {name: self.twin.with_values(values) for name, values in self.recording_values.items()}
        )

    @property
    def groups(self) -> dict[str, str]:
        """Recording -> name of its group; a single name if the match had no groups."""
        problem = self._solution.problem
        numbers = zip(self.recordings, problem.unknowns.group_numbers, strict=True)
        return {name: problem.group_names[number] for name, number in numbers}

    @property
    def group_values(self) -> dict[str, dict[str, float]]:
        """Group -> name -> value, for parameters with a value for each group."""
        rows, _ = self._solution.problem.unknowns.rows_of_groups()
        return {
            group: {row.name: float(self.twins[name].values[row.name]) for row in rows}
            for name, group in reversed(self.groups.items())
        }

    @property
    def mean_twin(self) -> Twin:
        """The twin with the mean of the recordings' own values, and with the values expected of
        another group if the match had several."""
        rows = self.parameters.values()
        own = {row.name: row.value for row in rows if row.free and row.scope != "shared"}
        return self.twin.with_values(own)

    def twin_of_group(self, group: str) -> Twin:
        """The twin with the values of a group, and with the mean of the recordings' own values.

        For a group that was not matched these are the values expected of any group, which follow
        from those of the matched groups. See `docs/matching.md`.
        """
        problem = self._solution.problem
        if group in problem.group_names:
            return self.mean_twin.with_values(self.group_values[group])
        expected = new_group_values(problem.unknowns, self._solution.vector)
        return self.mean_twin.with_values(expected.values)

    def twin_for(self, experiment: Experiment) -> Twin:
        """The twin with the values that belong to an experiment and not to the rig.

        Every function that takes a twin and experiments also takes a fit, and then uses this
        method.

        - A matched recording has its matched values. It is recognised by its contents, whatever its
          name.
        - For another recording the values are estimated from its first minute, as
          `jaxtwin.validate` does: see `jaxtwin.matching.estimate_initial_conditions`.
        - An experiment without recorded temperatures gets the mean of the matched recordings'
          values.

        Parameters that differ between groups have the values of the experiment's group if that was
        matched, and otherwise those expected of a new group (`twin_of_group`).

        **Raises:** `MatchError` if a recording that was not matched is too short to estimate its
        values; `SimulationError` for a recording of another rig.
        """
        label = experiment.name or "the experiment"
        experiment = of_rig(experiment, self.twin.rig, label, SimulationError)
        if experiment.fingerprint in self.fingerprints:
            return self.twins[self.recordings[self.fingerprints.index(experiment.fingerprint)]]
        if experiment.temperatures is None:
            return self.twin_of_group(experiment.group)
        from ._initial_conditions import estimate_initial_conditions

        return estimate_initial_conditions(self, experiment).twin

    def __getitem__(self, name: str) -> FittedParameter:
        """The row of one parameter.

        **Raises:** `ParameterError` if the rig has no parameter of this name.
        """
        return self.parameters[name]

    def summary(self, style: Style = "text") -> str:
        """The parameters in the layout of Table 4 of the paper with 95 % intervals, priors and
        warnings. The plain text also contains the fit of each channel and the undetermined
        directions.

        **Arguments:**

        - `style`: `"text"`, `"markdown"` or `"latex"` (a `tabular` for the package booktabs).
        """
        return summary_table(self, style)

    def _for_json(self) -> dict[str, Any]:
        fits: dict[str, dict[str, float]] = {name: {} for name in self.recordings}
        for (recording, channel), value in self.fit_percent.items():
            fits[recording][channel] = value
        return {
            "rig": self.twin.rig.name,
            "mean_fit_percent": self.mean_fit_percent,
            "rmse_K": self.rmse,
            "status": self.status,
            "converged": self.converged,
            "iterations": self.history[-1].number,
            "wall_time_s": self.wall_time,
            "parameters": [asdict(row) for row in self.parameters.values()],
            "recordings": self.recording_values,
            "fit_percent": fits,
            "optima": [
                {
                    "start": optimum.start,
                    "cost": optimum.cost,
                    "apart_K": optimum.apart,
                    "rmse_K": optimum.rmse,
                    "iterations": optimum.iterations,
                    "status": optimum.status,
                    "converged": optimum.converged,
                    "values": optimum.values,
                }
                for optimum in self.optima
            ],
        }

    def plot(self) -> "Figure":
        """Plots the simulated beside the recorded temperatures, or the parameters if the fit was
        loaded without its recordings: `jaxtwin.plots.plot_comparison` and `plot_parameters`."""
        if self.comparisons is None:
            return picture("plot_parameters", self)
        return picture("plot_comparison", list(self.runs.values()))

    def report(self, path: str | os.PathLike[str], *, draws: int = 0) -> Path:
        """Writes the fit as an HTML page that needs no other file: the rig, the recordings,
        recorded beside simulated temperatures, parameters with priors and intervals, and tests of
        the residuals.

        **Arguments:**

        - `path`: the folder of the report. An older report there is replaced.
        - `draws`: the number of draws of a sensitivity analysis; 0 leaves it out.

        **Returns:** the path of the page. The fit, the pictures and all numbers are files beside
        it.

        **Raises:** `MatchError` if the fit was loaded without its recordings; `JaxtwinError` if the
        folder holds something else or cannot be written.
        """
        return report(self, path, draws=draws)

    def to_xarray(self) -> "xarray.Dataset":
        """The numbers of the fit as a dataset.

        For each parameter: value, initial, standard_error, lower, upper and interval (parameter,
        bound). Further variables: recording_value (recording, own_parameter); fit_percent
        (recording, channel), NaN if a recording does not have the channel; covariance and
        correlation (entry, other_entry) of the matched values, with the labels of `uncertainty`;
        rmse (iteration). The runs have their own `to_xarray`.
        """
        return fit_dataset(self)

    def to_dataframe(self) -> "pandas.DataFrame":
        """A table with a row for every parameter, its name as index and the fields of
        `FittedParameter` as columns; `warnings` as a single text."""
        rows = self.parameters.values()
        return table([asdict(row) | {"warnings": ", ".join(row.warnings)} for row in rows], "name")

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the fit as a TOML file, as a whole or not at all.

        The file is a parameter file that `read_parameters`, `Twin` and the command line accept.
        Further tables hold what `load` needs: uncertainty, fits, history, fingerprints of the
        recordings, versions.

        **Returns:** the path.

        **Raises:** `ParameterError` if the file name does not end in .toml or the file cannot be
        written.
        """
        from ._save_fit import save_fit

        save_fit(self, path)
        return Path(path)

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

        - `path`: the path of the file.
        - `rig`: the rig, or what `load_rig` takes; by default the bundled rig or the rig file with
          which the fit was made.
        - `experiments`: the matched recordings, in any order and under any names: they are
          recognised by their fingerprints. With them the fit has its runs again, and `profile`
          works.

        **Raises:** `ParameterError` if the file cannot be read, something in it is missing or
        damaged, or the rig is another; `MatchError` if a matched recording is not among the
        experiments; `RigError` if the rig cannot be read.
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

    def _overview(self) -> "pandas.DataFrame":
        rows = self.to_dataframe().query("free").rename_axis("parameter")
        # An error is hardly known better than to two digits.
        rounded = {"standard error": [float(f"{error:.2g}") for error in rows["standard_error"]]}
        return rows.assign(**rounded).filter(["value", "standard error", "unit", "warnings"])

    def __repr__(self) -> str:
        return (
            f"<Fit of {self.twin.rig.name} to {len(self.recordings)} recordings: "
            f"{self.mean_fit_percent:.2f} %, RMSE {self.rmse:.3f} K, {self.status}>"
        )


def solution_of(fit: Fit) -> Solution:
    """The solved problem behind a fit, for the other modules of the package. Users have the
    properties of `Fit`."""
    return fit._solution
