"""The result of a design of experiments."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, final

import numpy as np
from jaxtyping import Int

from .._display import picture
from .._result import AbstractResult, dataset, table
from ..io import Experiment, write_recording
from ._schedules import text_of

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

Criterion = Literal["D", "A"]


class DesignStep(NamedTuple):
    """A pass of the search over all steps of the schedule.

    - `start`: the number of the search. `number`: the number of its pass; 0 is its start.
    - `evaluations`: the number of schedules that all searches have evaluated so far.
    - `mean_error`: the mean of the predicted standard errors by the criterion, divided by that of
      today.
    """

    start: int
    number: int
    evaluations: int
    mean_error: float

    def __str__(self) -> str:
        return (
            f"search {self.start + 1}, pass {self.number}: {self.evaluations} schedules, errors "
            f"{100 * self.mean_error:.1f} % of today's"
        )


@final
@dataclass(frozen=True, eq=False)
class PlannedSchedule:
    """A schedule, with the information that would be available after its recording.

    **Arguments:**

    - `name`: the name of the schedule.
    - `experiment`: its duty cycles, without recorded temperatures.
    - `counts`: PWM counts of each step and cell.
    - `standard_errors`: parameter -> predicted standard error in its unit, of a match of today's
      recordings together with this one.
    - `mean_error`: the mean of these errors by the criterion, divided by that of today.
    - `highest_reading`, `highest_side`: the highest temperatures of a channel and of a cell's side
      in the simulation, degC.
    - `is_allowed`: whether they stay below the limits of the rig.
    """

    name: str
    experiment: Experiment
    counts: Int[np.ndarray, "steps cells"]
    standard_errors: Mapping[str, float]
    mean_error: float
    highest_reading: float
    highest_side: float
    is_allowed: bool


@final
@dataclass(frozen=True, repr=False, eq=False)
class ExperimentDesign(AbstractResult):
    """A duty schedule whose recording is the most informative about a rig.

    **Arguments:**

    - `rig`: name of the rig.
    - `criterion`: `"D"` or `"A"`.
    - `names`: the parameters of interest. `units`, `values`: their units and values.
    - `standard_errors`: parameter -> standard error of today; infinite if nothing is known.
    - `best`: the designed schedule.
    - `references`: name -> schedule of the same duration and bounds to compare with: the steps of
      each recording, and a pseudo-random binary sequence.
    - `hold`: duration of a step, s.
    - `history`: the passes of the search.
    """

    rig: str
    criterion: Criterion
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: tuple[float, ...]
    standard_errors: Mapping[str, float]
    best: PlannedSchedule
    references: Mapping[str, PlannedSchedule]
    hold: float
    history: tuple[DesignStep, ...]

    @property
    def schedule(self) -> Experiment:
        """The designed schedule: `simulate`, `live.drive` and `jaxtwin drive --plan` take it."""
        return self.best.experiment

    @property
    def text(self) -> str:
        """The schedule in words, as `Experiment.schedule` and `jaxtwin drive --duty` take it."""
        return text_of(self.schedule)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the schedule as .csv or .nc, for `jaxtwin drive --plan`.

        **Returns:** the path.

        **Raises:** `RecordingError` for another ending, or if it cannot be written.
        """
        return write_recording(self.schedule, Path(path))

    def plot(self) -> "Figure":
        """Plots the schedule, and the standard errors of today, after it and after the references:
        `jaxtwin.plots.plot_design`."""
        return picture("plot_design", self)

    def summary(self) -> str:
        """The predicted standard errors, the highest temperatures, and the schedule in words."""
        reading, side = self.best.highest_reading, self.best.highest_side
        hottest = f"highest reading {reading:.1f} degC, highest cell side {side:.1f} degC"
        return "\n".join([super().summary(), hottest, self.text])

    def to_dataframe(self) -> "pandas.DataFrame":
        """A table with a row for each parameter (its name is the index): unit, value, and the
        standard errors today, after the designed recording, and after each of the references."""
        columns: dict[str, Any] = {"parameter": self.names, "unit": self.units}
        columns["value"] = self.values
        for schedule, errors in self._all_errors().items():
            columns[schedule] = [errors[name] for name in self.names]
        return table(columns, "parameter")

    def to_xarray(self) -> "xarray.Dataset":
        """Standard errors (schedule, parameter), today's being the first, and the designed duty
        (time, cell)."""
        errors, schedule = self._all_errors(), self.schedule
        numbers = [[of[name] for name in self.names] for of in errors.values()]
        return dataset(
            {
                "standard_error": ("schedule parameter", numbers),
                "duty": ("time cell", schedule.duty, "1"),
                "unit": ("parameter", self.units),
                "time": ("time", schedule.time, "s"),
            },
            {"rig": self.rig, "criterion": self.criterion, "hold_s": self.hold},
            schedule=list(errors),
            parameter=self.names,
            cell=schedule.cell_names,
        ).set_coords("unit")

    def _for_json(self) -> dict[str, Any]:
        return {
            "rig": self.rig,
            "criterion": self.criterion,
            "schedule": self.text,
            "duration_s": self.schedule.duration,
            "hold_s": self.hold,
            "highest_reading_degC": self.best.highest_reading,
            "mean_error": {
                planned.name: planned.mean_error if planned.is_allowed else None
                for planned in (self.best, *self.references.values())
            },
            "standard_errors": self._all_errors(),
        }

    def _all_errors(self) -> dict[str, Mapping[str, float]]:
        references = {name: planned.standard_errors for name, planned in self.references.items()}
        return {"today": self.standard_errors, "designed": self.best.standard_errors} | references

    def _overview(self) -> "pandas.DataFrame":
        rows = self.to_dataframe().rename_axis("standard error")
        return rows.filter([*self._all_errors(), "unit"])

    def __repr__(self) -> str:
        compared = ", ".join(
            f"{name} {100 * planned.mean_error:.3g} %{'' if planned.is_allowed else ' (too hot)'}"
            for name, planned in self.references.items()
        )
        return (
            f"<ExperimentDesign of {self.rig}: {self.schedule.duration:g} s in "
            f"{len(self.best.counts)} steps, errors {100 * self.best.mean_error:.3g} % of today's "
            f"({self.criterion}-optimal; {compared})>"
        )
