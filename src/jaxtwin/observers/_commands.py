r"""The commands in the driver's delay, at irregular times, and the duty that reaches the cells.

`simulation._delay` knows all commands of a run beforehand; here they come one after the other. A
command $c_j$ that was given $a_j$ seconds ago takes effect $s_j = d - a_j$ seconds from now, and is
in force until the next one, $s_{j-1}$, takes effect. With a lag $\tau$ the duty at a time $s$ from
now is therefore

$$u(s) = u_0 e^{-s/\tau} + \sum_j c_j \left(e^{-(s - e_j)/\tau} - e^{-(s - b_j)/\tau}\right),$$

where $b_j$ and $e_j$ are $s_j$ and $s_{j-1}$, limited to the time between 0 and $s$.
"""

from typing import final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

# The age of a command that was given before the start, s.
LONG_AGO = 1e9


@final
class Commands(eqx.Module):
    """The last commands, the newest first.

    - `duty`: the commanded duty cycles, -1 to 1.
    - `ages`: the time since each was given, s.
    """

    duty: Float[Array, "commands cells"]
    ages: Float[Array, " commands"]

    @classmethod
    def held(cls, duty: Float[Array, " cells"], count: int) -> "Commands":
        """The commands of a rig whose duty has been the same for a long time."""
        return cls(
            jnp.broadcast_to(duty, (count, *duty.shape)), jnp.full(count, LONG_AGO, duty.dtype)
        )

    def given(self, command: Float[Array, " cells"], spacing: Float[ArrayLike, ""]) -> "Commands":
        """The commands after another one.

        A command that is not new, or that follows the last one within `spacing` seconds, replaces
        the last one, so that the oldest are not lost before they took effect.
        """
        is_held = jnp.all(command == self.duty[0]) | (self.ages[0] < spacing)
        kept = jnp.where(is_held, self.duty, jnp.roll(self.duty, 1, axis=0))
        ages = jnp.where(is_held, self.ages, jnp.roll(self.ages, 1).at[0].set(0.0))
        return Commands(kept.at[0].set(command), ages)

    def older(self, dt: Float[Array, ""]) -> "Commands":
        """The commands `dt` seconds later."""
        return Commands(self.duty, self.ages + dt)

    def reached(
        self,
        times: Float[Array, " times"],
        duty: Float[Array, " cells"],
        lag: Float[Array, ""] | None,
        delay: Float[Array, ""] | None,
    ) -> Float[Array, "times cells"]:
        """The duty that reaches the cells at some times from now.

        **Arguments:**

        - `times`: the times, s.
        - `duty`: the duty that reaches the cells now.
        - `lag`, `delay`: those of the driver, s; None for none.
        """
        starts = jnp.zeros_like(self.ages) if delay is None else delay - self.ages
        starts = starts.at[-1].set(-LONG_AGO)
        ends = jnp.concatenate([jnp.full(1, LONG_AGO, starts.dtype), starts[:-1]])
        if lag is None:
            at = times[:, None]
            in_force = (starts <= at) & (at < ends)
            return in_force.astype(duty.dtype) @ self.duty
        begin = jnp.clip(starts, 0.0, times[:, None])
        end = jnp.clip(ends, 0.0, times[:, None])
        weights = jnp.exp(-(times[:, None] - end) / lag) - jnp.exp(-(times[:, None] - begin) / lag)
        return jnp.exp(-times / lag)[:, None] * duty + weights @ self.duty
