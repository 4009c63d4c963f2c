"""A network with each of its numbers as an array of its own: structure of arrays.

The equations are those of `System`, which computes with vectors and matrices of one draw. Here each
temperature, conductance and capacitance is an array over the draws, and every operation is
elementwise. A compiler can then keep the numbers of a draw in registers.
"""

from dataclasses import replace
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._jax_settings import in_precision
from .._sparse import Entry, SparseLU
from ..physics import Bridge, NonlinearLoss, System, ThermoelectricModule, Wiring

Scalars = list[Float[Array, "*draws"]]


@final
class ScalarNetwork(eqx.Module):
    """The numbers of a network, each for many draws.

    - `conductance`: the entries of $G$ that differ from 0, W/K, in the order of `entries`.
    - `inverse_capacitance`: of each node, K/J.
    - `to_ambient`: the conductance from each node to the surroundings, W/K.
    - `held_heat`: the heat of bodies at a fixed temperature into each node, W; empty for none.
    - `modules`, `bridges`: of each cell.
    - `losses`: of each path of heat that is not linear, in float32, because they are a small part
      of the heat (`ModalField`); empty for none. `near`: the node at which it begins, `far`: that
      at which it ends, as in `LossPaths`; `held`: the deviations of its end if this is a body of a
      given temperature, K; empty for paths of the plate alone.
    - `reference`: the temperature from which deviations are counted, K.
    - `lag`: of the driver, s. `drift`: of the ambient, K/s. Both may be None.
    - `cold`, `hot`: the nodes of the cells' sides.
    """

    conductance: Scalars
    inverse_capacitance: Scalars
    to_ambient: Scalars
    held_heat: Scalars
    modules: list[ThermoelectricModule]
    bridges: list[Bridge]
    losses: list[NonlinearLoss]
    reference: Float[Array, "*draws"]
    lag: Float[Array, "*draws"] | None
    drift: Float[Array, "*draws"] | None
    held: Scalars
    entries: tuple[Entry, ...] = eqx.field(static=True)
    cold: tuple[int, ...] = eqx.field(static=True)
    hot: tuple[int, ...] = eqx.field(static=True)
    near: tuple[int, ...] = eqx.field(static=True, default=())
    far: tuple[int, ...] = eqx.field(static=True, default=())

    @classmethod
    def of(
        cls, system: System, reference: Float[Array, ""], drift: Float[Array, ""] | None
    ) -> "ScalarNetwork":
        """Takes a system of one draw, or of many under `jax.vmap`, apart."""
        wiring, module, bridge, loss = system.wiring, system.module, system.bridge, system.loss
        nodes, cells = range(system.capacitance.size), range(len(wiring.cold))
        entries = SparseLU(network_pattern(wiring)).entries
        inverse, held = 1 / system.capacitance, system.reservoirs
        heat = None if held is None else held.heat(reference)
        ends, paths = system.far_ends(reference), wiring.loss_paths

        def number(leaf: Array, cell: int) -> Array:
            return jnp.broadcast_to(leaf, (len(cells),))[cell]

        return cls(
            conductance=[system.conductance[i, j] for i, j in entries],
            inverse_capacitance=[inverse[k] for k in nodes],
            to_ambient=[system.ambient_conductance[k] for k in nodes],
            held_heat=[] if heat is None else [heat[k] for k in nodes],
            modules=[jax.tree.map(lambda leaf, k=k: number(leaf, k), module) for k in cells],
            bridges=[
                replace(
                    jax.tree.map(lambda leaf, k=k: number(leaf, k), bridge),
                    heaters=bridge.heaters[k : k + 1],
                    own_supply=bridge.own_supply[k : k + 1],
                )
                for k in cells
            ],
            losses=[]
            if loss is None
            else [
                in_precision(jax.tree.map(lambda leaf, k=k: leaf[k], loss), jnp.float32)
                for k in range(loss.film.size)
            ],
            reference=reference,
            lag=system.lag,
            drift=drift,
            entries=entries,
            cold=tuple(map(int, wiring.cold)),
            hot=tuple(map(int, wiring.hot)),
            held=[] if ends is None else [ends.held[k] for k in range(ends.held.size)],
            near=() if paths is None else tuple(map(int, paths.near)),
            far=() if paths is None else tuple(map(int, paths.far)),
        )

    def slope(self, rises: Scalars, duty: Scalars, ambient: Float[Array, "*#draws"]) -> Scalars:
        """The rate of change of each temperature, K/s.

        **Arguments:**

        - `rises`: the deviations from the reference, K.
        - `duty`: of each cell, -1 to 1.
        - `ambient`: the deviation of the ambient from the reference, K.
        """
        heat = [g * ambient for g in self.to_ambient]
        for k, held in enumerate(self.held_heat):
            heat[k] = heat[k] + held
        for (i, j), g in zip(self.entries, self.conductance, strict=True):
            heat[i] = heat[i] - g * rises[j]
        for k, loss in enumerate(self.losses):
            near, far = self.near[k], self.far[k]
            lost = loss.heat(*self._of_loss(k, rises, ambient)).astype(ambient.dtype)
            heat[near] = heat[near] - lost
            if far >= 0:
                heat[far] = heat[far] + lost
        for k in range(len(self.cold)):
            cold, hot = self._cell_heat(k, rises[self.cold[k]], rises[self.hot[k]], duty[k])
            heat[self.cold[k]] = heat[self.cold[k]] - cold
            heat[self.hot[k]] = heat[self.hot[k]] + hot
        return [q * inverse for q, inverse in zip(heat, self.inverse_capacitance, strict=True)]

    def jacobian(
        self, rises: Scalars, duty: Scalars, ambient: Float[Array, "*#draws"]
    ) -> dict[Entry, Float[Array, "*draws"]]:
        """The derivatives of the slopes by the temperatures that differ from 0, 1/s."""
        matrix = {entry: -g for entry, g in zip(self.entries, self.conductance, strict=True)}
        for k, loss in enumerate(self.losses):
            near, far = self.near[k], self.far[k]
            rise, cold = self._of_loss(k, rises, ambient)
            by_near = loss.slope(rise, cold).astype(ambient.dtype)
            matrix[near, near] = matrix[near, near] - by_near
            if far >= 0:
                # The rise falls as the far end gets warmer.
                by_far = -loss.slope(-rise, cold + rise).astype(ambient.dtype)
                matrix[near, far] = matrix[near, far] - by_far
                matrix[far, near] = matrix[far, near] + by_near
                matrix[far, far] = matrix[far, far] + by_far
        for k in range(len(self.cold)):
            sides = self.cold[k], self.hot[k]
            at = [rises[side] for side in sides]
            for side in (0, 1):
                seed = [
                    jnp.ones_like(x) if side == n else jnp.zeros_like(x) for n, x in enumerate(at)
                ]
                _, (cold, hot) = jax.jvp(
                    lambda c, h, k=k: self._cell_heat(k, c, h, duty[k]), tuple(at), tuple(seed)
                )
                matrix[sides[0], sides[side]] = matrix[sides[0], sides[side]] - cold
                matrix[sides[1], sides[side]] = matrix[sides[1], sides[side]] + hot
        return {(i, j): self.inverse_capacitance[i] * g for (i, j), g in matrix.items()}

    def time_slope(
        self,
        rises: Scalars,
        duty: Scalars,
        ambient: Float[Array, "*#draws"],
        duty_slope: Scalars,
        ambient_slope: Float[Array, "*draws"],
    ) -> Scalars:
        """The change of the slopes with the inputs alone, K/s^2, while these change at the given
        rates."""
        _, slope = jax.jvp(
            lambda duty, ambient: self.slope(rises, duty, ambient),
            (duty, ambient),
            (duty_slope, ambient_slope),
        )
        return slope

    def _of_loss(self, k: int, rises: Scalars, ambient: Array) -> tuple[Array, Array]:
        """The arguments of a loss."""
        far = self.far[k]
        end = rises[far] if far >= 0 else ambient if far == -1 else self.held[k]
        return in_precision((rises[self.near[k]] - end, self.reference + end), jnp.float32)

    @property
    def pattern(self) -> Bool[np.ndarray, "nodes nodes"]:
        """Whether the slope of a node depends on the temperature of a node."""
        nodes = len(self.inverse_capacitance)
        pattern = np.zeros((nodes, nodes), bool)
        pattern[tuple(np.transpose(self.entries))] = True
        return pattern

    def _cell_heat(
        self, k: int, cold: Float[Array, "*draws"], hot: Float[Array, "*draws"], duty: Array
    ) -> tuple[Array, Array]:
        heat = self.bridges[k].heat(
            self.modules[k], duty, cold + self.reference, hot + self.reference
        )
        return heat.cold, heat.hot


def network_pattern(wiring: Wiring) -> Bool[np.ndarray, "nodes nodes"]:
    """Whether the slope of a node depends on the temperature of a node: on its own, on those of its
    neighbours, and across a cell."""
    nodes = len(wiring.netlist.nodes)
    pattern = np.eye(nodes, dtype=bool)
    first, second = wiring.pairs
    pattern[first, second] = pattern[second, first] = True
    pattern[wiring.cold, wiring.hot] = pattern[wiring.hot, wiring.cold] = True
    return pattern
