r"""The design of an experiment that tells faults apart: its result, and what a schedule would say
of which fault a rig has.

The fault is there from the start of the schedule. With the signatures of the faults in the
innovations of a healthy observer (`jaxtwin.diagnosis._isolability`), the logarithm of the odds of
each fault against each other one, whatever its size, has a mean that grows with time. Two faults
are told apart when it has passed $\log 20$ in both directions.
"""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from jaxtyping import Float, Int

from .._display import picture
from .._jax_settings import own_settings
from .._result import AbstractResult, dataset, table
from ..diagnosis import TIE, Faults, chosen, evidence_of, grams_of, suspected
from ..errors import MatchError
from ..io import Experiment, write_recording
from ..matching import Fit
from ..observers import (
    Observed,
    ProcessNoise,
    filter_for,
    filtered,
    first_reading,
    samples_of,
    started,
    usual_noise,
)
from ..physics import Twin
from ..simulation import simulate
from ._schedules import Counts, Schedules, text_of

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


@final
class SeparationStep(NamedTuple):
    """A pass of the search over all steps of the schedule.

    - `start`: the number of the search. `number`: the number of its pass; 0 is its start.
    - `evaluations`: the number of schedules that all searches have evaluated so far.
    - `separation`: the time after which the faults are told apart, s; infinite if they are not.
    """

    start: int
    number: int
    evaluations: int
    separation: float

    def __str__(self) -> str:
        return (
            f"search {self.start + 1}, pass {self.number}: {self.evaluations} schedules, told "
            f"apart {_after(self.separation)}"
        )


@final
@dataclass(frozen=True, eq=False)
class PlannedTest:
    """A schedule, and how soon it would tell faults apart.

    **Arguments:**

    - `name`: the name of the schedule.
    - `experiment`: its duty cycles, without recorded temperatures.
    - `counts`: PWM counts of each step and cell.
    - `separation`: the time after which all faults are told apart, s; infinite if they are not.
    - `time`, `odds`: the mean logarithm of the odds between the two faults that are the hardest to
      tell apart, over time since the start, s.
    - `hardest`: the names of those two at the end.
    - `highest_reading`, `highest_side`: the highest temperatures of a channel and of a cell's side
      in the simulation of the healthy rig, degC.
    - `is_allowed`: whether they stay below the limits of the rig.
    """

    name: str
    experiment: Experiment
    counts: Int[np.ndarray, "steps cells"]
    separation: float
    time: Float[np.ndarray, " times"]
    odds: Float[np.ndarray, " times"]
    hardest: tuple[str, str]
    highest_reading: float
    highest_side: float
    is_allowed: bool


@final
@dataclass(frozen=True, repr=False, eq=False)
class DiagnosisDesign(AbstractResult):
    """A duty schedule that tells faults apart as soon as possible.

    **Arguments:**

    - `rig`: name of the rig. `faults`: the names of the faults.
    - `best`: the designed schedule.
    - `references`: name -> schedule of the same duration and bounds to compare with: the best one
      of a single level, and a pseudo-random binary sequence.
    - `hold`: duration of a step, s.
    - `history`: the passes of the search.
    """

    rig: str
    faults: tuple[str, ...]
    best: PlannedTest
    references: Mapping[str, PlannedTest]
    hold: float
    history: tuple[SeparationStep, ...]

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

    def summary(self) -> str:
        """After what time each schedule tells the faults apart, and the schedule in words."""
        lines = [f"{self.rig}: {', '.join(self.faults)}"]
        for candidate in self._planned():
            too_hot = "" if candidate.is_allowed else " (too hot)"
            lines.append(f"  {candidate.name}: told apart {_after(candidate.separation)}{too_hot}")
        return "\n".join([*lines, self.text])

    def plot(self) -> "Figure":
        """Plots the schedule, and the odds over time, of it and of the references:
        `jaxtwin.plots.plot_design`."""
        return picture("plot_design", self)

    def to_dataframe(self) -> "pandas.DataFrame":
        """A table with a row for each schedule: the time after which the faults are told apart, the
        two that are the hardest, their odds at the end, the highest temperatures, and whether it is
        allowed."""
        rows = [
            {
                "schedule": candidate.name,
                "separation_s": candidate.separation,
                "hardest": " and ".join(candidate.hardest),
                "odds": float(candidate.odds[-1]),
                "highest_reading_degC": candidate.highest_reading,
                "highest_side_degC": candidate.highest_side,
                "is_allowed": candidate.is_allowed,
            }
            for candidate in self._planned()
        ]
        return table(rows, "schedule")

    def to_xarray(self) -> "xarray.Dataset":
        """The odds (schedule, since_start), the times of separation (schedule), and the designed
        duty (time, cell)."""
        planned, schedule = self._planned(), self.schedule
        return dataset(
            {
                "odds": ("schedule since_start", [candidate.odds for candidate in planned], "1"),
                "separation": ("schedule", [candidate.separation for candidate in planned], "s"),
                "duty": ("time cell", schedule.duty, "1"),
                "since_start": ("since_start", self.best.time, "s"),
                "time": ("time", schedule.time, "s"),
            },
            {"rig": self.rig, "faults": list(self.faults), "hold_s": self.hold},
            schedule=[candidate.name for candidate in planned],
            cell=schedule.cell_names,
        )

    def _for_json(self) -> dict[str, Any]:
        return {
            "rig": self.rig,
            "faults": list(self.faults),
            "schedule": self.text,
            "duration_s": self.schedule.duration,
            "hold_s": self.hold,
            "highest_reading_degC": self.best.highest_reading,
            "hardest": list(self.best.hardest),
            "separation_s": {
                candidate.name: candidate.separation if candidate.is_allowed else None
                for candidate in self._planned()
            },
        }

    def _planned(self) -> list[PlannedTest]:
        return [self.best, *self.references.values()]

    def __repr__(self) -> str:
        return (
            f"<DiagnosisDesign of {self.rig}: {', '.join(self.faults)} told apart "
            f"{_after(self.best.separation)}>"
        )


def _after(separation: float) -> str:
    return f"after {separation:.3g} s" if math.isfinite(separation) else "not until the end"


# The smallest odds that count as more than rounding, as a logarithm.
MIN_LOG_ODDS = 1e-9


@final
class SeparationEvidence(NamedTuple):
    """What a schedule would say.

    - `time`: since its start, s. `odds`: the mean logarithm of the odds of the two faults that are
      the hardest to tell apart.
    - `separation`: the time after which all are told apart, s; infinite if not until the end.
    - `hardest`: the names of those two.
    - `reading`, `side`: the highest temperature of a channel, and of a cell's side, degC.
    """

    time: Float[np.ndarray, " times"]
    odds: Float[np.ndarray, " times"]
    separation: float
    hardest: tuple[str, str]
    reading: float
    side: float

    @property
    def objective(self) -> float:
        """What is minimised: the separation, or, if there is none, the duration and more, the less
        is known at the end."""
        if math.isfinite(self.separation):
            return self.separation
        return float(self.time[-1]) * (
            1 + math.log(math.log(TIE) / max(self.odds[-1], MIN_LOG_ODDS))
        )


@final
class EvidenceProblem:
    """Everything on which the evidence depends, except the schedule.

    **Arguments:**

    - `fit`: a fit, or a twin whose values are taken as exact.
    - `faults`: two or more, as for `jaxtwin.diagnose`.
    - `noise`: the noise of its observer; None: usual levels.
    - `schedules`: the schedules, which share a time grid.

    **Raises:** `MatchError` for fewer than two faults; `ObserverError` for unknown ones.
    """

    def __init__(
        self, fit: Twin | Fit, faults: Faults, noise: ProcessNoise | None, schedules: Schedules
    ):
        self.twin = fit.mean_twin if isinstance(fit, Fit) else fit
        suspects = chosen(self.twin, faults, self.twin.channels)
        if len(suspects) < 2:
            raise MatchError(
                "design_experiment: faults: expected two or more that are to be told apart, got "
                f"{', '.join(suspect.name for suspect in suspects) or 'none'}"
            )
        self.names = tuple(suspect.name for suspect in suspects)
        template = simulate(self.twin, schedules.numbered()).to_recording(noise=0.0)
        levels = usual_noise(fit, [template]) if noise is None else noise
        self._kalman = filter_for(fit, template, levels)
        self._arrays = suspected(self._kalman.model, suspects)
        rig, index = self.twin.rig, self.twin.netlist.index
        sides = [f"{cell.name}.{side}" for cell in rig.cells for side in ("TC", "TH")]
        self._sides = [index[name] for name in sides]

    def evaluate(self, schedules: Schedules, counts: Sequence[Counts]) -> list[SeparationEvidence]:
        """Evaluates several schedules."""
        return [self._of(schedules.experiment(count)) for count in counts]

    def _of(self, schedule: Experiment) -> SeparationEvidence:
        run = simulate(self.twin, schedule)
        recording = run.to_recording(noise=0.0)
        kalman = self._kalman
        samples, is_sample = samples_of(kalman, recording)
        with own_settings():
            first = np.asarray(first_reading(recording))
            start = started(kalman, first, np.zeros_like(samples.duty[0]))
            followed = filtered(kalman, start, samples)
        observed = Observed(recording, kalman, samples, is_sample, followed)
        grams, time = grams_of(observed, self._arrays, 0.0)
        odds = evidence_of(grams)
        odds[:, *np.diag_indices(len(self.names))] = math.inf
        hardest = np.unravel_index(int(np.argmin(odds[-1])), odds.shape[1:])
        least = odds.min(axis=(1, 2))
        return SeparationEvidence(
            time=time,
            odds=least,
            separation=_crossing(time, least),
            hardest=(self.names[int(hardest[0])], self.names[int(hardest[1])]),
            reading=float(run.temperatures.max()),
            side=float(run.states[:, self._sides].max(initial=-math.inf)),
        )


def _crossing(time: Float[np.ndarray, " times"], odds: Float[np.ndarray, " times"]) -> float:
    """The time at which the odds pass 20, between two samples by a line."""
    enough = math.log(TIE)
    if odds[-1] < enough:
        return math.inf
    at = int(np.argmax(odds >= enough))
    return float(np.interp(enough, [0.0, *odds[: at + 1]], [0.0, *time[: at + 1]]))
