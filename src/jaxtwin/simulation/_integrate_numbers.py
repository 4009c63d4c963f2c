"""Integrates many draws of a network by Rodas5P, every number of a draw an array over the draws."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._sparse_lu import SparseLU
from ._numbered_network import NumberedNetwork, Numbers
from ._rosenbrock_step import GAMMA, NODES, added, rosenbrock_step
from ._time_grid import TimeGrid

class NumberedState(NamedTuple):
    """Where a run is.

    - `rises`: the deviations from the reference, K.
    - `duty`: what reaches each cell, -1 to 1.
    - `errors`: the sums of the error estimates of the steps so far, K.
    """

    rises: Numbers
    duty: Numbers
    errors: Numbers


class HeldStep(NamedTuple):
    """What is held during a step: numbers that all draws share.

    - `size`: its length, s; 0 for a step that fills a grid up.
    - `begin`: the time at its start, s.
    - `ambient`: the recorded ambient's deviation from the reference, K.
    - `command`: of each cell, -1 to 1.
    """

    size: Float[Array, ""]
    begin: Float[Array, ""]
    ambient: Float[Array, ""]
    command: list[Float[Array, ""]]


def step_table(grid: TimeGrid) -> Float[np.ndarray, "steps columns"]:
    """The `HeldStep` of each step as a row."""
    sizes = np.asarray(grid.sizes)[np.asarray(grid.size)]
    ambient = np.zeros(len(sizes))
    if grid.ambient is not None and grid.ambient_at is not None:
        ambient = np.asarray(grid.ambient) - np.asarray(grid.ambient_at)[0]
    return np.column_stack([sizes, np.cumsum(sizes) - sizes, ambient, np.asarray(grid.duty)])


def held_step(row: Callable[[int], Any], cells: int) -> HeldStep:
    """A row of the `step_table`, by its columns."""
    return HeldStep(row(0), row(1), row(2), [row(3 + k) for k in range(cells)])


def advance(
    network: NumberedNetwork, lu: SparseLU, state: NumberedState, step: HeldStep
) -> tuple[NumberedState, Numbers]:
    """Takes a step.

    **Returns:** the state at its end, and the slopes at its start under its inputs, K/s.
    """
    moves = step.size > 0
    size = jnp.where(moves, step.size, 1.0)

    def duty_at(part: float) -> Numbers:
        if network.lag is None:
            return [jnp.broadcast_to(c, network.reference.shape) for c in step.command]
        if part == 0:
            return state.duty
        left = jnp.exp(-part * size / network.lag)
        return [c + (u - c) * left for c, u in zip(step.command, state.duty, strict=True)]

    def ambient_at(part: float) -> Array:
        held = jnp.broadcast_to(step.ambient, network.reference.shape)
        return held if network.drift is None else held + network.drift * (step.begin + part * size)

    duty, ambient = duty_at(0.0), ambient_at(0.0)
    first = network.slope(state.rises, duty, ambient)
    time_slope = None
    if network.lag is not None or network.drift is not None:
        rest, lag = jnp.zeros_like(network.reference), network.lag
        turning = [
            rest if lag is None else (c - u) / lag for c, u in zip(step.command, duty, strict=True)
        ]
        drift = rest if network.drift is None else network.drift
        time_slope = network.time_slope(state.rises, duty, ambient, turning, drift)
    jacobian = network.jacobian(state.rises, duty, ambient)
    diagonal = 1 / (GAMMA * size)
    factors = lu.factorise(
        {(i, j): diagonal - slope if i == j else -slope for (i, j), slope in jacobian.items()}
    )
    inputs = {part: (duty_at(part), ambient_at(part)) for part in dict.fromkeys(NODES)}
    result = rosenbrock_step(
        state.rises,
        size,
        lambda stage, rises: network.slope(list(rises), *inputs[NODES[stage]]),
        time_slope,
        lambda right: lu.solve(factors, right),
        first,
    )
    after = NumberedState(
        [jnp.where(moves, end, x) for end, x in zip(result.end, state.rises, strict=True)],
        [jnp.where(moves, end, u) for end, u in zip(inputs[1.0][0], duty, strict=True)],
        added(state.errors, [jnp.where(moves, jnp.abs(e), 0.0) for e in result.error]),
    )
    return after, first
