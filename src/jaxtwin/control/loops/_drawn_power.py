"""Electrical power and energy of steps of equal size.

The rule is that of `simulation/_power.py` for runs: Simpson's between the times at which a command
arrives, with the temperatures of the sides linear in between. Here these times are the same in each
step, so that they need not be searched for.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...simulation import Stepper
from ...simulation._power import SupplyPower


def drawn_in_steps(
    stepper: Stepper,
    commands: Float[Array, "times cells"],
    followed: Float[Array, "times cells"],
    sides: tuple[Float[Array, "times cells"], Float[Array, "times cells"]],
) -> SupplyPower:
    """Computes the power and the energy that the bridges draw from the supply while a stepper
    steps, from rest with the cells off.

    **Arguments:**

    - `commands`: the commands that are held from each time on, -1 to 1.
    - `followed`: the duty behind the driver's delay and lag at each time. Without a lag there is no
      delay either, and the commands are used.
    - `sides`: the temperatures of the cells' cold and hot sides at each time; absolute, K.

    **Returns:** power, energy and peak. The peak is searched for at the beginning, in the middle
    and at the end between two arrivals of a command: behind a lag the duty is largest when the next
    command arrives, which is within a step if the delay is not a multiple of it.
    """
    system, parts = stepper.system, len(stepper.sizes)
    last = len(commands) - 1
    waiting = jnp.zeros((stepper.queue, commands.shape[1]), commands.dtype)
    queued = jnp.concatenate([waiting, commands])

    def arriving(part: int) -> Float[Array, "times cells"]:
        """Returns the command that reaches the lag, or the cells, in a part of each step."""
        if system.delay is None:
            return commands
        first = stepper.queue - stepper.delay_steps - (parts - 1 - part)
        return jax.lax.dynamic_slice_in_dim(queued, first, len(commands))

    def power(duty: Array, at: Float[Array, ""]) -> Float[Array, "steps cells"]:
        """Computes the power in all steps, at a given part of each step."""
        cold, hot = ((1 - at) * side[:-1] + at * side[1:] for side in sides)
        return system.bridge.supply_power(system.module, duty, cold, hot)

    first = commands if system.lag is None else followed
    duty, energy = first[:last], jnp.zeros(last, commands.dtype)
    peak = jnp.array(-jnp.inf, commands.dtype)
    begin = jnp.zeros_like(stepper.sizes[0])
    for part in range(parts):
        size, command = stepper.sizes[part], arriving(part)[:last]
        stages = []
        for place in (0.0, 0.5, 1.0):
            after = command
            if system.lag is not None:
                after = command + (duty - command) * jnp.exp(-place * size / system.lag)
            at = (begin + place * size) / stepper.sizes.sum()
            stages.append(power(after, at).sum(axis=1))
        energy = energy + size * (stages[0] + 4 * stages[1] + stages[2]) / 6
        peak = jnp.maximum(
            peak, jnp.where(size > 0, jnp.stack(stages), -jnp.inf).max(initial=-jnp.inf)
        )
        begin = begin + size
        duty = after
    return SupplyPower(
        power=system.bridge.supply_power(system.module, first, *sides),
        energy=jnp.concatenate([jnp.zeros(1, energy.dtype), jnp.cumsum(energy)]),
        peak=peak,
    )
