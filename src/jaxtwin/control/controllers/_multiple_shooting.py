r"""A twin over the horizon of a controller, by direct multiple shooting.

The states of the twin at the samples, $s_0$ to $s_n$, are unknowns beside the duty $u_k$; an
interval of the horizon asks that $s_{k+1} = F(s_k, u_k)$ (Bock and Plitt, IFAC World Congress,
1984). All intervals are integrated and linearised side by side. The linear conditions give the
states as functions of the duty (condensing), so that a quadratic program of the duty alone is left:

$$s_{k+1} = F(\bar s_k, \bar u_k) + A_k (s_k - \bar s_k) + B_k (u_k - \bar u_k)$$
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...simulation import ModalState, Stepper, advance
from ..linear._operating_point import KINK_DISTANCE


class ShootingPath(NamedTuple):
    """The states of a twin at the samples of a horizon, as vectors, and the duty from each of them
    to the next."""

    states: Float[Array, "samples state"]
    duty: Float[Array, "intervals cells"]


class CondensedPath(NamedTuple):
    """The states of the samples from 1 on as linear functions of the moves: without moves, and
    their derivatives."""

    still: Float[Array, "intervals state"]
    by_moves: Float[Array, "intervals state moves"]


def as_vector(state: ModalState) -> Float[Array, " state"]:
    """The amplitudes of the modes, the duty that reaches the cells and the commands in the delay,
    in a row."""
    return jnp.concatenate([state.amplitudes, state.duty, state.commands.reshape(-1)])


def as_state(stepper: Stepper, vector: Float[Array, " state"]) -> ModalState:
    """The state that `as_vector` made a vector of."""
    modes, cells = len(stepper.field.modes.rates), len(stepper.system.wiring.cold)
    amplitudes, duty, commands = jnp.split(vector, [modes, modes + cells])
    return ModalState(amplitudes, duty, commands.reshape(stepper.queue, cells))


def after_interval(
    stepper: Stepper,
    steps: int,
    state: Float[Array, " state"],
    duty: Float[Array, " cells"],
    heat: Float[Array, " nodes"],
) -> Float[Array, " state"]:
    """The state at the end of an interval: $F$, some steps under a held duty and heat (W)."""

    def step(state: ModalState, _: None) -> tuple[ModalState, None]:
        return advance(stepper, state, duty, stepper.ambient, heat), None

    end, _ = jax.lax.scan(step, as_state(stepper, state), None, length=steps)
    return as_vector(end)


def condensed_path(
    stepper: Stepper,
    steps: int,
    first: Float[Array, " state"],
    path: ShootingPath,
    heat: Float[Array, " nodes"],
    toward: Float[Array, " cells"],
    moves: int,
) -> CondensedPath:
    """Linearises all intervals about a path, and eliminates their states.

    **Arguments:**

    - `steps`: the steps of an interval.
    - `first`: the state at the first sample.
    - `path`: the path about which the intervals are linearised; nothing asks that it be one that
      the twin can take.
    - `heat`: additional heat into the nodes, W.
    - `toward`: the sign of the slope that a duty of exactly 0 has, where those of heating and of
      cooling differ.
    - `moves`: the number of samples in which the duty changes.
    """
    intervals, cells = path.duty.shape
    modes = len(stepper.field.modes.rates)
    tail = path.states[:-1, modes:].reshape(intervals, -1, cells)
    tail = _beside_zero(tail, toward).reshape(intervals, -1)
    states = jnp.concatenate([path.states[:-1, :modes], tail], axis=1)
    duty = _beside_zero(path.duty, toward)

    def interval(state: Array, command: Array) -> tuple[Array, Array]:
        end = after_interval(stepper, steps, state, command, heat)
        return end, end

    linearised = jax.jacfwd(interval, (0, 1), has_aux=True)  # traced once for value and slopes
    (by_state, by_duty), ends = jax.vmap(linearised)(states, duty)
    places = jnp.minimum(jnp.arange(intervals), moves - 1)
    of_moves = jnp.eye(moves * cells, dtype=first.dtype).reshape(moves, cells, -1)[places]

    def further(
        before: tuple[Array, Array], interval: tuple[Array, ...]
    ) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        (still, by_moves), (state, command, end, A, B, of_move) = before, interval
        later = end + A @ (still - state) - B @ command, A @ by_moves + B @ of_move
        return later, later

    start = first, jnp.zeros((len(first), moves * cells), first.dtype)
    _, result = jax.lax.scan(further, start, (states, duty, ends, by_state, by_duty, of_moves))
    return CondensedPath(*result)


def _beside_zero(
    duty: Float[Array, "*shape cells"], toward: Float[Array, " cells"]
) -> Float[Array, "*shape cells"]:
    """A duty without zeros, at which the heat of a cell has a kink and JAX gives its slope as 0."""
    return jnp.where(jnp.abs(duty) < KINK_DISTANCE, KINK_DISTANCE * toward, duty)
