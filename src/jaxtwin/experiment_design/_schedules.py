"""Duty schedules of equal steps: those among which the search chooses, and others for comparison.

A schedule is a table of PWM counts, `(steps, cells)`. Each step is held for the same time, so all
schedules have the same time grid and run through the same compiled program.
"""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float, Int

from .._arguments import finite_number, whole_number
from ..errors import MatchError
from ..io import Experiment
from ..physics import Twin

# Duration of the longest schedule, s.
MAX_SECONDS = 3600.0

# Amplitudes of the random binary sequence; the first that does not get too hot is used.
AMPLITUDES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)

Counts = Int[np.ndarray, "steps cells"]


@final
@dataclass(frozen=True)
class Schedules:
    """The schedules among which a design is searched.

    - `twin`: the twin with the values at which they are simulated.
    - `hold`: the duration of a step, s. `steps`: the number of steps.
    - `counts`: the counts of the driver at full duty.
    - `levels`: the counts among which the search chooses for each cell and heater, increasing; as
      many for each.
    - `interval`: the time between two samples, s.
    """

    twin: Twin
    hold: float
    steps: int
    counts: int
    levels: tuple[tuple[int, ...], ...]
    interval: float

    @property
    def cells(self) -> int:
        """The number of cells."""
        return len(self.twin.rig.driven)

    @property
    def constant(self) -> "list[Counts]":
        """Schedules that hold a single level, of all cells and heaters the n-th of their own."""
        return [np.tile(level, (self.steps, 1)) for level in np.transpose(self.levels)]

    @property
    def duration(self) -> float:
        """The time from the first sample to the last, s."""
        return self.hold * self.steps

    def experiment(self, counts: Counts, name: str = "") -> Experiment:
        """A schedule as an experiment without recorded temperatures."""
        return self._experiment(counts / self.counts, name)

    def binary_sequences(self) -> "list[Counts]":
        """The sequence of each of the `AMPLITUDES`, the largest first."""
        return [self.binary_sequence(amplitude) for amplitude in AMPLITUDES]

    def numbered(self) -> Experiment:
        """A schedule in which the duty of every step is its number divided by the number of
        steps."""
        numbers = np.arange(1, self.steps + 1) / self.steps
        return self._experiment(np.repeat(numbers[:, None], self.cells, axis=1))

    def _experiment(self, duty: Float[np.ndarray, "steps cells"], name: str = "") -> Experiment:
        time = self.interval * np.arange(round(self.duration / self.interval) + 1)
        held = np.minimum((time + 1e-9) // self.hold, self.steps - 1).astype(int)
        return Experiment(
            time,
            duty[held],
            cells=self.twin.rig.driven,
            channels=self.twin.channels,
            name=name,
        )

    def resampled(self, experiment: Experiment) -> Counts:
        """The duty of another experiment in the middle of each step, within the bounds. After the
        end of that experiment it is its last duty."""
        middle = experiment.time[0] + self.hold * (np.arange(self.steps) + 0.5)
        at = np.searchsorted(experiment.time, middle, side="right") - 1
        rounded = np.rint(experiment.duty[at] * self.counts).astype(int)
        ends = np.array(self.levels)
        return np.clip(rounded, ends[:, 0], ends[:, -1])

    def binary_sequence(self, amplitude: float = 1.0) -> Counts:
        """A pseudo-random binary sequence between the bounds. With an amplitude below 1, both are
        moved towards the duty between them that is nearest to 0.

        It is the sequence of the longest period of a linear feedback shift register with as few
        bits as the number of steps needs (Godfrey, Perturbation Signals for System Identification,
        1993). Each cell has a different part of it.
        """
        from scipy.signal import max_len_seq  # which takes a third of a second to import

        sequence, _ = max_len_seq(max(2, self.steps.bit_length()))
        ends = np.array(self.levels)[:, [0, -1]].T
        least = np.clip(0, *ends)
        low, high = least + (amplitude * (ends - least)).astype(int)
        shift = len(sequence) // self.cells
        columns = [np.resize(np.roll(sequence, -shift * c), self.steps) for c in range(self.cells)]
        return np.where(np.stack(columns, axis=1) > 0, high, low)


def text_of(schedule: Experiment) -> str:
    """A schedule in words, as `Experiment.schedule` and `jaxtwin drive --duty` take it."""
    switches = np.concatenate([[0.0], schedule.switch_times])
    at = np.searchsorted(schedule.time, switches - 1e-9)
    rows = schedule.duty[at]
    return ",".join(
        f"{time:g}:{'/'.join(f'{duty:.6g}' for duty in row)}"
        for time, row in zip(switches, rows, strict=True)
    )


def make_schedules(
    twin: Twin,
    *,
    duration: float | int,
    hold: float | int,
    bounds: tuple[float, float],
    levels: int,
    interval: float,
) -> Schedules:
    """Checks the settings of a design, and makes its schedules.

    **Raises:** `MatchError` if a time, a bound or the number of levels is not allowed.
    """
    for name, value in (("duration", duration), ("hold", hold)):
        finite_number(f"design_experiment: {name}", value, MatchError)
    if not 0 < duration <= MAX_SECONDS:
        raise MatchError(
            f"design_experiment: duration: expected above 0 and at most {MAX_SECONDS:.10g} s, got "
            f"{duration:g} s; design several recordings one after the other"
        )
    steps = round(duration / hold) if hold > 0 else 0
    if steps < 1 or abs(steps * hold - duration) > 1e-6 * duration:
        raise MatchError(
            f"design_experiment: hold: expected a time that divides the duration of {duration:g} "
            f"s, got {hold:.10g} s"
        )
    if abs(round(hold / interval) * interval - hold) > 1e-6 * hold:
        raise MatchError(
            f"design_experiment: hold: expected a multiple of the {interval:.10g} s between two "
            f"samples, got {hold:.10g} s"
        )
    low, high = _checked_bounds(bounds)
    rig = twin.rig
    if rig.heaters and (high <= 0 or (low < 0 and not rig.cells)):
        raise MatchError(
            f"design_experiment: bounds: expected {'more than 0' if rig.cells else '0 or more'}, "
            f"because the heaters of {rig.name} cannot cool, got {low:.10g} to {high:.10g}"
        )
    whole_number("design_experiment: levels", levels, 2, MatchError)
    counts = rig.driver.counts
    lowest = np.maximum(low, rig.lowest_duty)
    table = np.rint(np.linspace(lowest, high, levels) * counts).astype(int).T
    own = [np.unique(row) for row in table]
    # With few counts levels coincide, first those of a heater, which lie closer together.
    number = min(map(len, own))
    chosen = [row[np.rint(np.linspace(0, len(row) - 1, number)).astype(int)] for row in own]
    if number < 2:
        raise MatchError(
            f"design_experiment: bounds: expected at least two of the driver's {counts} counts "
            f"between them, got {low:.10g} to {high:.10g}"
        )
    return Schedules(
        twin=twin,
        hold=float(hold),
        steps=steps,
        counts=counts,
        levels=tuple(tuple(row.tolist()) for row in chosen),
        interval=float(interval),
    )


def _checked_bounds(bounds: tuple[float, float]) -> tuple[float, float]:
    try:
        low, high = (float(bound) for bound in bounds)
    except (TypeError, ValueError):
        low, high = np.nan, np.nan
    if not -1 <= low < high <= 1:
        raise MatchError(
            "design_experiment: bounds: expected the lowest and the highest duty cycle, such as "
            f"(-0.5, 0.8), within -1 to 1, got {bounds!r}"
        )
    return low, high
