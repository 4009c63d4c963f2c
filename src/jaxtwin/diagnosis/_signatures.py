r"""What a fault does to the equations of an observer: heat into the nodes, and other readings.

A fault changes the right-hand side $f_0$ of the equations to $f_1$ and the readings $h_0$ to $h_1$.
A multiple $m$ of it is taken as

$$\dot x = f_0 + m (f_1 - f_0), \qquad y = h_0 + m (h_1 - h_0),$$

which is exact at $m = 1$, whatever the fault is, and everywhere for conductances, gains and
offsets. A fault is thus an array: any function `System -> System` that keeps the nodes can be one,
and all share a compiled program.
"""

from collections.abc import Sequence
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from .._errors import ObserverError
from .._jax_settings import own_settings
from ..observers._augmented_model import AugmentedModel
from ..observers._commands import Commands
from ..physics import System
from ._suspects import Suspect


@final
class Suspected(eqx.Module):
    """Faults as arrays.

    - `healthy`: the equations. `faulty`: those with each fault, stacked.
    - `held`: the place of the channel that is stuck, -1 for none.
    - `drift`: the rate at which the room drifts, K/s.
    """

    healthy: System
    faulty: System
    held: Int[np.ndarray | Array, " faults"]
    drift: Float[np.ndarray | Array, " faults"]

    def of(self, numbers: Sequence[int]) -> "Suspected":
        """Some of the faults."""
        rows = np.asarray(numbers)
        faulty = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], self.faulty)
        return Suspected(self.healthy, faulty, np.asarray(self.held)[rows], self.drift[rows])


def suspected(model: AugmentedModel, several: Sequence[Suspect]) -> Suspected:
    """The arrays of suspects, of their sizes.

    **Raises:** `ObserverError` if a fault is no function of a `System`, or changes its nodes.
    """
    names = [model.twin.channels[column] for column in np.asarray(model.columns)]
    with own_settings():
        healthy = _completed(model.stepper.system)
        faulty = [_with(healthy, one) for one in several]
        stacked = jax.tree.map(lambda *leaves: np.stack([np.asarray(x) for x in leaves]), *faulty)
    held = [names.index(one.held) if one.held in names else -1 for one in several]
    drift = [one.size if one.is_drift else 0.0 for one in several]
    return Suspected(healthy, stacked, np.array(held), np.array(drift))


def of_step(
    model: AugmentedModel,
    faults: Suspected,
    mean: Float[Array, " state"],
    reached: Float[Array, " cells"],
    commands: Commands,
    dt: Float[Array, ""],
    levels: Float[ArrayLike, " inputs"] | None,
) -> Float[Array, "state faults"]:
    """What each fault adds to the state in a step; the arguments are those of
    `AugmentedModel.step`."""
    layout, modes = model.layout, model.stepper.field.modes
    z, u, room = (mean[layout.of(part)] for part in ("modes", "duty", "room"))
    x, reference = modes.shapes @ z, model.stepper.reference
    stages = dt * jnp.array([0.0, 0.5, 1.0], dt.dtype)

    def heated(system: System) -> tuple[Array, Array]:
        path = commands.reached(
            stages, reached if system.lag is None else u, system.lag, system.delay
        )
        now = system
        if levels is not None:
            now = system.under(system.conditions(jnp.asarray(levels, x.dtype)))
        heat = now.heat_into_nodes(x, path[1], reference, room[0])
        return heat / system.capacitance, path[2]

    (before, end), (after, ends) = heated(faults.healthy), jax.vmap(heated)(faults.faulty)
    force = modes.shapes.T @ ((after - before) * faults.healthy.capacitance).T
    # The force is held during the step: fast modes forget most of it.
    held = -jnp.expm1(-modes.rates * dt) / modes.rates
    added = jnp.zeros((layout.size, force.shape[1]), mean.dtype)
    added = added.at[layout.of("modes")].set(held[:, None] * force)
    if layout.duty:
        added = added.at[layout.of("duty")].set((ends - end).T)
    return added.at[layout.of("room")].set(jnp.asarray(faults.drift) * dt)


def of_readings(
    model: AugmentedModel, faults: Suspected, mean: Float[Array, " state"]
) -> Float[Array, "channels faults"]:
    """What each fault adds to the readings, but for channels that are stuck, K."""
    x, room = model.deviation(mean), mean[model.layout.of("room")][0]

    def read(system: System) -> Array:
        return system.channel_temperatures(x, room)[model.columns]

    return (jax.vmap(read)(faults.faulty) - read(faults.healthy)).T


def is_held(faults: Suspected, channels: int) -> Float[Array, "channels faults"]:
    """1 for the channel that is stuck."""
    return (jnp.arange(channels)[:, None] == jnp.asarray(faults.held)).astype(float)


def _completed(system: System) -> System:
    """The same equations with an array in each place that a fault may change."""
    cells, dtype = len(system.wiring.cold), system.capacitance.dtype
    parts = (
        jnp.broadcast_to(jnp.asarray(system.bridge.supply_share, dtype), cells),
        jnp.asarray(system.channel_weights, dtype),
        jnp.zeros_like(system.gain) if system.offset is None else system.offset,
    )
    filled = eqx.tree_at(
        lambda s: (s.bridge.supply_share, s.moved_weights, s.offset),
        system,
        parts,
        is_leaf=lambda leaf: leaf is None,
    )
    return jax.tree.map(jnp.asarray, filled)


def _with(healthy: System, one: Suspect) -> System:
    if one.fault is None:
        return healthy
    changed = one.fault(one.size)(healthy)
    if not isinstance(changed, System):
        raise ObserverError(
            f"diagnose: faults: {one.name}: expected a function System -> System, got one that "
            f"returns {type(changed).__name__}"
        )
    same = jax.tree.structure(changed) == jax.tree.structure(healthy)
    shapes = [[np.shape(leaf) for leaf in jax.tree.leaves(s)] for s in (changed, healthy)]
    if not same or shapes[0] != shapes[1]:
        raise ObserverError(
            f"diagnose: faults: {one.name}: expected the {len(healthy.capacitance)} nodes and the "
            "parts of the rig to stay, got other ones"
        )
    return changed
