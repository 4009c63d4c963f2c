"""Integrates many draws of a network by Rodas5P, every number of a draw an array over the draws.

A step is some thousand multiplications and additions of such arrays. XLA fuses them to about a
hundred kernels of an accelerator (jax 0.11.2; `benchmarks/results/gpu.md`), none of which calls a
library or waits for the host.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from .._sparse_lu import SparseLU
from ._numbered_network import NumberedNetwork, Numbers
from ._rosenbrock_step import NODES, added, rosenbrock_step, step_matrix
from ._time_grid import TimeGrid


class HeldStep(NamedTuple):
    """What is held during a step: numbers that all draws share.

    - `size`: its length, s; 0 for a step that fills a grid up.
    - `begin`: the time at its start, s.
    - `ambient`: the recorded ambient's deviation from the reference at the start, in the middle and
      at the end, K.
    - `command`: of each cell, -1 to 1.
    """

    size: Float[Array, "*steps"]
    begin: Float[Array, "*steps"]
    ambient: Float[Array, "*steps 3"]
    command: Float[Array, "*steps cells"]


class NumberedState(NamedTuple):
    """Where a run is.

    - `rises`: the deviations from the reference, K.
    - `duty`: what reaches each cell, -1 to 1.
    - `errors`: the sums of the absolute error estimates of the steps so far, K.
    """

    rises: Numbers
    duty: Numbers
    errors: Numbers


class NumberedRun(NamedTuple):
    """The nodes during a run, with an axis for the draws behind the others.

    - `rises`, `slopes`: the deviations from the reference, K, and their slopes, K/s. Row k belongs
      to the start of step k, the last row to the end. A slope is that under the inputs that follow.
    - `errors`: the sums of the absolute error estimates of all steps, K.
    """

    rises: Float[Array, "ends nodes draws"]
    slopes: Float[Array, "ends nodes draws"]
    errors: Float[Array, "nodes draws"]


def integrate_numbers(network: NumberedNetwork, start: Numbers, grid: TimeGrid) -> NumberedRun:
    """Integrates over the steps of a grid.

    **Arguments:**

    - `network`: the network of many draws.
    - `start`: the deviations of the nodes from the reference at the start, K.
    - `grid`: the steps, which the draws share, with the inputs that are held during each.
    """
    dtype, shape = network.reference.dtype, network.reference.shape
    lu, rest = SparseLU(network.pattern), jnp.zeros(shape, dtype)
    steps = held_steps(grid, dtype)
    command = steps.command[0] if grid.steady_start else jnp.zeros_like(steps.command[0])
    duty = [jnp.broadcast_to(of_cell, shape) for of_cell in command]

    def step(state: NumberedState, held: HeldStep) -> tuple[NumberedState, tuple[Numbers, Numbers]]:
        after, slopes = advance(network, lu, state, held)
        return after, (state.rises, slopes)

    state = NumberedState(start, duty, [rest] * len(start))
    end, (rises, slopes) = jax.lax.scan(step, state, steps)
    last = jax.tree.map(lambda rows: rows[-1], steps)
    at_end = last._replace(begin=last.begin + last.size)
    last_slopes = network.slope(
        end.rises, duty_at(network, at_end, end.duty, rest), ambient_at(network, at_end, rest)
    )
    return NumberedRun(
        rises=jnp.concatenate([jnp.stack(rises, axis=1), jnp.stack(end.rises)[None]]),
        slopes=jnp.concatenate([jnp.stack(slopes, axis=1), jnp.stack(last_slopes)[None]]),
        errors=jnp.stack(end.errors),
    )


def held_steps(grid: TimeGrid, dtype: DTypeLike) -> HeldStep:
    """The steps of a grid, each field with a leading axis for the steps."""
    sizes = jnp.asarray(grid.sizes)[grid.size]
    ambient = jnp.zeros((len(sizes), 3))
    if grid.ambient is not None and grid.ambient_at is not None:
        ambient = jnp.asarray(grid.ambient) - grid.ambient_at[0]
    steps = HeldStep(sizes, jnp.cumsum(sizes) - sizes, ambient, jnp.asarray(grid.duty))
    return jax.tree.map(lambda rows: rows.astype(dtype), steps)


def advance(
    network: NumberedNetwork, lu: SparseLU, state: NumberedState, step: HeldStep
) -> tuple[NumberedState, Numbers]:
    """Takes a step.

    **Returns:** the state at its end, and the slopes at its start under its inputs, K/s.
    """
    moves = step.size > 0
    size = jnp.where(moves, step.size, 1.0)
    elapsed = {part: jnp.broadcast_to(part * size, network.reference.shape) for part in set(NODES)}
    duty = {part: duty_at(network, step, state.duty, time) for part, time in elapsed.items()}
    ambient = {part: ambient_at(network, step, time) for part, time in elapsed.items()}
    first = network.slope(state.rises, duty[0.0], ambient[0.0])
    jacobian = network.jacobian(state.rises, duty[0.0], ambient[0.0])
    factors = lu.factorise(step_matrix(jacobian, size))
    result = rosenbrock_step(
        state.rises,
        size,
        lambda stage, rises: network.slope(list(rises), duty[NODES[stage]], ambient[NODES[stage]]),
        _time_slope(network, state, step, duty[0.0], ambient[0.0]),
        lambda right: lu.solve(factors, right),
        first,
    )
    after = NumberedState(
        [jnp.where(moves, end, x) for end, x in zip(result.end, state.rises, strict=True)],
        [jnp.where(moves, end, u) for end, u in zip(duty[1.0], state.duty, strict=True)],
        added(state.errors, [jnp.where(moves, jnp.abs(e), 0.0) for e in result.error]),
    )
    return after, first


def duty_at(
    network: NumberedNetwork, step: HeldStep, before: Numbers, elapsed: Float[Array, " draws"]
) -> Numbers:
    """The duty that reaches each cell some time after the start of a step, at which it was
    `before`: the command, or what lags behind it."""
    if network.lag is None:
        return [jnp.broadcast_to(command, elapsed.shape) for command in step.command]
    left = jnp.exp(-elapsed / network.lag)
    return [
        command + (duty - command) * left
        for command, duty in zip(step.command, before, strict=True)
    ]


def ambient_at(
    network: NumberedNetwork, step: HeldStep, elapsed: Float[Array, " draws"]
) -> Float[Array, " draws"]:
    """The ambient's deviation from the reference some time after the start of a step, K."""
    start, middle, end = step.ambient
    part = elapsed / jnp.where(step.size > 0, step.size, 1.0)
    held = start + part * (4 * middle - 3 * start - end + part * 2 * (start + end - 2 * middle))
    return held if network.drift is None else held + network.drift * (step.begin + elapsed)


def _time_slope(
    network: NumberedNetwork,
    state: NumberedState,
    step: HeldStep,
    duty: Numbers,
    ambient: Float[Array, " draws"],
) -> Numbers | None:
    """The change of the slopes with the inputs at the start of a step, K/s^2; None where these are
    held."""
    if network.lag is None and network.drift is None:
        return None
    rest = jnp.zeros_like(network.reference)
    turning = [rest] * len(duty)
    if network.lag is not None:
        turning = [(c - u) / network.lag for c, u in zip(step.command, duty, strict=True)]
    drift = rest if network.drift is None else network.drift
    return network.time_slope(state.rises, duty, ambient, turning, drift)
