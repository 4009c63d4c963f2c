"""The result of a simulated closed loop."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Float

from ..._display import picture
from ..._jax_settings import own_settings
from ..._result import AbstractResult, dataset, table
from ..._whole_file import check_ending
from ...errors import ControlError, RecordingError
from ...io import Experiment
from ...physics import Twin
from ...simulation import Run
from ..controllers._controller import TemperatureLimit
from ._measures import SETTLING_BAND, ClosedLoop, measures_of, saturation_shares
from ._soft_limits import ExceededLimit, exceeded_soft_limits

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


# The last part of a run, in which references that do not change should be held.
LAST_PART = 0.25

# An output swings if it crosses its mean so often in the last part.
CROSSINGS = 4

# An error that is below this part of what it was a quarter of the run before becomes smaller.
COMES_NEARER = 0.9


def unsettled(loop: Any, outputs: Sequence[str]) -> tuple[str, ...]:
    """Describes in a sentence each output that swings at the end of a run, stays away from its
    reference, or drifts away from it: gains that are too large, cells that heat the output of
    another, a sample time that is too long, or a duty at its limit.

    A run whose references change in its last half says nothing. Swings of less than twice the
    settling band (0.5 K), and errors of less than twice the band, are none. An output drifts if the
    line through its errors in the last quarter of the run leads away from the reference, by more
    than the band in a time as long as the run, and then is more than twice the band away.

    **Arguments:**

    - `loop`: a `ClosedLoop`.
    - `outputs`: the names of the outputs.
    """
    reference, output = np.asarray(loop.reference), np.asarray(loop.output)
    count = len(reference)
    last, half = count - int(LAST_PART * count), count // 2
    if last <= half or np.ptp(reference[half:], axis=0).any():
        return ()
    sentences = []
    for name, error in zip(outputs, (output - reference).T, strict=True):
        end, before = error[last:], error[half:last]
        swing = float(np.ptp(end))
        crossings = np.count_nonzero(np.diff(np.sign(end - end.mean())))
        if swing > 2 * SETTLING_BAND and crossings >= CROSSINGS:
            sentences.append(f"{name} swings by {swing:.1f} K at the end")
        elif min(abs(end)) > 2 * SETTLING_BAND and abs(end[-1]) > COMES_NEARER * abs(before[0]):
            side = "above" if end[-1] > 0 else "below"
            sentences.append(f"{name} stays {abs(end[-1]):.1f} K {side} its reference")
        else:
            slope, now = np.polyfit(np.arange(len(end)) - len(end) + 1, end, 1)
            moved, later = slope * count, now + slope * count
            # A line towards the reference is an approach.
            is_away = abs(moved) > SETTLING_BAND and moved * now > 0
            if is_away and abs(later) > 2 * SETTLING_BAND:
                side = "above" if later > 0 else "below"
                sentences.append(
                    f"{name} drifts, now {abs(now):.1f} K {side} its reference and "
                    f"{abs(later):.1f} K after as long again"
                )
    return tuple(sentences)


@final
@dataclass(frozen=True, repr=False, eq=False)
class ClosedLoopRun(AbstractResult):
    """A simulated closed loop.

    **Arguments:**

    - `run`: the twin's run under the commanded duty; its temperatures have no noise.
    - `loop`: the signals from which measures are computed.
    - `outputs`: names of the controlled temperatures.
    - `limits`: the temperature limits of the controller, by channel.
    - `switched_off`: the time from which the cells are off, because no reading came for too long,
      s; None if they are controlled to the end.
    - `is_linear`: whether the controller is linear within its limits.
    """

    run: Run
    loop: ClosedLoop
    outputs: tuple[str, ...]
    limits: Mapping[str, TemperatureLimit] = field(default_factory=dict)
    switched_off: float | None = None
    is_linear: bool = False

    @classmethod
    def of(
        cls,
        twin: Twin,
        loop: ClosedLoop,
        outputs: tuple[str, ...],
        ambient: Float[np.ndarray, " times"],
        limits: Mapping[str, TemperatureLimit],
        switched_off: float | None,
        *,
        is_linear: bool,
    ) -> "ClosedLoopRun":
        """Adds the names of a twin to the signals of a loop."""
        experiment = Experiment(
            loop.time,
            loop.duty,
            cells=twin.rig.driven,
            channels=twin.channels,
            ambient=ambient,
            name="closed loop",
        )
        run = Run(
            experiment=experiment,
            channels=twin.channels,
            temperatures=np.asarray(loop.temperatures),
            nodes=tuple(node.name for node in twin.netlist.nodes),
            states=np.asarray(loop.nodes),
            rig=twin.rig.name,
            elements=loop.elements,
            twin=twin,
        )
        return cls(run, loop, outputs, limits, switched_off, is_linear)

    @property
    def time(self) -> Float[np.ndarray, " times"]:
        """Times of the samples, s."""
        return np.asarray(self.loop.time)

    @property
    def reference(self) -> Float[np.ndarray, "times outputs"]:
        """References of the outputs, degC."""
        return np.asarray(self.loop.reference)

    @property
    def output(self) -> Float[np.ndarray, "times outputs"]:
        """The true outputs, degC."""
        return np.asarray(self.loop.output)

    @property
    def measurement(self) -> Float[np.ndarray, "times outputs"]:
        """The outputs as the controller gets them, degC."""
        return np.asarray(self.loop.measurement)[:, : len(self.outputs)]

    @property
    def duty(self) -> Float[np.ndarray, "times cells"]:
        """The duty commanded from each time on, -1 to 1."""
        return np.asarray(self.loop.duty)

    @property
    def power(self) -> Float[np.ndarray, "times cells"]:
        """The power that each cell's bridge draws from the supply, W."""
        return np.asarray(self.loop.power)

    @property
    def energy(self) -> Float[np.ndarray, " times"]:
        """The energy that all cells together have drawn from the supply up to each time, J; by the
        rule of `Run.energy`."""
        return np.asarray(self.loop.energy)

    @property
    def range(self) -> Float[np.ndarray, " times"]:
        """The difference between the hottest and the coldest element of the plate, K.

        **Raises:** `ControlError` for a rig without a plate.
        """
        if not self.loop.elements:
            raise ControlError(
                f"range: expected a closed loop of a rig with a plate, got one of {self.run.rig}"
            )
        return np.ptp(np.asarray(self.loop.plate), axis=1)

    @property
    def exceeded(self) -> tuple[ExceededLimit, ...]:
        """The temperature limits that the true temperatures exceed by more than the controller
        accepts: no duty kept them, heat came that the model did not foresee, or the run began
        beyond them."""
        return exceeded_soft_limits(
            self.limits, self.run.channels, self.time, self.run.temperatures
        )

    @property
    def unsettled(self) -> tuple[str, ...]:
        """The outputs that swing at the end of the run, or stay or drift away from references that
        have not changed in its last half, a sentence for each.

        Swings and errors count from 1 K on, twice the settling band. An output drifts if the line
        through its errors in the last quarter leads away from the reference by more than 0.5 K in a
        time as long as the run, to more than 1 K."""
        return unsettled(self.loop, self.outputs)

    @property
    def saturation_shares(self) -> dict[str, float]:
        """The share of the time in which each cell and heater has a duty at a limit of its own, by
        its name: a heater that is off is at its 0, a cell in full cooling at its -1."""
        with own_settings():
            shares = np.asarray(saturation_shares(self.loop)).tolist()
        return dict(zip(self.run.experiment.cell_names, shares, strict=True))

    def measures(self) -> "pandas.DataFrame":
        """A table with a row for each measure: its name as index, value and unit. With several
        cells and heaters, each has a row of its `saturation_shares`."""
        with own_settings():
            rows = [
                (name, float(function(self.loop)), unit)
                for name, (function, unit) in measures_of(self.loop.elements).items()
            ]
        shares = self.saturation_shares
        if len(shares) > 1:
            rows += [(f"saturation_share {name}", share, "") for name, share in shares.items()]
        return table(rows, "measure", columns=["measure", "value", "unit"])

    def to_xarray(self) -> "xarray.Dataset":
        """The dataset of the run, with reference, measurement and controlled (time, output), power
        (time, cell) and energy (time). If the cells were switched off, its attribute
        `switched_off_s` says when."""
        more = dataset(
            {
                "reference": ("time output", self.reference, "degC"),
                "measurement": ("time output", self.measurement, "degC"),
                "controlled": ("time output", self.output, "degC"),
                "power": ("time cell", self.power, "W"),
                "energy": ("time", self.energy, "J"),
            },
            {} if self.switched_off is None else {"switched_off_s": self.switched_off},
            output=self.outputs,
        )
        return self.run.to_xarray().assign(more).assign_attrs(more.attrs)

    def to_dataframe(self) -> "pandas.DataFrame":
        """A table with a row for each time (s), its index, and columns for references, outputs,
        duty and power by name."""
        columns = {"time": self.time}
        for name, wanted, output in zip(self.outputs, self.reference.T, self.output.T, strict=True):
            columns |= {f"reference {name}": wanted, name: output}
        names = self.run.experiment.cell_names
        for cell, duty, power in zip(names, self.duty.T, self.power.T, strict=True):
            columns |= {f"duty {cell}": duty, f"power {cell}": power}
        return table(columns, "time")

    def plot(self) -> "Figure":
        """Plots outputs, references, duty and power: `jaxtwin.plots.plot_closed_loop`."""
        return picture("plot_closed_loop", self)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the run, as a whole or not at all: a .nc file with the contents of `to_xarray`, or
        a .csv file as `Run.save` writes it.

        **Returns:** the path.

        **Raises:** `RecordingError` if the file name has another ending or the file cannot be
        written.
        """

        if check_ending(path, [".nc", ".csv"], RecordingError) == ".nc":
            return super().save(path)
        return self.run.save(path)

    def __repr__(self) -> str:
        ends = ", ".join(
            f"{name} {output:.2f} (reference {reference:.2f})"
            for name, output, reference in zip(
                self.outputs, self.output[-1], self.reference[-1], strict=True
            )
        )
        events = [str(limit) for limit in self.exceeded]
        if self.switched_off is not None:
            events.insert(0, f"cells off from {self.switched_off:g} s, for want of readings")
        elif self.unsettled:
            hint = ["loop_margins says whether the loop is stable"] if self.is_linear else []
            events += [*self.unsettled, *hint]
        return (
            f"<ClosedLoopRun of {self.run.rig}: {len(self.time)} times, at the end {ends} degC, "
            f"{self.energy[-1] / 3600:.2f} Wh{''.join(f'; {event}' for event in events)}>"
        )

    def _overview(self) -> "pandas.DataFrame":
        return self.measures()
