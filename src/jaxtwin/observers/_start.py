r"""Where an observer starts: the distribution of the state given a first reading.

What happened to the rig before is not known. As for the start of a match
(`matching._initial_condition_priors`), it is described by heat that flowed at random into the sides
of the cells, equally at all frequencies. In the modes of the network it leaves amplitudes with the
covariance

$$P_{ij} = \frac{d_i^T d_j}{\lambda_i + \lambda_j},$$

where $d_i$ are the shapes of mode $i$ at the sides. If $c^T z$ is the mean reading above the room,
and $a$ its first value, then $z$ has the mean $\beta a$ with $\beta = P c / (c^T P c)$, and the
covariance $(P - \beta c^T P) / (c^T P c)$ times the size of the heat, which $a$ shows: a wall that
takes hours begins near the room, a heater that takes seconds near the reading. A rig at rest
($a = 0$) still has a size, that of 1 K.

The room has the prior of the twin, and the difference between reading and room a Cauchy prior,
which says that rigs are often at rest, and sometimes far from it.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..io import Experiment
from ..matching._start import first_sample
from ._augmented_model import AugmentedModel
from ._gaussian import Gaussian

# Scale of the Cauchy prior of the difference between the first reading and the room, K; and the
# size of the heat of a rig at rest, as the change of the reading that it leaves.
REST_SCALE = 1.0

# How far the mean temperature may be from the first reading, K.
READ_SPREAD = 0.3

# The standard deviation of temperatures that are given for all nodes, K.
GIVEN_SPREAD = 0.1

GRID = np.linspace(-1.0, 1.0, 401)


def start_of(model: AugmentedModel, nodes: Float[ArrayLike, "..."] | None) -> Gaussian:
    """The distribution of the state at the start.

    **Arguments:**

    - `nodes`: temperatures of all nodes, or the mean first reading of the channels, degC; None for
      the initial temperatures of the twin.
    """
    layout, modes = model.layout, model.stepper.field.modes
    system, dtype = model.stepper.system, model.stepper.reference.dtype
    if nodes is None:
        nodes = model.to_degC(system.initial_temperature - model.stepper.reference)
    given = model.from_degC(jnp.asarray(nodes, dtype))
    mean = jnp.zeros(layout.size, dtype)
    covariance = jnp.zeros((layout.size, layout.size), dtype)
    z, room = layout.of("modes"), layout.of("room")
    if given.ndim:
        of_room = Gaussian(jnp.zeros(1, dtype), jnp.reshape(model.room_spread**2, (1, 1)))
        mean = mean.at[z].set(modes.amplitudes(given))
        own = GIVEN_SPREAD**2 * (modes.shapes.T * system.capacitance**2) @ modes.shapes
        covariance = covariance.at[z, z].set(own)
        covariance = covariance.at[room, room].set(of_room.covariance)
    else:
        at, variance = _room(model, given)
        everywhere = modes.amplitudes(jnp.ones_like(system.capacitance))
        drive = modes.sides
        past = drive.T @ drive / (modes.rates[:, None] + modes.rates[None, :])
        seen = jnp.asarray(system.channel_weights)[model.columns].mean(axis=0)
        seen = seen @ modes.shapes
        shared = past @ seen
        of_reading = seen @ shared
        away = given - at
        share = shared / of_reading
        size = (away**2 + variance + REST_SCALE**2) / of_reading
        hidden = (past - jnp.outer(share, shared)) * size
        moved = everywhere - share
        mean = mean.at[z].set(everywhere * at + share * away)
        mean = mean.at[room].set(at)
        own = hidden + jnp.outer(moved, moved) * variance
        own = own + jnp.outer(everywhere, everywhere) * READ_SPREAD**2
        covariance = covariance.at[z, z].set(own)
        covariance = covariance.at[z, room].set(moved[:, None] * variance)
        covariance = covariance.at[room, z].set(moved[None, :] * variance)
        covariance = covariance.at[room, room].set(variance)
    spreads = model.start_spreads()
    return Gaussian(mean, covariance + jnp.diag(spreads**2))


def _room(
    model: AugmentedModel, reading: Float[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Mean and variance of the room given the first reading, as a deviation from the reference,
    which is the room that the twin expects."""
    spread = model.room_spread
    low = jnp.minimum(0.0, reading) - 4 * spread
    high = jnp.maximum(0.0, reading) + 4 * spread
    rooms = (low + high) / 2 + (high - low) / 2 * jnp.asarray(GRID, low.dtype)
    density = jnp.exp(-0.5 * (rooms / spread) ** 2)
    density = density / (1 + ((reading - rooms) / REST_SCALE) ** 2)
    density = density / density.sum()
    mean = density @ rooms
    return mean, density @ (rooms - mean) ** 2


def first_reading(experiment: Experiment) -> float:
    """The mean over the channels of the first reading of each, degC."""
    return first_sample(experiment).reading
