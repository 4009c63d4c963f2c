r"""The modes of a large network that matter for its readings.

On a fine grid most modes are ripples between neighbouring elements, which the drive hardly reaches:
a heat flow $q$ into the sides of the cells holds mode $i$ at $v_i^T q / \lambda_i$. A match takes
the derivatives of many runs in the same modes, and without these ripples they take a fraction of
the time. Those that remain are exact modes of the whole network.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..physics import System
from ..simulation import Modes

# The number of modes above which few are taken, and their number. On a plate of 324 elements and
# two cells, the largest error of a reading is 6 mK at rises of 50 K.
MANY, FEW = 128, 96

# A heat flow of a cell, W, and a deviation of the plate from its surroundings at the start, K.
TYPICAL_HEAT, TYPICAL_DEVIATION = 30.0, 3.0


def few_modes(system: System, modes: Modes) -> Modes:
    """The modes of a run; of many modes those that matter: half of them the slowest, half those in
    which the heat of the cells and the surroundings changes readings and cells the most."""
    count = modes.rates.shape[-1]
    # Modes for each regime of a rig's inputs have a leading axis.
    if count <= MANY or modes.rates.ndim > 1:
        return modes
    weight = _largest_change(system, modes)
    _, others = jax.lax.top_k(weight[FEW // 2 :], FEW - FEW // 2)
    chosen = jnp.sort(jnp.concatenate([jnp.arange(FEW // 2), FEW // 2 + others]))

    def of_chosen(shapes: Array | None) -> Array | None:
        return None if shapes is None else shapes[:, chosen]

    return replace(
        modes,
        rates=modes.rates[chosen],
        shapes=modes.shapes[:, chosen],
        sides=modes.sides[:, chosen],
        losses=jax.tree.map(of_chosen, modes.losses),
        switched=of_chosen(modes.switched),
    )


def _largest_change(system: System, modes: Modes) -> Float[Array, " modes"]:
    """The change of a reading or of a cell by each mode under a typical drive, K."""
    at_sides = jnp.abs(modes.sides).max(axis=0)
    weights = jnp.asarray(system.channel_weights, modes.rates.dtype)
    read = jnp.abs(weights @ modes.shapes).max(axis=0)
    surroundings = jnp.abs(system.ambient_conductance @ modes.shapes)
    force = jnp.maximum(TYPICAL_HEAT * at_sides, TYPICAL_DEVIATION * surroundings)
    return jnp.maximum(read, at_sides) * force / modes.rates
