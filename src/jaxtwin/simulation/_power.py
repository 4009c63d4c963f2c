"""Electrical power and energy of a run, from the temperatures of the cells' sides at its samples.

The command is held between samples, and reaches the cells behind the driver's delay and lag. Power
is integrated by Simpson's rule between the times at which a command arrives, with the sides'
temperatures linear between samples.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._compilation import persistent_jit
from ..physics import System, Twin
from ._drive import lagged_duty

# The rounding of times by which a command may seem to arrive late, s.
TIME_TOLERANCE_SECONDS = 1e-9


class SupplyPower(NamedTuple):
    """Power and energy that the bridges draw from the supply.

    - `power`: the power of each cell's bridge from each time on, W.
    - `energy`: the energy of all bridges together up to each time, J.
    - `peak`: the largest power of all bridges together, W.
    """

    power: Float[Array | np.ndarray, "*draws times cells"]
    energy: Float[Array | np.ndarray, "*draws times"]
    peak: Float[Array | np.ndarray, "*draws"]


def supply_power(
    system: System,
    sides: Float[Array, "times sides"],
    times: Float[Array | np.ndarray, " times"],
    commands: Float[Array | np.ndarray, "times cells"],
    steady_start: bool,
    levels: Float[Array | np.ndarray, "times inputs"] | None,
) -> SupplyPower:
    """Power and energy of a run.

    **Arguments:**

    - `sides`: all cold sides, then all hot sides at the samples; absolute, K.
    - `times`: the times of the samples, s.
    - `commands`: the commands that are held from each sample on, -1 to 1.
    - `steady_start`: whether the first command was always held before the start; otherwise the
      command was 0.
    - `levels`: the rig's other inputs from each sample on; None for a rig without any.
    """
    dtype = sides.dtype
    times, commands = jnp.asarray(times, dtype), jnp.asarray(commands, dtype)
    arrivals = times if system.delay is None else times + system.delay
    marks = times if system.delay is None else jnp.sort(jnp.concatenate([times, arrivals]))
    marks = jnp.clip(marks, times[0], times[-1])
    before = commands[0] if steady_start else jnp.zeros_like(commands[0])
    voltages = None
    if levels is not None:
        voltages = jax.vmap(system.conditions)(jnp.asarray(levels, dtype)).supply_voltage

    def power(at: Array, side: Array) -> Float[Array, "*at cells"]:
        """Computes the power at some times of an interval. `side` is a time inside the interval, at
        which its command is read."""
        if system.lag is None:
            now = jnp.searchsorted(arrivals, side, side="right") - 1
            duty = jnp.where((now < 0)[..., None], before, commands[jnp.maximum(now, 0)])
        else:
            duty = lagged_duty(system.lag, None, arrivals, commands, at, steady_start)
        cold, hot = jnp.split(_linear(at, times, sides), 2, axis=-1)
        bridge = system.bridge
        if voltages is not None:
            now = jnp.clip(jnp.searchsorted(times, side, side="right") - 1, 0)
            bridge = eqx.tree_at(lambda b: b.supply_voltage, bridge, voltages[now][..., None])
        return bridge.supply_power(system.module, duty, cold, hot)

    middles = (marks[1:] + marks[:-1]) / 2
    stages = power(jnp.stack([marks[:-1], middles, marks[1:]]), jnp.stack([middles] * 3))
    together = stages.sum(axis=-1)
    mean = (together[0] + 4 * together[1] + together[2]) / 6
    drawn = jnp.append(0.0, jnp.cumsum(mean * jnp.diff(marks)))
    return SupplyPower(
        power=power(times, times + TIME_TOLERANCE_SECONDS),
        energy=drawn[jnp.searchsorted(marks, times)],
        peak=jnp.where(jnp.diff(marks) > 0, together, -jnp.inf).max(),
    )


def _linear(
    at: Float[Array, "*at"], times: Float[Array, " times"], values: Float[Array, "times columns"]
) -> Float[Array, "*at columns"]:
    return jnp.stack([jnp.interp(at, times, column) for column in values.T], axis=-1)


@persistent_jit
def power_of_states(
    twin: Twin,
    states: Float[Array | np.ndarray, "times nodes"],
    times: Float[Array | np.ndarray, " times"],
    commands: Float[Array | np.ndarray, "times cells"],
    steady_start: bool,
    levels: Float[Array | np.ndarray, "times inputs"] | None,
) -> SupplyPower:
    """Power and energy of a twin's run.

    **Arguments:** those of `supply_power`, with the absolute temperatures of all nodes, K.
    """
    system = twin.system()
    sides = jnp.asarray(states)[:, np.concatenate([system.wiring.cold, system.wiring.hot])]
    return supply_power(system, sides, times, commands, steady_start, levels)
