"""The time grid of the exponential solver for an experiment: its steps and its samples.

Inputs are held between samples. Between two input changes there is therefore little but relaxation
(the driver may have a lag, the ambient may drift): steps are short after each change and grow with
the time since then. If the samples allow it, all step sizes are a single size times a power of two,
so that a run needs the exponentials of few sizes.
"""

from functools import lru_cache
from itertools import pairwise
from typing import TypeAlias, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._celsius import ZERO_CELSIUS
from ..errors import SimulationError
from ..io import Experiment
from ..physics import System, Twin
from ..rig import Input
from ._input_levels import input_changes, input_levels, regimes
from ._interpolation import sample_weights, step_polynomials

FIRST_STEP, GROWTH, LARGEST_STEP = 0.25, 0.2, 32.0
"""Step sizes without refinement: the first one, s; the largest one as a part of the time since the
last change of an input; the largest one, s."""

# The largest step if the driver has a delay and the rig other inputs, s. The grid moves with the
# delay, so that these inputs change within a step, which takes their mean.
DELAYED_STEP = 0.5

# The largest number of steps without refinement, those of a year. More would fill the memory.
MAX_STEPS = 1_000_000

# The time after a change for which steps keep their first size if the driver has a lag, s. If the
# command is reversed, the duty passes zero within this time for lags of a few seconds, and the heat
# of an on/off drive has a kink there, which a longer step would miss.
SETTLING_SECONDS = 6.0

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
    - `ambient`: the recorded ambient temperature that is held during each step, K; None if it is
      not recorded.
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
    ambient: Float[Array | np.ndarray, " steps"] | None
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


# The arguments of `build_time_grid` other than the experiment.
GridOptions: TypeAlias = tuple[float, float, float, float, int, tuple[tuple[Input, bool], ...]]


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
    largest = part * longest
    return part * FIRST_STEP, part * GROWTH, largest, settling, 2**refinement, inputs


@lru_cache(maxsize=64)
def build_time_grid(
    experiment: Experiment,
    first_step: float = FIRST_STEP,
    growth: float = GROWTH,
    largest_step: float = LARGEST_STEP,
    settling: float = 0.0,
    parts: int = 1,
    inputs: tuple[tuple[Input, bool], ...] = (),
    ramp: tuple[float, ...] = (),
) -> TimeGrid:
    """Builds the time grid of an experiment.

    **Arguments:**

    - `experiment`: the times, the inputs and the ambient temperature.
    - `first_step`: the first step after an input change, s.
    - `growth`: the largest ratio of a step to the time since the last change.
    - `largest_step`: the largest step, s.
    - `settling`: the time after an input change during which steps do not grow, s.
    - `parts`: the number of steps of a span that is too short for growing steps.
    - `inputs`: the inputs of the rig besides the duty, each with whether it changes a resistance.
    - `ramp`: the first steps after an input change, s, for a solver that does without the
      exponentials of few sizes: the others grow by their ratio to the time since the change, and
      each longer span ends with a step of no length. `first_step` then has no effect.

    **Raises:** `SimulationError` if a run has more steps than fit into memory, or if a recording
    lacks an input.
    """
    time, duty = experiment.elapsed, experiment.duty
    ambient = experiment.ambient
    levels = input_levels(experiment, tuple(one for one, _ in inputs))
    switches = input_changes(experiment, levels)
    marks = np.unique(np.concatenate([[0], switches, [len(time) - 1]]))
    duration = float(time[-1])
    least = duration / largest_step
    if least > MAX_STEPS * parts:
        raise SimulationError(
            f"{experiment.name or 'the experiment'}: expected at most "
            f"{MAX_STEPS * largest_step * parts:g} s, got {duration:g} s, which takes "
            f"{least:.2g} steps of at most {largest_step:g} s; simulate it in parts, with "
            "Experiment.between"
        )
    reversals = time[1:][np.any(duty[1:] * duty[:-1] < 0, axis=1)]
    starts = time[marks[:-1]]
    last = np.searchsorted(reversals, starts, "right")
    since = starts - np.append(-np.inf, reversals)[last]
    few = parts * np.where(since < settling, REVERSED_PARTS, 1)
    spans = [
        _span_steps(
            time[start : stop + 1], first_step, growth, largest_step, settling, int(n), ramp
        )
        for (start, stop), n in zip(pairwise(marks), few, strict=True)
    ]
    held = np.repeat(marks[:-1], [len(span) for span in spans])
    # Sums of steps and sample times differ by rounding errors, so sizes are rounded and merged.
    sizes, size = np.unique(np.round(np.concatenate(spans), 9), return_inverse=True)
    lengths = sizes[size]
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    step_of = np.clip(np.searchsorted(edges, time - 1e-7) - 1, 0, len(size) - 1)
    part = np.clip((time - edges[step_of]) / lengths[step_of], 0.0, 1.0)
    polynomials = step_polynomials([np.asarray(span) for span in spans])
    celsius = None if ambient is None else np.broadcast_to(ambient, time.shape) + ZERO_CELSIUS
    return TimeGrid(
        times=time,
        sizes=sizes,
        size=size.astype(np.int32),
        duty=duty[held],
        ambient=None if celsius is None else celsius[held],
        polynomials=polynomials,
        step_of=step_of.astype(np.int32),
        weights=sample_weights(polynomials, step_of, part),
        ambient_at=celsius,
        levels=None if levels is None else levels[held],
        levels_at=levels,
        regimes=None if levels is None else regimes(levels, np.array([x for _, x in inputs])),
    )


def _span_steps(
    time: Float[np.ndarray, " samples"],
    first: float,
    growth: float,
    largest: float,
    settling: float,
    parts: int,
    ramp: tuple[float, ...],
) -> list[float]:
    """The steps of a span between two input changes, whose samples include both ends.

    A drive that changes at every sample never comes to rest. A single step for each sample, or some
    equal steps (`parts`), are sufficient for it. Samples inside a span see how the sides of the
    cells settle, and need steps that grow. If the last step contains samples, a step of no length
    follows it (see `step_polynomials`), unless the sides have settled.
    """
    duration = float(time[-1] - time[0])
    if duration <= SHORT_SPAN and len(time) == 2:
        return [duration / parts] * parts
    if ramp:
        return [*_geometric(duration, ramp, growth, largest, settling), 0.0]
    steps = _graded(duration, min(first, duration), growth, largest, settling)
    contains_samples = time[-2] - time[0] > duration - steps[-1] + 1e-9
    return [*steps, 0.0] if contains_samples and duration <= SETTLED_SECONDS else steps


def _graded(
    duration: float, first: float, growth: float, largest: float, settling: float
) -> list[float]:
    """Steps which grow with the time since an input change by doubling.

    The first step is divided into nine parts, which also grow by doubling. Right after a change the
    sides of a cell may settle within milliseconds, which hardly affects temperatures elsewhere, but
    does affect derivatives with respect to the resistances of the cell.
    """
    steps, elapsed = [first / 2**8] + [first / 2**k for k in range(8, 0, -1)], first
    while duration - elapsed > 1e-9:
        grown = max(first, growth * elapsed) if elapsed >= settling else first
        wanted = min(grown, largest, duration - elapsed)
        size = first * 2.0 ** np.floor(np.log2(wanted / first) + 1e-9)
        size = min(size, duration - elapsed) if size >= first else duration - elapsed
        steps.append(float(size))
        elapsed += size
    return steps


def _geometric(
    duration: float, ramp: tuple[float, ...], growth: float, largest: float, settling: float
) -> list[float]:
    """Steps which grow in proportion to the time since an input change, after those of the ramp.
    The last two share what is left, because a last step much shorter than the one before it is as
    much work."""
    steps, elapsed = [], 0.0
    while duration - elapsed > 1e-9:
        left = duration - elapsed
        grown = max(ramp[-1], growth * elapsed) if elapsed >= settling else ramp[-1]
        wanted = ramp[len(steps)] if len(steps) < len(ramp) else grown
        size = min(wanted, largest, left)
        if size < left < 1.5 * size:
            size = left / 2
        steps.append(float(size))
        elapsed += size
    return steps
