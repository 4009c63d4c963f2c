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

from .._jax_settings import own_settings
from ..errors import ObserverError
from ..observers import AugmentedModel, Commands
from ..physics import System
from ._suspects import Suspect


@final
class Suspected(eqx.Module):
    """Faults as arrays.

    - `healthy`: the equations. `faulty`: those with each fault, stacked.
    - `changes`: the derivatives of both along the directions in which the values of the twin are
      uncertain, the last axis of each leaf; None for a twin whose values are exact.
    - `held`: the place of the channel that is stuck, -1 for none.
    - `drift`: the rate at which the room drifts, K/s.
    """

    healthy: System
    faulty: System
    changes: tuple[System, System] | None
    held: Int[np.ndarray | Array, " faults"]
    drift: Float[np.ndarray | Array, " faults"]

    def at(self, model: AugmentedModel, mean: Float[Array, " state"]) -> tuple[System, System]:
        """The equations without and with each fault for the values of a state."""
        if self.changes is None or model.directions is None:
            return self.healthy, self.faulty
        amounts = model.directions.limited(mean[model.layout.of("values")])
        healthy, faulty = (
            jax.tree.map(
                lambda leaf, change: leaf if change is None else leaf + change @ amounts,
                system,
                changes,
                is_leaf=lambda leaf: leaf is None,
            )
            for system, changes in zip((self.healthy, self.faulty), self.changes, strict=True)
        )
        return healthy, faulty


def suspected(model: AugmentedModel, several: Sequence[Suspect]) -> Suspected:
    """The arrays of suspects, of their sizes.

    **Raises:** `ObserverError` if a fault is no function of a `System`, or changes its nodes.
    """
    names = [model.twin.channels[column] for column in np.asarray(model.columns)]
    with own_settings():
        healthy = _completed(model.stepper.system)
        faulty = _stacked([_with(healthy, suspect) for suspect in several])
        changes = None
        if model.directions is not None and model.changes is not None:
            of_healthy = _as_completed(healthy, model.changes)
            changes = (
                of_healthy,
                _stacked([_along(healthy, of_healthy, suspect) for suspect in several]),
            )
    held = [names.index(suspect.held) if suspect.held in names else -1 for suspect in several]
    drift = [suspect.size if suspect.is_drift else 0.0 for suspect in several]
    return Suspected(healthy, faulty, changes, np.array(held), np.array(drift))


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
    healthy, faulty = faults.at(model, mean)
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

    (before, end), (after, ends) = heated(healthy), jax.vmap(heated)(faulty)
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
    healthy, faulty = faults.at(model, mean)
    x, room = model.deviation(mean), mean[model.layout.of("room")]

    def read(system: System) -> Array:
        return system.channel_temperatures(x, room)[model.columns]

    return (jax.vmap(read)(faulty) - read(healthy)).T


def is_held(faults: Suspected, channels: int) -> Float[Array, "channels faults"]:
    """1 for the channel that is stuck."""
    return (jnp.arange(channels)[:, None] == jnp.asarray(faults.held)).astype(float)


def _completed(system: System) -> System:
    """The same equations with an array in each place that a fault may change."""
    cells, dtype = len(system.wiring.cold), system.capacitance.dtype
    parts = (
        jnp.ones(cells, dtype)
        if system.bridge.supply_share is None
        else system.bridge.supply_share,
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


def _as_completed(healthy: System, changes: System) -> System:
    """The derivatives of the completed equations; those of places that were empty are 0."""
    empty = jax.tree.map(
        lambda leaf: (
            jnp.zeros((*leaf.shape, _count(changes)), leaf.dtype)
            if eqx.is_inexact_array(leaf)
            else None
        ),
        healthy,
    )
    return jax.tree.map(
        lambda none, change: none if change is None else change,
        empty,
        changes,
        is_leaf=lambda leaf: leaf is None,
    )


def _count(changes: System) -> int:
    return changes.capacitance.shape[-1]


def _along(healthy: System, changes: System, suspect: Suspect) -> System:
    """The derivatives of the equations with a fault along the directions."""
    if suspect.fault is None:
        return changes
    fault = suspect.fault(suspect.size)
    numbers, others = eqx.partition(healthy, eqx.is_inexact_array)

    def changed(numbers: System) -> System:
        return eqx.filter(fault(eqx.combine(numbers, others)), eqx.is_inexact_array)

    def along(change: System) -> System:
        return jax.jvp(changed, (numbers,), (change,))[1]

    return jax.vmap(along, in_axes=-1, out_axes=-1)(changes)


def _stacked(several: Sequence[System]) -> System:
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(x) for x in leaves]), *several)


def _with(healthy: System, suspect: Suspect) -> System:
    if suspect.fault is None:
        return healthy
    changed = suspect.fault(suspect.size)(healthy)
    if not isinstance(changed, System):
        raise ObserverError(
            f"faults: {suspect.name}: expected a function System -> System, got one that "
            f"returns {type(changed).__name__}"
        )
    same = jax.tree.structure(changed) == jax.tree.structure(healthy)
    shapes = [[np.shape(leaf) for leaf in jax.tree.leaves(s)] for s in (changed, healthy)]
    if not same or shapes[0] != shapes[1]:
        raise ObserverError(
            f"faults: {suspect.name}: expected the {len(healthy.capacitance)} nodes and the "
            "parts of the rig to stay, got other ones"
        )
    return changed
