"""When to step and where to read: the time grid of the exponential solver for one experiment.

Inputs are held between samples, so nothing happens between two input changes but relaxation:
steps start small after each change and grow with the time since then.
All steps are halves, doubles, ... of one size where the samples allow it, so that the exponentials
of a few sizes serve the whole run.
"""

from functools import lru_cache
from itertools import pairwise
from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..io import Experiment


@final
class Schedule(eqx.Module):
    """The time grid of one experiment; every array a constant of the run.

    **Arguments:**

    - `times`: of the samples, from the first one on, s.
    - `sizes`: the distinct step sizes, s.
    - `size`: which of them each step has.
    - `fresh`: whether the inputs change at a step's start.
    - `duty`: held during each step, -1 to 1.
    - `ambient`: recorded ambient temperature held during each step, K; None where none is recorded.
    - `step_of`: in which step each sample of the experiment lies.
    - `weights`: in the sample's temperature, of value and slope at the start of that step, at its
      end and one step before: see `hermite_weights`.
    - `ambient_at`: recorded ambient temperature at each sample, K, or None.
    """

    times: Float[Array | np.ndarray, " times"]
    sizes: Float[Array | np.ndarray, " sizes"]
    size: Int[Array | np.ndarray, " steps"]
    fresh: Bool[Array | np.ndarray, " steps"]
    duty: Float[Array | np.ndarray, "steps cells"]
    ambient: Float[Array | np.ndarray, " steps"] | None
    step_of: Int[Array | np.ndarray, " times"]
    weights: Float[Array | np.ndarray, "times 6"]
    ambient_at: Float[Array | np.ndarray, " times"] | None


@lru_cache(maxsize=64)
def build_schedule(
    experiment: Experiment,
    first_step: float = 0.25,
    growth: float = 0.2,
    largest_step: float = 64.0,
) -> Schedule:
    """The schedule of an experiment.

    **Arguments:**

    - `experiment`: its times, inputs and ambient.
    - `first_step`: after an input change, s.
    - `growth`: a step is at most this part of the time since the last change.
    - `largest_step`: s.
    """
    time, duty = experiment.time, experiment.duty
    ambient = experiment.ambient
    changed = np.any(duty[1:] != duty[:-1], axis=1)
    if isinstance(ambient, np.ndarray):
        changed |= ambient[1:] != ambient[:-1]
    switches = 1 + np.flatnonzero(changed)
    marks = np.unique(np.concatenate([[0], switches, [len(time) - 1]]))
    steps, held, fresh = [], [], []
    for start, stop in pairwise(marks):
        sizes = _graded(float(time[stop] - time[start]), first_step, growth, largest_step)
        steps += sizes
        held += [start] * len(sizes)
        fresh += [True] + [False] * (len(sizes) - 1)
    # Sums of steps and sample times differ by rounding; sizes that differ by no more are one.
    sizes, size = np.unique(np.round(steps, 9), return_inverse=True)
    edges = time[0] + np.concatenate([[0.0], np.cumsum(sizes[size])])
    step_of = np.clip(np.searchsorted(edges, time - 1e-7) - 1, 0, len(size) - 1)
    length = sizes[size][step_of]
    part = np.clip((time - edges[step_of]) / length, 0.0, 1.0)
    before = np.where(fresh, 0.0, np.roll(sizes[size], 1))[step_of]
    celsius = None if ambient is None else np.broadcast_to(ambient, time.shape) + 273.15
    return Schedule(
        times=time - time[0],
        sizes=sizes,
        size=size.astype(np.int32),
        fresh=np.array(fresh),
        duty=duty[held],
        ambient=None if celsius is None else celsius[held],
        step_of=step_of.astype(np.int32),
        weights=hermite_weights(part, length, before),
        ambient_at=celsius,
    )


def hermite_weights(
    part: Float[Array | np.ndarray, " times"],
    length: Float[Array | np.ndarray, " times"],
    before: Float[Array | np.ndarray, " times"],
) -> Float[Array | np.ndarray, "times 6"]:
    """Hermite interpolation between values and slopes at the ends of a step and of the one before.

    **Arguments:**

    - `part`: of the step's length that has gone by, 0 to 1.
    - `length`: of the step, s.
    - `before`: length of the step before, s; 0 where the inputs changed in between, which leaves
      the step's own two ends.

    **Returns:** weights of value and slope at the start, at the end, and one step before.
    """
    library = np if isinstance(part, np.ndarray) else jnp
    alone = before == 0
    r = library.where(alone, 1.0, before / length)
    s = part

    def value_and_slope(node: Any, lagrange: Any, slope_there: Any) -> tuple[Any, Any]:
        square = lagrange**2
        return (1 - 2 * slope_there * (s - node)) * square, (s - node) * square * length

    three = [
        *value_and_slope(0.0, (s + r) * (1 - s) / r, 1 / r - 1),
        *value_and_slope(1.0, (s + r) * s / (1 + r), 1 / (1 + r) + 1),
        *value_and_slope(-r, s * (s - 1) / (r * (1 + r)), -1 / r - 1 / (1 + r)),
    ]
    nothing = library.zeros_like(s)
    two = [
        *value_and_slope(0.0, 1 - s, -1.0),
        *value_and_slope(1.0, s, 1.0),
        *(nothing, nothing),
    ]
    weights = [library.where(alone, a, b) for a, b in zip(two, three, strict=True)]
    return library.stack(weights, axis=1)


def _graded(duration: float, first: float, growth: float, largest: float) -> list[float]:
    """Steps that fill a span between two input changes, doubling as time goes by.

    The first one comes in nine parts, each twice the last: right after a change the sides of a
    cell may settle within milliseconds, which temperatures elsewhere forgive but derivatives with
    respect to the resistances there do not.
    A drive that changes at every sample never comes to rest: a step a sample is enough for it.
    """
    if duration <= 4 * first:
        return [duration]
    steps, elapsed = [first / 2**8] + [first / 2**k for k in range(8, 0, -1)], first
    while duration - elapsed > 1e-9:
        wanted = min(max(first, growth * elapsed), largest, duration - elapsed)
        size = first * 2.0 ** np.floor(np.log2(wanted / first) + 1e-9)
        size = min(size, duration - elapsed) if size >= first else duration - elapsed
        steps.append(float(size))
        elapsed += size
    return steps
