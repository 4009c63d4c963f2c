"""The steps of `rodas5p.c` for an experiment.

Right after an input changes, steps are short and grow fast, because the sides of a cell may settle
within milliseconds; from then on they are in proportion to the time since the change.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import final

import numpy as np
from jaxtyping import Float

from .._jax_settings import own_settings
from ..io import Experiment
from ..physics import Twin
from ..rig import Input
from ._compressed import CompressedRecording, compress
from ._held_inputs import held_quadratics
from ._time_grid import StepRule, TimeGrid, build_time_grid, settling_after_reversals

# The steps right after an input change, s: up to a quarter of a second, each ends four times as
# late as the one before.
RAMP = tuple(float(step) for step in np.array([1, 3, 12, 48, 192]) / 1024)

# The ratio of a step to the time since that change, and the longest step, s.
GROWTH, LARGEST_STEP = 0.36, 256.0

# As those of `_time_grid`, s.
REACH, LEAST_REACH = 1.0, 1.6

# The integral of a jump within a step, times the rate at which channels answer, above which the
# step is cut there, K.
LATE_ROUGHNESS = 2e-4

# The steps before the first command arrives, as fractions of the driver's delay.
STEPS_BEFORE_COMMAND = np.array([1, 1, 2, 4, 8, 16]) / 32

# The number of coefficients of a temperature within a step, as in `rodas5p.c`.
POWERS = 6


@lru_cache(maxsize=64)
def commanded_steps(
    experiment: Experiment,
    lags: bool,
    refinement: int,
    inputs: tuple[tuple[Input, bool], ...] = (),
    rates: tuple[float, ...] = (),
    lateness: float = 0.0,
) -> TimeGrid:
    """The steps before any delay.

    **Arguments:**

    - `lags`: whether the driver has a lag.
    - `inputs`, `rates`, `lateness`: as in `build_time_grid`.
    - `refinement`: the number of times that steps are halved.
    """
    part = 0.5**refinement
    rule = StepRule(
        ramp=tuple(part * step for step in RAMP),
        growth=part * GROWTH,
        largest=part * LARGEST_STEP,
        first=part * RAMP[-1],
        doubles=False,
        settling=settling_after_reversals(experiment, lags),
        parts=2**refinement,
        reach=part * REACH,
        least_reach=part * LEAST_REACH,
    )
    return build_time_grid(experiment, rule, inputs, rates, lateness)


@final
@dataclass(frozen=True, eq=False)
class NativeSteps:
    """The steps of a run after the driver's delay.

    - `size`: of each step, s; of the first `waiting`, as fractions of the delay.
    - `duty`: the command that is held during each, -1 to 1.
    - `ambient`: the ambient's deviation from the reference during each, K: the coefficients of a
      quadratic of the part of the step that has passed.
    - `ends`: when each step ends, s; None if that depends on the draw.
    - `levels`: the rig's other inputs during each step, see `input_levels`; None without any.
    """

    size: Float[np.ndarray, " steps"]
    duty: Float[np.ndarray, "steps cells"]
    ambient: Float[np.ndarray, "steps 3"]
    waiting: int
    ends: Float[np.ndarray, " steps"] | None
    levels: Float[np.ndarray, "steps inputs"] | None

    @classmethod
    def of(
        cls, grid: TimeGrid, delay: float | None, *, own_delays: bool, of_room: float = 0.0
    ) -> "NativeSteps | None":
        """Applies a delay to commanded steps; None if the rig's other inputs change, or if a
        recorded ambient temperature changes and the draws differ in the delay.

        **Arguments:**

        - `delay`: that of all draws, s; None without one.
        - `own_delays`: whether the draws differ in it.
        - `of_room`: how fast channels answer to the ambient temperature, 1/s (`input_rates`).
        """
        lengths = np.asarray(grid.sizes)[np.asarray(grid.size)]
        moves = lengths > 0
        size, duty = lengths[moves], np.asarray(grid.duty)[moves]
        at = None if grid.ambient_at is None else np.asarray(grid.ambient_at)
        ambient = np.zeros((len(size), 3))
        if at is not None:
            ambient = _coefficients(np.asarray(grid.ambient)[moves] - at[0])
        levels = None if grid.levels is None else np.asarray(grid.levels)[moves]
        if delay is None and not own_delays:
            return cls(size, duty, ambient, 0, np.cumsum(size), levels)
        if levels is not None:
            if np.any(levels != levels[0]):
                return None
            levels = np.repeat(levels[:1], len(STEPS_BEFORE_COMMAND) + len(size), axis=0)
        first = duty[:1] if grid.steady_start else np.zeros_like(duty[:1])
        duty = np.concatenate([np.repeat(first, len(STEPS_BEFORE_COMMAND), axis=0), duty])
        whole = np.concatenate([STEPS_BEFORE_COMMAND, size])
        changes = at is not None and bool(np.any(at != at[0]))
        if own_delays or delay is None:
            none = np.zeros((len(whole), 3))
            return (
                None if changes else cls(whole, duty, none, len(STEPS_BEFORE_COMMAND), None, levels)
            )
        ends = np.cumsum(np.concatenate([STEPS_BEFORE_COMMAND * delay, size]))
        ambient = np.zeros((len(whole), 3))
        if changes and at is not None:
            # The delay moves steps across jumps of the room. Long ones are cut there.
            jumps, times = np.abs(np.diff(at)), np.asarray(grid.times)[1:]
            cut = np.minimum(np.searchsorted(ends, times), len(ends) - 1)
            rough = of_room * jumps * np.diff(ends, prepend=0.0)[cut] / 8
            cuts = times[(rough > LATE_ROUGHNESS) & (cut >= len(STEPS_BEFORE_COMMAND))]
            cuts = cuts[np.abs(ends[:, None] - cuts).min(axis=0, initial=np.inf) > 1e-6]
            ends, before = np.union1d(ends, cuts), ends
            cut = np.minimum(np.searchsorted(before, ends - 1e-9), len(before) - 1)
            duty, levels = duty[cut], None if levels is None else levels[cut]
            sizes = np.diff(ends, prepend=0.0)
            whole = np.concatenate([STEPS_BEFORE_COMMAND, sizes[len(STEPS_BEFORE_COMMAND) :]])
            ambient = _coefficients(held_quadratics(np.asarray(grid.times), at - at[0], sizes))
        return cls(whole, duty, ambient, len(STEPS_BEFORE_COMMAND), ends, levels)

    def compressed(
        self, grid: TimeGrid, recorded: Float[np.ndarray, "times channels"]
    ) -> CompressedRecording | None:
        """A recording in rows of weights for the powers of the part of a step that has passed; None
        if the steps depend on the draw.

        **Arguments:**

        - `grid`: the steps before the delay.
        - `recorded`: the recorded temperatures, degC.
        """
        if self.ends is None:
            return None
        times, begins = np.asarray(grid.times), np.append(0.0, self.ends[:-1])
        step = np.minimum(np.searchsorted(self.ends, times - 1e-7), len(self.ends) - 1)
        part = np.clip((times - begins[step]) / (self.ends[step] - begins[step]), 0, 1)
        weights = part[:, None] ** np.arange(POWERS)
        return compress(replace(grid, step_of=step.astype(np.int32), weights=weights), recorded)


def shared_delay(twin: Twin) -> float | None:
    """The driver's delay, s; None without one."""
    delay = twin.wiring.delay
    if delay is None:
        return None
    with own_settings():
        return float(delay(twin.values_si)[0])


def _coefficients(values: Float[np.ndarray, "steps 3"]) -> Float[np.ndarray, "steps 3"]:
    """The coefficients of quadratics from their values at the start, in the middle and at the end
    of a step."""
    start, middle, end = values.T
    return np.stack([start, 4 * middle - 3 * start - end, 2 * (start + end) - 4 * middle], axis=1)
