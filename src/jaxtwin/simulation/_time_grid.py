"""When to step and where to read: the time grid of the exponential solver for one experiment.

Inputs are held between samples, so little happens between two input changes but relaxation (a
driver may lag, the ambient may drift):
steps start small after each change and grow with the time since then.
All steps are halves, doubles, ... of one size where the samples allow it, so that the exponentials
of a few sizes serve the whole run.
"""

from functools import lru_cache
from itertools import pairwise
from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._errors import SimulationError
from ..io import Experiment
from ..physics import System, Twin
from ._interpolation import sample_weights, step_polynomials

FIRST_STEP, GROWTH, LARGEST_STEP = 0.25, 0.2, 32.0
"""Of steps without refinement: s, part of the time since the last change of an input, s."""

MOST_STEPS = 1_000_000
"""Of a run without refinement: a year. Tables of more would fill the memory."""

SETTLING = 6.0
"""Seconds after a change for which steps keep their first size where the driver lags behind its
command. Reversed, its duty cycle passes zero there at lags of a few seconds, where the heat of an
on/off drive has a corner that a longer step would cut."""


@final
class TimeGrid(eqx.Module):
    """The time grid of one experiment; every array a constant of the run.

    **Arguments:**

    - `times`: of the samples, from the first one on, s.
    - `sizes`: the distinct step sizes, s; 0 for steps that fill up their number (`_padding`).
    - `size`: which of them each step has.
    - `duty`: held during each step, -1 to 1.
    - `ambient`: recorded ambient temperature held during each step, K; None where none is recorded.
    - `polynomials`: how temperatures run within each step, see `step_polynomials`.
    - `step_of`: in which step each sample of the experiment lies.
    - `weights`: of the values and slopes around that step in the sample's temperature: the
      polynomials where the sample lies.
    - `ambient_at`: recorded ambient temperature at each sample, K, or None.
    - `steady_start`: whether the first duty cycle has been held for ever, instead of none, which a
      driver that lags behind its command, or delays it, remembers.
    - `is_delayed`: whether the duty cycles are those that reach the cells behind the driver's
      delay, not those commanded.
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
    steady_start: bool = eqx.field(static=True, default=False)
    is_delayed: bool = eqx.field(static=True, default=False)


def time_grid(twin: Twin | System, experiment: Experiment, refinement: int = 0) -> TimeGrid:
    """The default solver's grid for a twin.

    **Arguments:**

    - `twin`: the twin, or its equations, which say whether its driver lags.
    - `experiment`: its times, inputs and ambient.
    - `refinement`: how often steps are halved.

    **Returns:** the grid, with the duty cycles as commanded.
    """
    return build_time_grid(experiment, *twin_steps(twin, refinement))


def reference_temperature(system: System, grid: TimeGrid) -> Float[Array, ""]:
    """What deviations are counted from: the ambient at the start, recorded or the rig's, K."""
    if grid.ambient_at is None:
        return system.ambient_temperature
    return jnp.asarray(grid.ambient_at[0], system.capacitance.dtype)


def twin_steps(twin: Twin | System, refinement: int) -> tuple[float, float, float, float, int]:
    """What `build_time_grid` takes beside the experiment."""
    part = 0.5**refinement
    settling = 0.0 if twin.wiring.lag is None else SETTLING
    return part * FIRST_STEP, part * GROWTH, part * LARGEST_STEP, settling, 2**refinement


@lru_cache(maxsize=64)
def build_time_grid(
    experiment: Experiment,
    first_step: float = FIRST_STEP,
    growth: float = GROWTH,
    largest_step: float = LARGEST_STEP,
    settling: float = 0.0,
    parts: int = 1,
) -> TimeGrid:
    """The grid of an experiment.

    **Arguments:**

    - `experiment`: its times, inputs and ambient.
    - `first_step`: after an input change, s.
    - `growth`: a step is at most this part of the time since the last change.
    - `largest_step`: s.
    - `settling`: for how long after an input change steps do not grow, s.
    - `parts`: of a span that is too short for steps that grow.

    **Raises:** `SimulationError` where a run takes more steps than memory has room for.
    """
    time, duty = experiment.time, experiment.duty
    ambient = experiment.ambient
    changed = np.any(duty[1:] != duty[:-1], axis=1)
    if isinstance(ambient, np.ndarray):
        changed |= ambient[1:] != ambient[:-1]
    switches = 1 + np.flatnonzero(changed)
    marks = np.unique(np.concatenate([[0], switches, [len(time) - 1]]))
    least = experiment.duration / largest_step
    if least > MOST_STEPS * parts:
        raise SimulationError(
            f"{experiment.name or 'the experiment'}: expected at most "
            f"{MOST_STEPS * largest_step * parts:g} s, got {experiment.duration:g} s, which takes "
            f"{least:.2g} steps of at most {largest_step:g} s; simulate it in parts, with "
            "Experiment.between"
        )
    spans = [
        _graded(float(time[stop] - time[start]), first_step, growth, largest_step, settling, parts)
        for start, stop in pairwise(marks)
    ]
    held = np.repeat(marks[:-1], [len(span) for span in spans])
    # Sums of steps and sample times differ by rounding; sizes that differ by no more are one.
    sizes, size = np.unique(np.round(np.concatenate(spans), 9), return_inverse=True)
    lengths = sizes[size]
    edges = time[0] + np.concatenate([[0.0], np.cumsum(lengths)])
    step_of = np.clip(np.searchsorted(edges, time - 1e-7) - 1, 0, len(size) - 1)
    part = np.clip((time - edges[step_of]) / lengths[step_of], 0.0, 1.0)
    polynomials = step_polynomials([np.asarray(span) for span in spans])
    celsius = None if ambient is None else np.broadcast_to(ambient, time.shape) + 273.15
    return TimeGrid(
        times=time - time[0],
        sizes=sizes,
        size=size.astype(np.int32),
        duty=duty[held],
        ambient=None if celsius is None else celsius[held],
        polynomials=polynomials,
        step_of=step_of.astype(np.int32),
        weights=sample_weights(polynomials, step_of, part),
        ambient_at=celsius,
    )


def _graded(
    duration: float, first: float, growth: float, largest: float, settling: float, parts: int
) -> list[float]:
    """Steps that fill a span between two input changes, doubling as time goes by.

    The first one comes in nine parts, each twice the last: right after a change the sides of a
    cell may settle within milliseconds, which temperatures elsewhere forgive but derivatives with
    respect to the resistances there do not.
    A drive that changes at every sample never comes to rest: a step a sample, or some equal ones,
    are enough for it.
    """
    if duration <= 4 * first * parts:
        return [duration / parts] * parts
    steps, elapsed = [first / 2**8] + [first / 2**k for k in range(8, 0, -1)], first
    while duration - elapsed > 1e-9:
        grown = max(first, growth * elapsed) if elapsed >= settling else first
        wanted = min(grown, largest, duration - elapsed)
        size = first * 2.0 ** np.floor(np.log2(wanted / first) + 1e-9)
        size = min(size, duration - elapsed) if size >= first else duration - elapsed
        steps.append(float(size))
        elapsed += size
    return steps
