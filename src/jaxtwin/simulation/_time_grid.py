"""The time grid of the exponential solver for an experiment: its steps and its samples, of few
sizes.

Inputs are held between samples. After each change of an input there is little but relaxation (the
driver may have a lag): steps are as short as the transient needs that the change starts, and grow
with the time since then. After a large change, such as that of a duty, they begin with
milliseconds; after a small one, such as that of a room, with seconds (`StepRule`). Steps go on
across changes of inputs that a quadratic describes well enough (`_held_inputs`). If the samples
allow it, all step sizes are a single size times a power of two, so that a run needs the
exponentials of few sizes.
"""

import math
from dataclasses import replace
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import NamedTuple, TypeAlias, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._celsius import ZERO_CELSIUS
from .._padded_rows import padded
from ..errors import SimulationError
from ..io import Experiment
from ..physics import System, Twin
from ..rig import Input
from ._held_inputs import ROUGHNESS, held_quadratics, mean_of, merged_changes, quadratic_at
from ._input_levels import input_changes, input_levels, input_rates, regimes
from ._interpolation import CONSTANT_POLYNOMIALS, sample_weights, step_polynomials

# Step sizes without refinement: the first one, s; the largest one as a part of the time since the
# last change of an input; the largest one, s.
FIRST_STEP, GROWTH, LARGEST_STEP = 0.25, 0.2, 32.0

# The parts of the first step after a large change. Right after it the sides of a cell may settle
# within milliseconds, which hardly affects temperatures elsewhere, but does affect derivatives with
# respect to the resistances of the cell.
FINE = np.array([1, 1, 2, 4, 8, 16, 32, 64, 128]) / 256

# The longest step after a change that moves channels by 1 K/s, s, if no sample is inside. It is
# longer for a smaller change by the fourth root of its rate, and shorter by the factor `INSIDE`
# where samples are inside, between which temperatures are interpolated.
REACH = 1.5

INSIDE = 1 / 3

# Where that step is at least so long, s, the change is a small one: steps begin with this size. A
# large change starts with the short steps of `FINE`.
MIN_REACH = 2.4

# The largest step if the driver has a delay and the rig other inputs, s. The grid moves with the
# delay, so that these inputs change within a step, which takes their mean.
DELAYED_STEP = 0.5

# The largest number of steps without refinement, those of a year. More would fill the memory.
MAX_STEPS = 1_000_000

# The time after a change for which steps keep their first size if the driver has a lag, s. If the
# command is reversed, the duty passes zero within this time for lags of a few seconds, and the heat
# of an on/off drive has a kink there, which a longer step would miss.
SETTLING_SECONDS = 6.0

# The size of a change if it is not known how fast channels answer: that of a large one, K/s.
UNKNOWN_CHANGE = 1.0

# The longest span between two input changes that has equal steps if no sample is inside, s.
SHORT_SPAN = 1.0

# The time after a change, s, from which interpolation does without the slope at the end of a span:
# with it, the errors of 1000 draws between all bounds of each of the paper's rigs are the same over
# spans of 500 s.
SETTLED_SECONDS = 10.0

# The number of these steps within the settling time of a reversal, elsewhere one.
REVERSED_PARTS = 4


@final
class InputSummary(eqx.Module):
    """The inputs of a run on which its modes depend: arrays of one shape for all runs of a rig.

    - `first`, `mean`, `lowest`, `highest`: the first, the mean, the lowest and the highest of the
      commanded duty cycles, -1 to 1.
    - `duration`: the duration of the run, s. `longest_step`: its longest step, s.
    - `ambient`: the recorded ambient temperature at the start, K; None if it is not recorded.
    - `regimes`: see `TimeGrid`.
    """

    first: Float[Array | np.ndarray, " cells"]
    mean: Float[Array | np.ndarray, " cells"]
    lowest: Float[Array | np.ndarray, " cells"]
    highest: Float[Array | np.ndarray, " cells"]
    duration: Float[Array | np.ndarray, ""]
    longest_step: Float[Array | np.ndarray, ""]
    ambient: Float[Array | np.ndarray, ""] | None
    regimes: Float[Array | np.ndarray, "regimes inputs"] | None = None


@final
class TimeGrid(eqx.Module):
    """The time grid of an experiment. All arrays are constants of the run.

    **Arguments:**

    - `times`: the times of the samples since the first one, s.
    - `sizes`: the distinct step sizes, s; 0 for steps that fill the grid up, or end a span.
    - `size`: the index of each step's size.
    - `duty`: the duty that is held during each step, -1 to 1.
    - `ambient`: the recorded ambient temperature at the start, in the middle and at the end of each
      step, K, see `held_quadratics`; None if it is not recorded.
    - `polynomials`: the interpolation within each step.
    - `step_of`: the index of the step that contains each sample of the experiment.
    - `weights`: the weights of the values and slopes around that step in the sample's temperature,
      which are the values of the polynomials at the sample.
    - `ambient_at`: the recorded ambient temperature at each sample, K, or None.
    - `levels`, `levels_at`: the rig's inputs besides the duty, during each step and from each
      sample on: numbers of states, or values in SI units. None for a rig without any.
    - `regimes`: the inputs for which the modes of the network are found. Each step is taken in the
      modes of the nearest of these.
    - `steady_start`: whether the first duty was always held before the start; otherwise the duty
      was 0. It matters for a driver with a lag or a delay.
    - `is_delayed`: whether `duty` is the duty that reaches the cells after the driver's delay;
      otherwise it is the command.
    """

    times: Float[Array | np.ndarray, " times"]
    sizes: Float[Array | np.ndarray, " sizes"]
    size: Int[Array | np.ndarray, " steps"]
    duty: Float[Array | np.ndarray, "steps cells"]
    ambient: Float[Array | np.ndarray, "steps 3"] | None
    polynomials: Float[Array | np.ndarray, "steps data powers"]
    step_of: Int[Array | np.ndarray, " times"]
    weights: Float[Array | np.ndarray, "times data"]
    ambient_at: Float[Array | np.ndarray, " times"] | None
    levels: Float[Array | np.ndarray, "steps inputs"] | None = None
    levels_at: Float[Array | np.ndarray, "times inputs"] | None = None
    regimes: Float[Array | np.ndarray, "regimes inputs"] | None = None
    steady_start: bool = eqx.field(static=True, default=False)
    is_delayed: bool = eqx.field(static=True, default=False)

    def summary(self) -> InputSummary:
        """The summary of the run's inputs and steps."""
        # A grid of NumPy arrays gives NumPy arrays, so that nothing is compiled.
        as_array = np.asarray if isinstance(self.size, np.ndarray) else jnp.asarray
        lengths = self.sizes[self.size]
        duration = lengths.sum()
        return InputSummary(
            first=self.duty[0],
            mean=lengths @ self.duty / duration,
            lowest=self.duty.min(axis=0),
            highest=self.duty.max(axis=0),
            duration=as_array(duration),
            longest_step=as_array(self.sizes.max()),
            ambient=None if self.ambient_at is None else as_array(self.ambient_at[0]),
            regimes=self.regimes,
        )


def time_grid(twin: Twin | System, experiment: Experiment, refinement: int = 0) -> TimeGrid:
    """The default solver's grid for a twin.

    **Arguments:**

    - `twin`: the twin, or its equations.
    - `experiment`: the times, the inputs and the ambient temperature.
    - `refinement`: the number of times that steps are halved.

    **Returns:** the grid, with the commanded duty cycles.
    """
    return build_time_grid(experiment, *twin_steps(twin, refinement))


def reference_temperature(system: System, inputs: InputSummary) -> Float[Array, ""]:
    """The temperature from which deviations are counted: the ambient temperature at the start,
    recorded or that of the rig, K."""
    if inputs.ambient is None:
        return system.ambient_temperature
    return jnp.asarray(inputs.ambient, system.capacitance.dtype)


class StepRule(NamedTuple):
    """The sizes of steps after changes of inputs.

    - `ramp`: the first steps after a large change, s.
    - `growth`: the largest ratio of a step to the time since the last change.
    - `largest`: the largest step, s.
    - `first`: the step behind the ramp, s. `doubles`: whether all later steps are this one times a
      power of two, so that a run needs the exponentials of few sizes; otherwise each longer span
      ends with a step of no length.
    - `settling`: the time after a large change during which steps do not grow, s.
    - `parts`: the number of steps of a span that is too short for growing steps.
    - `reach`, `least_reach`: see `REACH`.
    """

    ramp: tuple[float, ...]
    growth: float
    largest: float
    first: float
    doubles: bool = True
    settling: float = 0.0
    parts: int = 1
    reach: float = REACH
    least_reach: float = MIN_REACH

    def after(self, elapsed: float, change: float, has_samples: bool) -> float:
        """The longest step some time after a change.

        **Arguments:**

        - `elapsed`: that time, s.
        - `change`: the size of the change, K/s.
        - `has_samples`: whether samples are inside of the span.
        """
        step = self.first
        if elapsed < self.first - 1e-9:
            ends = zip(self.ramp, accumulate(self.ramp), strict=True)
            step = next((step for step, end in ends if end > elapsed + 1e-9), step)
        elif elapsed >= self.settling:
            step = max(step, self.growth * elapsed)
        if change == 0:
            return self.largest
        reach = self.reach * change ** (-1 / 4)
        if reach >= self.least_reach:
            step = max(step, reach * INSIDE if has_samples else reach)
        # A transient that stays below the tolerance needs no steps.
        return min(max(step, ROUGHNESS / change), self.largest)


# The arguments of `build_time_grid` other than the experiment.
GridOptions: TypeAlias = tuple[StepRule, tuple[tuple[Input, bool], ...], tuple[float, ...], float]


def settling_after_reversals(experiment: Experiment, lags: bool) -> float:
    """The `settling` for a solver whose steps grow from the start: 0 unless the driver has a lag
    and a command is reversed, because a lagging duty then has a kink where it passes 0."""
    duty = experiment.duty
    return SETTLING_SECONDS if lags and bool(np.any(duty[1:] * duty[:-1] < 0)) else 0.0


def twin_steps(twin: Twin | System, refinement: int) -> GridOptions:
    """The arguments of `build_time_grid` other than the experiment."""
    part = 0.5**refinement
    settling = 0.0 if twin.wiring.lag is None else SETTLING_SECONDS
    inputs, longest = twin.wiring.inputs_and_effects, LARGEST_STEP
    if twin.wiring.delay is not None and inputs:
        longest = DELAYED_STEP
    rule = step_rule(part, longest, settling)
    if isinstance(twin, System):
        return rule, inputs, (), 0.0
    return rule, inputs, input_rates(twin.rig), longest_lateness(twin)


def step_rule(part: float = 1.0, largest: float | None = None, settling: float = 0.0) -> StepRule:
    """The steps of the default solver, shorter by a factor."""
    first = part * FIRST_STEP
    return StepRule(
        ramp=tuple((first * FINE).tolist()),
        growth=part * GROWTH,
        largest=part * (LARGEST_STEP if largest is None else largest),
        first=first,
        settling=settling,
        parts=round(1 / part),
        reach=part * REACH,
        least_reach=part * MIN_REACH,
    )


def longest_lateness(twin: Twin) -> float:
    """The longest time by which the driver's delay is taken to shift the steps, s: twice that of
    the rig's file."""
    delay = twin.wiring.delay
    return 0.0 if delay is None else 2 * float(delay.numbers(Twin(twin.rig).numbers_si)[0])


@lru_cache(maxsize=64)
def build_time_grid(
    experiment: Experiment,
    rule: StepRule | None = None,
    inputs: tuple[tuple[Input, bool], ...] = (),
    rates: tuple[float, ...] = (),
    lateness: float = 0.0,
) -> TimeGrid:
    """Builds the time grid of an experiment.

    **Arguments:**

    - `experiment`: the times, the inputs and the ambient temperature.
    - `rule`: the sizes of steps; None for those of the default solver.
    - `inputs`: the inputs of the rig besides the duty, each with whether it changes a resistance.
    - `rates`: how fast channels answer to each input, see `input_rates`; empty if that is not
      known. Every change then counts as a large one.
    - `lateness`: the longest time by which steps may be shifted against all inputs but the duty, s.

    **Raises:** `SimulationError` if a run has more steps than fit into memory, or if a recording
    lacks an input.
    """
    rule = step_rule() if rule is None else rule
    time, duty = experiment.elapsed, experiment.duty
    ambient = experiment.ambient
    levels = input_levels(experiment, tuple(rig_input for rig_input, _ in inputs))
    duration = float(time[-1])
    least = duration / rule.largest
    if least > MAX_STEPS * rule.parts:
        raise SimulationError(
            f"{experiment.name or 'the experiment'}: expected at most "
            f"{MAX_STEPS * rule.largest * rule.parts:g} s, got {duration:g} s, which takes "
            f"{least:.2g} steps of at most {rule.largest:g} s; simulate it in parts, with "
            "Experiment.between"
        )
    marks, changed, slow = _span_starts(experiment, levels, rates, lateness)
    reversals = time[1:][np.any(duty[1:] * duty[:-1] < 0, axis=1)]
    starts = time[marks[:-1]]
    last = np.searchsorted(reversals, starts, "right")
    since = starts - np.append(-np.inf, reversals)[last]
    few = rule.parts * np.where(since < rule.settling, REVERSED_PARTS, 1)
    spans: list[list[float]] = []
    changes: list[tuple[float, float]] = []
    for (start, stop), n, change in zip(
        pairwise(marks), few.tolist(), changed.tolist(), strict=True
    ):
        # A later change that is as large makes the earlier ones irrelevant.
        while changes and changes[-1][1] <= change:
            changes.pop()
        changes.append((float(time[start]), change))
        spans.append(_span_steps(time[start : stop + 1], rule, changes, n))
    span_of = np.repeat(np.arange(len(spans)), [len(span) for span in spans])
    # Sums of steps and sample times differ by rounding errors, so sizes are rounded and merged.
    sizes, size = np.unique(np.round(np.concatenate(spans), 9), return_inverse=True)
    lengths = sizes[size]
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    step_of = np.clip(np.searchsorted(edges, time - 1e-7) - 1, 0, len(size) - 1)
    longer = np.where(lengths > 0, lengths, 1.0)
    part = np.clip((time - edges[step_of]) / longer[step_of], 0.0, 1.0)
    polynomials = step_polynomials([np.asarray(span) for span in spans])
    # The parts of its span that have passed at the start, in the middle and at the end of a step.
    stages = edges[:-1, None] + lengths[:, None] * [0.0, 0.5, 1.0] - time[marks[span_of], None]
    passed = stages / np.diff(time[marks])[span_of, None]
    room, *others = (quadratic_at(of_input[span_of], passed) for of_input in slow)
    return TimeGrid(
        times=time,
        sizes=sizes,
        size=size.astype(np.int32),
        duty=duty[marks[span_of]],
        ambient=None if ambient is None else room + ZERO_CELSIUS,
        polynomials=polynomials,
        step_of=step_of.astype(np.int32),
        weights=sample_weights(polynomials, step_of, part),
        ambient_at=None if ambient is None else np.broadcast_to(ambient, time.shape) + ZERO_CELSIUS,
        # A quadratic may leave the range of the input, such as speeds that are never negative.
        levels=None
        if levels is None
        else np.clip(
            np.stack([mean_of(rows) for rows in others], axis=1),
            levels.min(axis=0),
            levels.max(axis=0),
        ),
        levels_at=levels,
        regimes=None if levels is None else regimes(levels, np.array([x for _, x in inputs])),
    )


def _span_starts(
    experiment: Experiment,
    levels: Float[np.ndarray, "times inputs"] | None,
    rates: tuple[float, ...],
    lateness: float,
) -> tuple[
    Int[np.ndarray, " marks"], Float[np.ndarray, " spans"], Float[np.ndarray, "slow spans 3"]
]:
    """The samples at which a span begins, and the last one; the size of the change at the start of
    each span, K/s; and the inputs but the duty during the span."""
    time, duty = experiment.elapsed, experiment.duty
    slow, switches = _slow_inputs(experiment, levels), input_changes(experiment, levels)
    marks = np.unique(np.concatenate([[0], switches, [len(time) - 1]]))

    def during() -> Float[np.ndarray, "slow spans 3"]:
        lengths = np.diff(time[marks])
        return np.stack([held_quadratics(time, held, lengths) for held in slow.T])

    if not rates:
        return marks, np.full(len(marks) - 1, UNKNOWN_CHANGE), during()
    of_duty, speeds = np.array(rates[: duty.shape[1]]), np.array(rates[duty.shape[1] :])
    has_states = np.isinf(speeds)
    speeds[has_states] = 0.0
    is_switched, stays = np.zeros((2, len(time)), bool)
    is_switched[1:] = np.any(np.diff(slow[:, has_states], axis=0) != 0, axis=1)
    stays[1:] = is_switched[1:] | np.any(np.diff(duty, axis=0) != 0, axis=1)
    marks = marks[merged_changes(time[marks], slow[marks] * speeds, stays[marks], lateness)]

    known = during()

    def jumps() -> Float[np.ndarray, " inner"]:
        return (speeds[:, None] * np.abs(known[:, 1:, 0] - known[:, :-1, 2])).max(axis=0)

    if lateness > 0:
        # Steps that are late may begin before a change and end behind it. They are short there.
        changes = time[marks[1:-1][jumps() * lateness > ROUGHNESS]]
        following = np.append(changes, np.inf)[np.searchsorted(changes, time)]
        marks = np.union1d(marks, np.flatnonzero(following - time <= lateness))
        known = during()
    starts = marks[1:-1]
    driven = (np.abs(duty[starts] - duty[starts - 1]) * of_duty).max(axis=1)
    # The first span has no change at its start, but a rig that may be far from rest.
    sizes = np.where(is_switched[starts], np.inf, np.maximum(jumps(), driven))
    return marks, np.append(np.inf, sizes), known


def _slow_inputs(
    experiment: Experiment, levels: Float[np.ndarray, "times inputs"] | None
) -> Float[np.ndarray, "times slow"]:
    """All inputs but the duty: the ambient temperature, degC (0 if it is not recorded), and the
    others."""
    ambient = 0.0 if experiment.ambient is None else experiment.ambient
    room = np.broadcast_to(ambient, experiment.time.shape)
    return room[:, None] if levels is None else np.column_stack([room, levels])


def _span_steps(
    time: Float[np.ndarray, " samples"],
    rule: StepRule,
    changes: list[tuple[float, float]],
    parts: int,
) -> list[float]:
    """The steps of a span between two input changes, whose samples include both ends.

    A drive that changes at every sample never comes to rest. A single step for each sample, or some
    equal steps (`parts`), are sufficient for it. Samples inside a span see how the sides of the
    cells settle, and need steps that grow. If the last step contains samples, a step of no length
    follows it (see `step_polynomials`), unless the sides have settled.

    **Arguments:**

    - `changes`: the times of earlier changes of inputs and of this one, s, and their sizes, K/s.
    """
    start, duration, has_samples = float(time[0]), float(time[-1] - time[0]), len(time) > 2
    if duration <= SHORT_SPAN and not has_samples:
        # The inverse of how long a step the change allows.
        steepness = min(changes[-1][1] ** (1 / 4) / rule.reach, 1 / rule.first)
        parts = max(parts, math.ceil(duration * steepness - 1e-9))
        return [duration / parts] * parts
    steps, elapsed = [], 0.0
    while duration - elapsed > 1e-9:
        left, now = duration - elapsed, start + elapsed
        size = min(rule.after(now - at, change, has_samples) for at, change in changes)
        if size >= duration * (1 - 1e-9):
            size = left
        elif rule.doubles and size >= rule.first:
            size = rule.first * 2.0 ** np.floor(np.log2(min(size, left) / rule.first) + 1e-9)
            size = size if size >= rule.first else left
        elif not rule.doubles and size < left < 1.5 * size:
            # The last two share what is left, because a last step much shorter than the one before
            # it is as much work.
            size = left / 2
        steps.append(float(min(size, left)))
        elapsed += steps[-1]
    contains_samples = time[-2] - time[0] > duration - steps[-1] + 1e-9
    is_early = not rule.doubles or duration <= SETTLED_SECONDS or len(steps) == 1
    return [*steps, 0.0] if contains_samples and is_early else steps


# Pads time grids to a few sizes, so that different recordings use the same compiled programs.
#
# A program is compiled for given numbers of steps, samples and step sizes. Added steps have no
# length and do not change temperatures. Added samples repeat the last sample, or are marked as
# missing if samples are summed.

# The smallest number of steps. The first minute of a recording has 40 to 91 steps, which take some
# milliseconds.
MIN_STEPS = 96

# The number of step sizes is padded to a multiple of this. A drive that changes at every sample has
# one step size, a drive that is held for long has 11 to 16; padding adds the size 0.
SIZES = 20


def padded_time_grid(
    twin: Twin | System,
    experiment: Experiment,
    refinement: int = 0,
    *,
    steady_start: bool = False,
) -> TimeGrid:
    """The padded time grid of the default solver for a twin.

    **Arguments:**

    - `twin`, `experiment`, `refinement`: as in `time_grid`.
    - `steady_start`: whether the first duty cycle has always been held before the start.
    """
    grid = _padded_time_grid(experiment, twin_steps(twin, refinement))
    return replace(grid, steady_start=True) if steady_start else grid


@lru_cache(maxsize=64)
def _padded_time_grid(experiment: Experiment, options: GridOptions) -> TimeGrid:
    grid = build_time_grid(experiment, *options)
    sizes = np.append(grid.sizes, np.zeros(SIZES - len(grid.sizes) % SIZES))
    return with_padding(replace(grid, sizes=sizes), MIN_STEPS)


def with_padding(grid: TimeGrid, least: int) -> TimeGrid:
    """Pads the steps of a grid, to at least `least`, and its samples. The size that follows the
    step sizes in use must be 0."""
    ambient, ambient_at = grid.ambient, grid.ambient_at
    levels, levels_at = grid.levels, grid.levels_at
    return TimeGrid(
        times=padded(np.asarray(grid.times)),
        sizes=grid.sizes,
        size=padded(np.asarray(grid.size), int(np.max(grid.size)) + 1, least),
        duty=padded(np.asarray(grid.duty), least=least),
        ambient=None if ambient is None else _standing(np.asarray(ambient), least),
        polynomials=padded(np.asarray(grid.polynomials), CONSTANT_POLYNOMIALS, least),
        step_of=padded(np.asarray(grid.step_of)),
        weights=padded(np.asarray(grid.weights)),
        ambient_at=None if ambient_at is None else padded(np.asarray(ambient_at)),
        levels=None if levels is None else padded(np.asarray(levels), least=least),
        levels_at=None if levels_at is None else padded(np.asarray(levels_at)),
        regimes=grid.regimes,
    )


def _standing(ambient: Float[np.ndarray, "steps 3"], least: int) -> Float[np.ndarray, "filled 3"]:
    """Pads the ambient with its last value, at the end of the last step."""
    filled = padded(ambient, least=least)
    filled[len(ambient) :] = ambient[-1, 2]
    return filled
