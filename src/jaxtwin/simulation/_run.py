"""The result of a simulation."""

import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, final

import numpy as np
from jaxtyping import Float

from .._arguments import finite_number, whole_number
from .._celsius import ZERO_CELSIUS
from .._display import picture
from .._jax_settings import own_settings
from .._name_suggestions import did_you_mean, unknown_name
from .._padded_rows import padded
from .._result import AbstractResult, dataset, table
from .._statistics import fit_percent, fit_text, rmse
from .._whole_file import check_ending
from ..errors import RecordingError, SimulationError
from ..io import Experiment
from ..physics import Twin
from ._check_values import exceeded_limits
from ._input_levels import input_levels
from ._power import SupplyPower, power_of_states

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


@final
@dataclass(frozen=True, eq=False)
class Uniformity:
    """The uniformity of temperatures over several places, at each time.

    If one of the temperatures is missing at a time, both measures are NaN there, because the range
    over fewer places is another quantity. The means and the largest range leave out such times.

    **Arguments:**

    - `time`: times, s.
    - `range`: the highest minus the lowest temperature, K.
    - `std`: the standard deviation of the temperatures, K.
    - `places`: the names of the places.
    """

    time: Float[np.ndarray, " times"]
    range: Float[np.ndarray, " times"]
    std: Float[np.ndarray, " times"]
    places: tuple[str, ...]

    @property
    def mean_range(self) -> float:
        """The mean of the range over time, K."""
        return _mean(self.range)

    @property
    def mean_std(self) -> float:
        """The mean of the standard deviation over time, K."""
        return _mean(self.std)

    @property
    def largest_range(self) -> float:
        """The largest range at any time, K."""
        return float(np.fmax.reduce(self.range))

    def __repr__(self) -> str:
        return (
            f"<Uniformity of {len(self.places)} places: range {self.mean_range:.2f} K on "
            f"average, {self.largest_range:.2f} K at most>"
        )


def uniformity(
    time: Float[np.ndarray, " times"],
    temperatures: Float[np.ndarray, "times places"],
    places: tuple[str, ...],
) -> Uniformity:
    """The uniformity of given temperatures.

    **Arguments:**

    - `time`: times, s.
    - `temperatures`: temperatures, `(times, places)`, degC or K.
    - `places`: the names of the places.
    """
    return Uniformity(
        time=time,
        range=np.ptp(temperatures, axis=1),
        std=temperatures.std(axis=1),
        places=places,
    )


def _mean(values: Float[np.ndarray, " times"]) -> float:
    there = values[~np.isnan(values)]
    return float(there.mean()) if there.size else float("nan")


@final
@dataclass(frozen=True, repr=False, eq=False)
class Run(AbstractResult):
    """The temperatures of a twin over one experiment.

    **Arguments:**

    - `experiment`: the experiment that drove the twin.
    - `channels`: the names of the channels.
    - `temperatures`: the simulated readings of the channels, `(times, channels)`, degC.
    - `nodes`: the names of the network's nodes.
    - `states`: the temperatures of the nodes, `(times, nodes)`, degC.
    - `rig`: the name of the rig.
    - `elements`: the number of nodes that are elements of the plate. They are the first nodes.
    - `twin`: the twin that was run; None for a part of a run, whose power and energy are unknown.
    - `is_steady_start`: whether the run began in the steady state under the first duty. A driver
      with a lag then begins at that duty, otherwise at 0.
    """

    experiment: Experiment
    channels: tuple[str, ...]
    temperatures: Float[np.ndarray, "times channels"]
    nodes: tuple[str, ...]
    states: Float[np.ndarray, "times nodes"]
    rig: str
    elements: int
    twin: Twin | None = None
    is_steady_start: bool = False

    @property
    def time(self) -> Float[np.ndarray, " times"]:
        """Times of the samples, s."""
        return self.experiment.time

    def __getitem__(self, name: str) -> Float[np.ndarray, " times"]:
        """The temperatures of a channel, or of a node of the network, degC.

        **Raises:** `SimulationError` for an unknown name.
        """
        if name in self.channels:
            return self.temperatures[:, self.channels.index(name)]
        if name in self.nodes:
            return self.states[:, self.nodes.index(name)]
        known = [*self.channels, *self.nodes]
        raise SimulationError(f"{self.rig}: {unknown_name('channel or node', name, known)}")

    def between(self, t0: float | int | None = None, t1: float | int | None = None) -> "Run":
        """The part of the run with `t0 <= time < t1`, as `Experiment.between` cuts. Its power and
        energy are unknown.

        **Raises:** the errors of `Experiment.between`.
        """
        part = self.experiment.between(t0, t1)
        inside = np.isin(self.time, part.time)
        return replace(
            self,
            experiment=part,
            temperatures=self.temperatures[inside],
            states=self.states[inside],
            twin=None,
        )

    @property
    def beyond_limits(self) -> tuple[str, ...]:
        """The limits that the run exceeds, as text: that of the channels in the rig file, and that
        of the cells' sides, which is the melting point of the softest solder unless the file states
        one. Nothing for a part of a run."""
        return () if self.twin is None else exceeded_limits(self, self.twin.rig)

    def channel(self, name: str) -> Float[np.ndarray, " times"]:
        """The simulated readings of one channel, degC.

        **Raises:** `SimulationError` if the run has no such channel.
        """
        return self.temperatures[:, _position(name, self.channels, "channel")]

    def node(self, name: str) -> Float[np.ndarray, " times"]:
        """The temperatures of one node, degC.

        **Raises:** `SimulationError` if the network has no such node.
        """
        return self.states[:, _position(name, self.nodes, "node")]

    @property
    def fit_percent(self) -> dict[str, float]:
        r"""The NRMSE fit of each recorded channel, $100 (1 - \|y - \hat y\| / \|y - \bar y\|)$, in
        %. Channels without a single recorded sample are left out.

        **Raises:** `SimulationError` if the experiment holds no recorded temperatures.
        """
        fits = fit_percent(self._recorded, self.temperatures)
        named = zip(self.channels, fits.tolist(), strict=True)
        return {name: fit for name, fit in named if name not in self.experiment.unsampled}

    @property
    def rmse(self) -> float:
        """The root mean square difference from the recording over all samples of all channels, K.

        **Raises:** `SimulationError` if the experiment holds no recorded temperatures.
        """
        return rmse(self._recorded, self.temperatures)

    @property
    def power(self) -> Float[np.ndarray, "times cells"]:
        """The power that each cell's bridge draws from the supply from each time on, W. It is
        negative if a cell feeds current back. The first access computes it.

        **Raises:** `SimulationError` if the run has no twin.
        """
        return np.asarray(self._supply.power)

    @property
    def energy(self) -> Float[np.ndarray, " times"]:
        """The energy that all cells together have drawn from the supply up to each time, J.

        **Raises:** `SimulationError` if the run has no twin.
        """
        return np.asarray(self._supply.energy)

    @cached_property
    def _supply(self) -> SupplyPower:
        if self.twin is None:
            raise SimulationError(
                "power: expected the run of a twin from its start, got one without a twin; "
                "simulate the whole experiment"
            )
        levels = input_levels(self.experiment, self.twin.rig.inputs)
        with own_settings():
            result = power_of_states(
                self.twin,
                padded(self.states + ZERO_CELSIUS),
                padded(self.experiment.elapsed),
                padded(self.experiment.duty),
                self.is_steady_start,
                None if levels is None else padded(levels),
            )
        count = len(self.time)
        return SupplyPower(
            np.asarray(result.power)[:count], np.asarray(result.energy)[:count], result.peak
        )

    @property
    def uniformity(self) -> Uniformity:
        """The range and the standard deviation of the simulated readings over the channels."""
        return uniformity(self.time, self.temperatures, self.channels)

    @property
    def recorded_uniformity(self) -> Uniformity:
        """The range and the standard deviation of the recorded temperatures over the channels; NaN
        at times at which a sample is missing.

        **Raises:** `SimulationError` if the experiment holds no recorded temperatures.
        """
        return uniformity(self.time, self._recorded, self.channels)

    @property
    def plate_uniformity(self) -> Uniformity:
        """The range and the standard deviation of the plate's temperature over its elements.

        **Raises:** `SimulationError` if the rig has no plate.
        """
        if not self.elements:
            raise SimulationError(
                "plate_uniformity: expected a run of a rig with a plate, got one of "
                f"{self.rig}, which has none"
            )
        plate = slice(self.elements)
        return uniformity(self.time, self.states[:, plate], self.nodes[plate])

    @property
    def _recorded(self) -> Float[np.ndarray, "times channels"]:
        if self.experiment.temperatures is None:
            raise SimulationError(
                "experiment: expected recorded temperatures to compare with, got none"
            )
        return self.experiment.temperatures

    def to_xarray(self) -> "xarray.Dataset":
        """Returns a labelled dataset, with units in the attributes: temperature (time, channel),
        state (time, node), duty (time, cell), channel_range, channel_std, and with a plate
        plate_range and plate_std (time). If they are known, recorded (time, channel),
        recorded_range, recorded_std and ambient (time) follow."""
        experiment = self.experiment
        variables = {
            "temperature": ("time channel", self.temperatures, "degC"),
            "state": ("time node", self.states, "degC"),
            "duty": ("time cell", experiment.duty, "1"),
            "time": ("time", self.time, "s"),
        }
        uniformities = {"channel": self.uniformity}
        if self.elements:
            uniformities["plate"] = self.plate_uniformity
        if experiment.temperatures is not None:
            variables["recorded"] = ("time channel", experiment.temperatures, "degC")
            uniformities["recorded"] = self.recorded_uniformity
        for prefix, over_channels in uniformities.items():
            variables[f"{prefix}_range"] = ("time", over_channels.range, "K")
            variables[f"{prefix}_std"] = ("time", over_channels.std, "K")
        if experiment.ambient is not None:
            ambient = np.broadcast_to(experiment.ambient, self.time.shape)
            variables["ambient"] = ("time", ambient, "degC")
        return dataset(
            variables,
            {"rig": self.rig, "experiment": experiment.name},
            channel=self.channels,
            node=self.nodes,
            cell=experiment.cell_names,
        )

    def to_dataframe(self) -> "pandas.DataFrame":
        """Returns a table with a row for each time, s, and a column for each channel, degC."""
        readings = dict(zip(self.channels, self.temperatures.T, strict=True))
        return table({"time": self.time, **readings}, "time")

    def plot(self) -> "Figure":
        """Plots the run beside its recording (`jaxtwin.plots.plot_comparison`), or above its duty
        if nothing was recorded (`jaxtwin.plots.plot_recordings`)."""
        if self.experiment.temperatures is not None:
            return picture("plot_comparison", [self])
        title = f"{self.experiment.name or self.rig}, simulated"
        return picture("plot_recordings", [replace(self._as_recorded(), name=title)])

    def _as_recorded(self) -> Experiment:
        return replace(self.experiment, channels=self.channels, temperatures=self.temperatures)

    def to_recording(
        self, *, noise: float | int | None = None, seed: int = 0, name: str = ""
    ) -> Experiment:
        """The run as a recording of its rig: the simulated readings with noise, for trying out a
        match or an experiment before there is one. It has all inputs of the rig.

        **Arguments:**

        - `noise`: standard deviation of the noise of each reading, K; None: that of the rig's
          camera or sensors.
        - `seed`: the seed of the noise.
        - `name`: the name of the recording; empty: that of the experiment.

        **Raises:** `SimulationError` for noise that is not a number of at least 0, or if it is None
        and the run has no twin.
        """
        if noise is None and self.twin is None:
            raise SimulationError(
                "to_recording: noise: expected a number, in K, for a part of a run, got none"
            )
        size = self.twin.rig.noise if noise is None and self.twin is not None else noise
        sd = finite_number("to_recording: noise", size, SimulationError, least=0, unit="K")
        known = () if self.twin is None else self.twin.rig.inputs
        random = np.random.default_rng(whole_number("to_recording: seed", seed, 0, SimulationError))
        return Experiment(
            self.time,
            self.experiment.duty,
            cells=self.experiment.cells,
            channels=self.channels,
            temperatures=self.temperatures + random.normal(0.0, sd, self.temperatures.shape),
            ambient=self.experiment.ambient,
            inputs={rig_input.name: rig_input.value for rig_input in known}
            | dict(self.experiment.inputs),
            name=name or self.experiment.name,
            group=self.experiment.group,
        )

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the run to a file, whose ending selects the format. If writing fails, the file is
        left as it was.

        **Arguments:**

        - `path`: the file. `.nc` is netCDF with everything that `to_xarray` returns. `.csv` is a
          table of times, duty cycles, simulated readings and the ambient temperature in the form of
          a recording, which `read_recording` reads.

        **Returns:** the path.

        **Raises:** `RecordingError` for another ending, and if the file cannot be written.
        """
        from ..io import write_recording

        if check_ending(path, [".nc", ".csv"], RecordingError) == ".nc":
            return super().save(path)
        return write_recording(self._as_recorded(), Path(path))

    def __repr__(self) -> str:
        low, high = self.temperatures.min(), self.temperatures.max()
        beyond = "".join(f"; {text}" for text in self.beyond_limits)
        return (
            f"<Run of {self.rig}: {len(self.time)} times, {len(self.channels)} channels, "
            f"{low:.2f} to {high:.2f} degC{beyond}>"
        )

    def _overview(self) -> "pandas.DataFrame":
        fits = {} if self.experiment.temperatures is None else self.fit_percent
        return table(
            {
                "channel": self.channels,
                "lowest, degC": self.temperatures.min(axis=0),
                "highest, degC": self.temperatures.max(axis=0),
                "at the end, degC": self.temperatures[-1],
                "fit, %": [fit_text(fits[name]) if name in fits else "-" for name in self.channels],
            }
        )


def _position(name: str, names: tuple[str, ...], kind: str) -> int:
    if name not in names:
        raise SimulationError(
            f"{kind}: expected one of {', '.join(names)}, got {name!r}{did_you_mean([name], names)}"
        )
    return names.index(name)
