r"""The duty cycle that reaches the cells where the driver follows its command with a lag.

Between two changes of the command $c$, $\tau \dot u = c(t - d) - u$ has the solution
$u(t) = c + (u_0 - c) e^{-(t - d - t_0) / \tau}$, so that nothing has to be integrated and any time
can be asked for.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def lagged_duty(
    lag: Float[Array, ""],
    delay: Float[Array, ""] | None,
    starts: Float[Array, " steps"],
    commands: Float[Array, "steps cells"],
    times: Float[Array, "*times"],
    at_rest: bool = False,
) -> Float[Array, "*times cells"]:
    """What the cells get at given times, -1 to 1.

    **Arguments:**

    - `lag`, `delay`: s.
    - `starts`: from when on each command is held, increasing, s.
    - `commands`: -1 to 1.
    - `times`: s.
    - `at_rest`: whether the first command was held for ever before, instead of none.
    """
    initial = commands[0] if at_rest else jnp.zeros_like(commands[0])

    def follow(duty: Array, step: tuple[Array, Array]) -> tuple[Array, Array]:
        command, duration = step
        return command + (duty - command) * jnp.exp(-duration / lag), duty

    durations = jnp.append(jnp.diff(starts), 0.0)
    _, at_start = jax.lax.scan(follow, initial, (commands, durations))
    late = times if delay is None else times - delay
    now = jnp.clip(jnp.searchsorted(starts, late, side="right") - 1, 0)
    elapsed = jnp.maximum(late - starts[now], 0.0)[..., None]
    return commands[now] + (at_start[now] - commands[now]) * jnp.exp(-elapsed / lag)
