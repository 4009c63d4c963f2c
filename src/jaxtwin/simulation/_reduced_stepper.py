r"""A stepper with fewer modes, for devices with little memory.

The states of a rig hardly leave a small space. It is found by proper orthogonal decomposition: the
stepper runs under an example of commands, and the space holds the uniform rise of all nodes and the
principal components of the states of this run, in the norm by the heat capacities. The network is
projected on the space (Galerkin), which keeps it symmetric and stable, and is solved in its modes
there as `Stepper` solves all of it. Peltier and Joule heat and nonlinear losses remain as they are
(Antoulas, *Approximation of Large-Scale Dynamical Systems*, 2005, section 9.1).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from .._arguments import whole_number
from .._compilation import persistent_jit
from .._jax_settings import is_traced, own_settings
from ..errors import SimulationError
from ._modes import LossShapes, Modes
from ._step_preparation import check_stable, steps_in_modes
from ._stepper import Stepper, advance, to_modal

# Principal components below this part of the largest are rounding.
INDEPENDENCE_TOLERANCE = 1e-10


def reduce_stepper(stepper: Stepper, modes: int, duty: ArrayLike) -> Stepper:
    """Makes a stepper with fewer modes, which stays nonlinear.

    ```python
    random = numpy.random.default_rng(0)
    levels = random.uniform(-0.3, 1.0, (60, 2))  # of each cell by itself
    small = reduce_stepper(jt.Stepper(twin, 1.0), 12, levels.repeat(60, axis=0))
    jt.export_c(small, "firmware", name="plate")
    ```

    The result is a `Stepper` with the states and the channels of the given one. It is accurate for
    commands of the kind of the example: with an example in which all cells have the same duty, it
    is not accurate for different ones. Compare it with the given stepper on other commands.

    **Arguments:**

    - `stepper`: the stepper.
    - `modes`: the number of modes that the result has.
    - `duty`: an example of the commands, one for each step from the initial state of the rig on,
      `(steps, cells)`, -1 to 1.

    **Raises:** `SimulationError` if the number of modes is not from 1 to that of the stepper, if
    the example is not finite, has another shape or moves the rig in fewer directions than modes are
    asked for, if the stepper is traced by JAX, or if the steps are not stable.
    """
    where = "reduce_stepper"
    if is_traced(stepper):
        raise SimulationError(
            f"{where}: stepper: expected numbers, got values that JAX traces; reduce outside of "
            "jax.jit, jax.vmap and jax.grad"
        )
    count, cells = stepper.field.modes.rates.size, len(stepper.system.wiring.cold)
    kept = whole_number(f"{where}: modes", modes, 1, SimulationError)
    if kept > count:
        raise SimulationError(
            f"{where}: modes: expected at most the {count} modes of the stepper, got {kept}"
        )
    example = np.asarray(duty, float)
    is_table = example.ndim == 2 and example.shape[1] == cells and len(example) > 0
    if not is_table or not np.isfinite(example).all():
        raise SimulationError(
            f"{where}: duty: expected finite numbers of shape (steps, {cells}), got an array of "
            f"shape {example.shape}"
        )
    with own_settings():
        states = np.asarray(_amplitudes(stepper, jnp.asarray(example)))
        whole = stepper.field.modes
        uniform = np.asarray(whole.amplitudes(jnp.ones(whole.capacitance.size)))
        basis = _basis(where, states, uniform, kept)
        reduced = projected(whole, stepper.losses, basis)
        return in_modes(where, stepper, reduced)


def in_modes(where: str, stepper: Stepper, modes: Modes) -> Stepper:
    """Makes a stepper that takes its steps in these modes of its network.

    **Raises:** `SimulationError` if the steps are not stable in them.
    """
    size = stepper.sizes.sum()
    result = steps_in_modes(stepper.system, modes, size, stepper.sizes)
    check_stable(where, float(size), result.stability)
    return eqx.tree_at(
        lambda s: (s.factors, s.field, s.losses, s.half_decay, s.half),
        stepper,
        result[:-1],
        is_leaf=lambda leaf: leaf is None,
    )


@persistent_jit
def _amplitudes(stepper: Stepper, duty: Float[Array, "steps cells"]) -> Float[Array, "steps modes"]:
    """Returns the amplitudes of the modes after each step."""
    start = to_modal(stepper, stepper.start())

    def step(state, command):
        later = advance(stepper, state, command, stepper.ambient)
        return later, later.amplitudes

    return jax.lax.scan(step, start, duty)[1]


def _basis(
    where: str,
    states: Float[np.ndarray, "steps modes"],
    uniform: Float[np.ndarray, " modes"],
    count: int,
) -> Float[np.ndarray, "modes kept"]:
    """Returns the uniform rise and the principal components of the rest of the states."""
    first = uniform / np.linalg.norm(uniform)
    beside = states - np.outer(states @ first, first)
    _, sizes, components = np.linalg.svd(beside, full_matrices=False)
    result = 1 + int((sizes > INDEPENDENCE_TOLERANCE * sizes[0]).sum())
    if result < count:
        raise SimulationError(
            f"{where}: duty: expected commands that move the rig in {count} directions, got "
            f"{result}; give a longer example with more levels of each cell, or ask for fewer modes"
        )
    return np.column_stack([first, components[: count - 1].T])


def projected(
    modes: Modes, losses: LossShapes | None, basis: Float[np.ndarray, "modes k"]
) -> Modes:
    """Returns the modes of the network within a space of amplitudes."""
    rates, vectors = np.linalg.eigh(basis.T @ (np.asarray(modes.rates)[:, None] * basis))
    onto = jnp.asarray(basis @ vectors)
    return Modes(
        rates=jnp.asarray(rates),
        shapes=modes.shapes @ onto,
        sides=modes.sides @ onto,
        losses=jax.tree.map(lambda shapes: shapes @ onto, losses),
        capacitance=modes.capacitance,
        linearised_conductance=modes.linearised_conductance,
        linearised_loss=modes.linearised_loss,
        operating_point=modes.operating_point,
        switched=None if modes.switched is None else modes.switched @ onto,
        linearised_change=modes.linearised_change,
    )
