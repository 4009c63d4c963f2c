"""Measures of a closed loop: pure JAX functions of its signals, a `ClosedLoop`, each a single
number."""

from collections.abc import Callable, Mapping
from typing import TypeAlias, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..controllers._controller import DutyLimits
from ..controllers._duty_limits import bounds_of

# The signals of a closed loop, from which its measures are computed.


@final
class ClosedLoop(eqx.Module):
    """The signals of a closed loop at every step of the plant, from which measures are computed.

    **Arguments:**

    - `time`: the times, s.
    - `reference`, `output`: reference and true value of the controlled temperatures, degC.
    - `measurement`: the controlled temperatures as the controller gets them, with noise, delay and
      lost messages, and then those that it only watches, degC.
    - `temperatures`: the temperatures of the channels, without noise, degC.
    - `nodes`: the temperatures of the twin's nodes, degC.
    - `duty`: the duty commanded from this time on, -1 to 1.
    - `power`: the power that each cell's bridge draws from the supply, W.
    - `energy`: the energy that all bridges together have drawn from the supply up to this time, J.
    - `peak_power`: the largest power of all bridges together at any time, also within steps, W.
    - `limits`: the lowest and the highest duty that the controller commands, each a number, or one
      for each cell and heater.
    - `elements`: the number of elements of the plate, which are the first nodes.
    - `sides`: the nodes that are sides of the cells.
    """

    time: Float[Array | np.ndarray, "*draws times"]
    reference: Float[Array | np.ndarray, "*draws times outputs"]
    output: Float[Array | np.ndarray, "*draws times outputs"]
    measurement: Float[Array | np.ndarray, "*draws times readings"]
    temperatures: Float[Array | np.ndarray, "*draws times channels"]
    nodes: Float[Array | np.ndarray, "*draws times nodes"]
    duty: Float[Array | np.ndarray, "*draws times cells"]
    power: Float[Array | np.ndarray, "*draws times cells"]
    energy: Float[Array | np.ndarray, "*draws times"]
    peak_power: Float[Array | np.ndarray, "*draws"]
    limits: DutyLimits = eqx.field(static=True)
    elements: int = eqx.field(static=True)
    sides: tuple[int, ...] = eqx.field(static=True)

    @property
    def plate(self) -> Float[Array | np.ndarray, "*draws times elements"]:
        """Temperatures of the plate's elements, degC."""
        return self.nodes[..., : self.elements]

    @property
    def cell_sides(self) -> Float[Array | np.ndarray, "*draws times sides"]:
        """Temperatures of the cells' sides, degC."""
        return self.nodes[..., np.array(self.sides)]

    @property
    def stays_finite(self) -> Bool[Array, ""]:
        """Whether a single loop has finite temperatures at its end and always a finite duty."""
        return jnp.all(jnp.isfinite(self.nodes[-1])) & jnp.all(jnp.isfinite(self.duty))


# An output counts as settled within this distance of its reference, K.
SETTLING_BAND = 0.5

# The last part of a run, in which the plate counts as at rest.
REST_FRACTION = 0.1

# A duty within this distance of a limit counts as at the limit.
HALF_COUNT = 0.5 / 255

Measure: TypeAlias = Callable[[ClosedLoop], Float[Array, ""]]


def settling_time(loop: ClosedLoop) -> Float[Array, ""]:
    """The time from the last change of a reference until all outputs stay within 0.5 K of their
    references, s; infinite if they never do."""
    time, change = jnp.asarray(loop.time), _last_change(loop)
    is_out = jnp.any(jnp.abs(_error(loop)) > SETTLING_BAND, axis=1)
    last_out = jnp.max(jnp.where(is_out, jnp.arange(time.size), -1))
    settled = jnp.where(last_out < change, 0.0, time[jnp.minimum(last_out + 1, time.size - 1)])
    settled = settled - jnp.where(last_out < change, 0.0, time[change])
    return jnp.where(last_out == time.size - 1, jnp.inf, settled)


def overshoot(loop: ClosedLoop) -> Float[Array, ""]:
    """The largest excess of an output beyond its reference after the last change of a reference, K,
    in the direction from the output at the change to the reference."""
    change = _last_change(loop)
    output, reference = jnp.asarray(loop.output), jnp.asarray(loop.reference)
    direction = jnp.sign(reference[change] - output[change])
    beyond = jnp.where(_since(change, loop), direction * (output - reference), 0.0)
    return jnp.maximum(beyond.max(), 0.0)


def integral_absolute_error(loop: ClosedLoop) -> Float[Array, ""]:
    """IAE, the mean over the outputs, K s."""
    return _integral(loop, jnp.abs(_error(loop)).mean(axis=1))


def integral_squared_error(loop: ClosedLoop) -> Float[Array, ""]:
    """ISE, the mean over the outputs, K^2 s."""
    return _integral(loop, (_error(loop) ** 2).mean(axis=1))


def integral_time_absolute_error(loop: ClosedLoop) -> Float[Array, ""]:
    """ITAE, the mean over the outputs, time counted from the last change of a reference, K s^2."""
    time = jnp.asarray(loop.time)
    since = jnp.maximum(time - time[_last_change(loop)], 0.0)
    return _integral(loop, since * jnp.abs(_error(loop)).mean(axis=1))


def plate_range_at_rest(loop: ClosedLoop) -> Float[Array, ""]:
    """The difference between the hottest and the coldest element of the plate, averaged over the
    last tenth of the run, K."""
    time, plate_range = jnp.asarray(loop.time), _plate_range(loop)
    is_rest = time >= time[0] + (1 - REST_FRACTION) * (time[-1] - time[0])
    return jnp.sum(jnp.where(is_rest, plate_range, 0.0)) / jnp.sum(is_rest)


def largest_plate_range(loop: ClosedLoop) -> Float[Array, ""]:
    """The largest difference between two elements of the plate at any time of the run, K."""
    return _plate_range(loop).max()


def energy(loop: ClosedLoop) -> Float[Array, ""]:
    """The electrical energy drawn from the supply, J."""
    return jnp.asarray(loop.energy)[-1]


def peak_power(loop: ClosedLoop) -> Float[Array, ""]:
    """The largest power that all cells together draw at any time, W."""
    return jnp.asarray(loop.peak_power)


def hottest_cell_side(loop: ClosedLoop) -> Float[Array, ""]:
    """The highest temperature of a side of a cell, degC."""
    return jnp.asarray(loop.cell_sides).max()


def saturation_share(loop: ClosedLoop) -> Float[Array, ""]:
    """The share of the time in which at least one cell or heater has a duty at a limit of its own
    of the controller."""
    return _share_of_time(loop, jnp.any(_is_at_limit(loop), axis=1))


def saturation_shares(loop: ClosedLoop) -> Float[Array, " cells"]:
    """The share of the time in which each cell and heater has a duty at a limit of its own."""
    shares = [_share_of_time(loop, column) for column in _is_at_limit(loop).T]
    return jnp.stack(shares)


def total_variation(loop: ClosedLoop) -> Float[Array, ""]:
    """The total variation of the duty: the sum of the sizes of its changes, over all cells."""
    return jnp.abs(jnp.diff(jnp.asarray(loop.duty), axis=0)).sum()


MEASURES: dict[str, tuple[Measure, str]] = {
    "settling_time": (settling_time, "s"),
    "overshoot": (overshoot, "K"),
    "integral_absolute_error": (integral_absolute_error, "K s"),
    "integral_squared_error": (integral_squared_error, "K^2 s"),
    "integral_time_absolute_error": (integral_time_absolute_error, "K s^2"),
    "plate_range_at_rest": (plate_range_at_rest, "K"),
    "largest_plate_range": (largest_plate_range, "K"),
    "energy": (energy, "J"),
    "peak_power": (peak_power, "W"),
    "hottest_cell_side": (hottest_cell_side, "degC"),
    "saturation_share": (saturation_share, ""),
    "total_variation": (total_variation, ""),
}
"""Name -> function and unit."""


# The measures of the plate, which a rig without one does not have.
OF_PLATE = ("plate_range_at_rest", "largest_plate_range")


def measures_of(elements: int) -> dict[str, tuple[Measure, str]]:
    """Those of `MEASURES` that apply to a rig whose plate has `elements` elements."""
    return {name: row for name, row in MEASURES.items() if elements or name not in OF_PLATE}


def units_of(measures: Mapping[str, Measure]) -> dict[str, str]:
    """Returns the units of those measures that are in `MEASURES`, whatever their names; the unit of
    a user's own function is not known."""
    return {
        name: unit
        for name, function in measures.items()
        for known, unit in MEASURES.values()
        if function is known
    }


def _is_at_limit(loop: ClosedLoop) -> Bool[Array, "times cells"]:
    duty, (lowest, highest) = jnp.asarray(loop.duty), bounds_of(loop.limits)
    return (duty <= lowest + HALF_COUNT) | (duty >= highest - HALF_COUNT)


def _share_of_time(loop: ClosedLoop, holds: Bool[Array, " times"]) -> Float[Array, ""]:
    return _integral(loop, holds.astype(jnp.asarray(loop.time).dtype)) / _duration(loop)


def _error(loop: ClosedLoop) -> Float[Array, "times outputs"]:
    return jnp.asarray(loop.reference) - jnp.asarray(loop.output)


def _plate_range(loop: ClosedLoop) -> Float[Array, " times"]:
    plate = jnp.asarray(loop.plate)
    return plate.max(axis=1) - plate.min(axis=1)


def _last_change(loop: ClosedLoop) -> Array:
    """The first time at which the last references hold."""
    reference = jnp.asarray(loop.reference)
    changes = jnp.any(jnp.diff(reference, axis=0) != 0, axis=1)
    return jnp.max(jnp.where(changes, 1 + jnp.arange(changes.size), 0))


def _since(change: Array, loop: ClosedLoop) -> Array:
    return (jnp.arange(jnp.asarray(loop.time).size) >= change)[:, None]


def _integral(loop: ClosedLoop, values: Float[Array, " times"]) -> Float[Array, ""]:
    """Each value holds until the next time, as commands do."""
    return jnp.sum(values[:-1] * jnp.diff(jnp.asarray(loop.time)))


def _duration(loop: ClosedLoop) -> Float[Array, ""]:
    time = jnp.asarray(loop.time)
    return time[-1] - time[0]
