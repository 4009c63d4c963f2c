r"""A rig's equations with numbers in them: the thermal network coupled to its cells.

For every node, with $x$ the deviation of temperatures from a constant reference $T_{ref}$ (the
ambient temperature at the start), $u$ the duty cycles and $a$ the ambient's own deviation:

$$C \dot x = -G x + g_{amb} a + q(x, u, a)$$

$G$ is the conductance matrix of the network. $q$ has three parts: the heat that the cells move (eq.
9 of the paper), which acts only on the two sides of each cell; the losses of the plate and the heat
in links beyond $G$, if these are nonlinear; and the constant heat of bodies at a fixed temperature.
Deviations instead of temperatures near 300 K keep float32 usable.
"""

from dataclasses import replace
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._lapack import solve
from ._driver import Bridge, CellHeat
from ._heat_loss import FarEnds, NonlinearLoss
from ._input_effects import Conditions
from ._netlist import OWN_VOLTAGE
from ._thermoelectric import ThermoelectricModule
from ._wiring import Wiring


@final
class Reservoirs(eqx.Module):
    """Bodies at fixed temperatures, beside the surroundings: coolant, an ice bath.

    **Arguments:**

    - `conductance`: the conductance from each node to each body, W/K.
    - `temperature`: the absolute temperature of each body, K.
    """

    conductance: Float[Array, "reservoirs nodes"]
    temperature: Float[Array, " reservoirs"]

    def heat(self, reference: Float[Array, ""]) -> Float[Array, " nodes"]:
        """The heat that would flow from them into nodes at the reference temperature (K), W."""
        return (self.temperature - reference) @ self.conductance


@final
class System(eqx.Module):
    """The network of a twin for one set of parameter values, all in SI units.

    **Arguments:**

    - `capacitance`: the heat capacities of the nodes, J/K.
    - `conductance`: $G$, symmetric, with the links to the surroundings and to reservoirs on its
      diagonal, W/K.
    - `ambient_conductance`: the conductance of each node to the surroundings, W/K.
    - `module`: constants of the cells.
    - `bridge`: supply and switches.
    - `ambient_temperature` (at the start), `initial_temperature` of the nodes: absolute, K.
    - `ambient_drift`: the rate at which the ambient changes from there, K/s, or None.
    - `gain`: the gains of the channels. `moved_weights`: the weights of the nodes in the channels
      after the camera's registration; None if those of the wiring apply.
    - `loss`: the heat flows beyond those of the network's links, None for none.
    - `reservoirs`: the bodies that are held at fixed temperatures, None for none.
    - `lag`, `delay`: the lag and the delay between the command and the duty cycle that reaches the
      cells, s, or None.
    - `is_valid`: whether all resistances and capacitances are above 0.
    - `input_values`: the parameters on which the effects of inputs depend, None without inputs.
    - `conductance_change`: the conductances of the links that inputs change, as differences from
      those in `conductance`, W/K; None where no input is stated.
    - `offset`: what a fault adds to each reading, K; None for nothing.
    """

    capacitance: Float[Array, " nodes"]
    conductance: Float[Array, "nodes nodes"]
    ambient_conductance: Float[Array, " nodes"]
    module: ThermoelectricModule
    bridge: Bridge
    ambient_temperature: Float[Array, ""]
    ambient_drift: Float[Array, ""] | None
    initial_temperature: Float[Array, " nodes"]
    gain: Float[Array, " channels"]
    moved_weights: Float[Array, "channels nodes"] | None
    loss: NonlinearLoss | None
    reservoirs: Reservoirs | None
    lag: Float[Array, ""] | None
    delay: Float[Array, ""] | None
    is_valid: Bool[Array, ""]
    wiring: Wiring = eqx.field(static=True)
    input_values: dict[str, Float[Array, ""]] | None = None
    conductance_change: Float[Array, " links"] | None = None
    offset: Float[Array, " channels"] | None = None

    @classmethod
    def assemble(
        cls,
        wiring: Wiring,
        values_si: dict[str, Float[Array, ""]],
        conductances: Float[Array, " links"] | None = None,
        radiating: Float[Array, " elements"] | None = None,
    ) -> "System":
        """Puts numbers into a wiring.

        **Arguments:**

        - `conductances` of the links, W/K, and `radiating` areas of the elements, m^2: given where
          the places of cells determine hundreds of values, which then need not be among
          `values_si`; None for those of the values.
        """
        if conductances is None:
            conductances = wiring.conductances(values_si)
            resistances = wiring.resistances(values_si)
        else:
            resistances = 1 / conductances
        effects = wiring.input_wiring
        ambient = wiring.ambient_sums(conductances)
        seebeck, electrical, thermal = wiring.module_constants(values_si).reshape(3, -1)
        voltage, supply, on = wiring.bridge_constants(values_si)
        lag, delay, drift, limit = (
            part and part(values_si)[0]
            for part in (wiring.lag, wiring.delay, wiring.ambient_drift, wiring.current_limit)
        )
        capacitance = wiring.capacitances(values_si)
        positive = [
            resistances,
            capacitance,
            electrical,
            thermal,
            supply + on + electrical,
        ]
        positive += [part for part in (lag, delay, limit) if part is not None]
        positive += [values_si[name] for name in wiring.on_plate]
        if effects is not None:
            positive.append(effects.own_conductances(values_si))
        return cls(
            capacitance=capacitance,
            conductance=_conductance_matrix(wiring, conductances),
            ambient_conductance=ambient,
            module=ThermoelectricModule(seebeck, electrical, thermal),
            bridge=Bridge(
                supply_voltage=voltage,
                supply_resistance=supply,
                on_resistance=on,
                averaging=wiring.averaging,
                off_phase=wiring.off_phase,
                current_limit=limit,
                heaters=wiring.heaters,
                own_supply=wiring.own_supply,
                own_voltage=jnp.asarray(OWN_VOLTAGE.factor, capacitance.dtype),
                drive_exponent=wiring.drive_exponents and wiring.drive_exponents(values_si),
            ),
            ambient_temperature=wiring.ambient(values_si)[0],
            ambient_drift=drift,
            initial_temperature=wiring.initial(values_si),
            gain=wiring.gains(values_si),
            moved_weights=wiring.moved_weights(values_si),
            loss=_loss(wiring, values_si, conductances, radiating),
            reservoirs=_reservoirs(wiring, values_si, conductances),
            lag=lag,
            delay=delay,
            is_valid=jnp.stack([jnp.all(values > 0) for values in positive]).all(),
            wiring=wiring,
            input_values=None if effects is None else effects.used(values_si),
        )

    def conditions(self, levels: Float[Array, " inputs"]) -> Conditions:
        """What the inputs of a moment change: the numbers of their states, or their values in SI
        units, in the order of `wiring.inputs`."""
        assert self.wiring.input_wiring is not None
        assert self.input_values is not None
        return self.wiring.input_wiring.conditions(self.input_values, levels)

    def under(self, conditions: Conditions) -> "System":
        """The equations under the inputs of a moment."""
        bridge = eqx.tree_at(
            lambda bridge: bridge.supply_voltage, self.bridge, conditions.supply_voltage
        )
        reservoirs = self.reservoirs
        if reservoirs is not None:
            temperature = reservoirs.temperature + conditions.reservoirs
            reservoirs = Reservoirs(reservoirs.conductance, temperature)
        changed = self.conductance_change
        changed = conditions.conductance if changed is None else changed + conditions.conductance
        return replace(self, bridge=bridge, reservoirs=reservoirs, conductance_change=changed)

    def held_differences(
        self, reference: Float[Array, ""], ambient_deviation: Float[Array, ""] | float
    ) -> Float[Array, " links"]:
        """The part of the temperature differences of the links that inputs change which does not
        depend on the nodes: that of ends at the surroundings and at bodies of a given temperature,
        K."""
        effects = self.wiring.input_wiring
        assert effects is not None
        dtype = reference.dtype
        held = jnp.asarray(effects.to_ambient, dtype) * ambient_deviation
        if self.reservoirs is not None:
            above = self.reservoirs.temperature - reference
            held = held + jnp.asarray(effects.to_reservoir, dtype) @ above
        return held

    def cell_heat(
        self, side_temperatures: Float[Array, " sides"], duty: Float[Array, " cells"]
    ) -> CellHeat:
        """Heat flows of the cells.

        **Arguments:**

        - `side_temperatures`: all cold sides, then all hot sides; absolute, K.
        - `duty`: -1 to 1.
        """
        cold, hot = jnp.split(side_temperatures, 2)
        return self.bridge.heat(self.module, duty, cold, hot)

    def heat_into_nodes(
        self,
        deviation: Float[Array, " nodes"],
        duty: Float[Array, " cells"],
        reference: Float[Array, ""],
        ambient_deviation: Float[Array, ""] | float = 0.0,
    ) -> Float[Array, " nodes"]:
        """The right-hand side $-G x + g_{amb} a + q(x, u, a)$, with the heat of reservoirs, W.

        The default solver has the same heats in the modes of the network: `ModalField.force` in
        `simulation/_exponential.py`.
        """
        others = self.heat_without_conduction(deviation, duty, reference, ambient_deviation)
        return others - self.conductance @ deviation

    def heat_without_conduction(
        self,
        deviation: Float[Array, " nodes"],
        duty: Float[Array, " cells"],
        reference: Float[Array, ""],
        ambient_deviation: Float[Array, ""] | float = 0.0,
    ) -> Float[Array, " nodes"]:
        """The right-hand side without the conductance matrix, $g_{amb} a + q(x, u, a)$, W."""
        wiring = self.wiring
        sides = np.concatenate([wiring.cold, wiring.hot])
        heat = self.cell_heat(deviation[sides] + reference, duty)
        flow = self.ambient_conductance * ambient_deviation
        if self.reservoirs is not None:
            flow = flow + self.reservoirs.heat(reference)
        if self.loss is not None:
            assert wiring.loss_paths is not None
            ends = self.loss_ends(deviation, reference, ambient_deviation)
            flow = wiring.loss_paths.into_nodes(self.loss.heat(*ends), flow)
        if self.conductance_change is not None and wiring.input_wiring is not None:
            incidence = jnp.asarray(wiring.input_wiring.differences, deviation.dtype)
            difference = incidence @ deviation + self.held_differences(reference, ambient_deviation)
            flow = flow - (self.conductance_change * difference) @ incidence
        return flow.at[wiring.cold].add(-heat.cold).at[wiring.hot].add(heat.hot)

    def far_ends(self, reference: Float[Array, ""]) -> FarEnds | None:
        """The far ends of nonlinear paths that are no nodes; None for the plate's alone, which
        all end at the surroundings."""
        paths = self.wiring.loss_paths
        if paths is None or paths.is_of_plate:
            return None
        held = jnp.zeros(len(paths.far), reference.dtype)
        if self.reservoirs is not None:
            to = np.flatnonzero(paths.far < -1)
            above = self.reservoirs.temperature - reference
            held = held.at[to].set(above[-2 - paths.far[to]])
        return FarEnds(jnp.asarray(paths.far == -1, reference.dtype), held)

    def loss_ends(
        self,
        deviation: Float[Array, " nodes"],
        reference: Float[Array, ""],
        ambient_deviation: Float[Array, ""] | float = 0.0,
    ) -> tuple[Float[Array, " paths"], Float[Array, "*paths"]]:
        """The arguments of `loss` at these deviations of the nodes."""
        paths = self.wiring.loss_paths
        assert paths is not None
        far = self.far_ends(reference)
        at_far = None if far is None else paths.at_far(deviation)
        return paths.ends(paths.across(deviation), at_far, far, reference, ambient_deviation)

    def steady_state(
        self, duty: Float[Array, " cells"], reference: Float[Array, ""]
    ) -> Float[Array, " nodes"]:
        """The deviation at rest under a constant duty.

        The reference is the ambient temperature here, so that the surroundings deviate by 0.
        Newton's method starts at the state of the linear network; with one or two cells a few
        iterations reach the limit of rounding.
        """

        def residual(deviation: Float[Array, " nodes"]) -> Float[Array, " nodes"]:
            return self.heat_into_nodes(deviation, duty, reference)

        def newton(_: Int[Array, ""], deviation: Float[Array, " nodes"]) -> Float[Array, " nodes"]:
            slope = jax.jacfwd(residual)(deviation)
            return deviation - solve(slope, residual(deviation))

        return jax.lax.fori_loop(0, 12, newton, jnp.zeros_like(self.capacitance))

    @property
    def channel_weights(self) -> Float[Array | np.ndarray, "channels nodes"]:
        """The weight of each node in the temperature that each channel reads."""
        return self.wiring.channel_weights if self.moved_weights is None else self.moved_weights

    @property
    def on_plate(self) -> Float[Array, " channels"] | float:
        """The fraction of the zone of each channel that lies on the plate."""
        return 1.0 if self.moved_weights is None else self.moved_weights.sum(axis=1)

    def channel_temperatures(
        self,
        deviation: Float[Array, "*times nodes"],
        ambient_deviation: Float[Array, "*times 1"] | float = 0.0,
    ) -> Float[Array, "*times channels"]:
        """The readings of the channels for the temperatures of the nodes, as `readings`."""
        weights = jnp.asarray(self.channel_weights, deviation.dtype)
        return self.readings(deviation @ weights.T, ambient_deviation)

    def rises(
        self,
        zone_deviation: Float[Array, "*times channels"],
        ambient_deviation: Float[Array, "*times 1"] | Float[Array, ""] | float = 0.0,
        columns: Int[Array | np.ndarray, " channels"] | slice = slice(None),
    ) -> Float[Array, "*times channels"]:
        """The temperatures above the ambient that the channels see; a part of a zone that lies
        beside the plate is at the ambient temperature.

        **Arguments:**

        - `zone_deviation`: the mean over the zone of each channel, weighted by `channel_weights`,
          as a deviation from the reference.
        - `columns`: the positions of these channels among those of the rig.
        """
        on_plate = jnp.broadcast_to(self.on_plate, self.gain.shape)[columns]
        return zone_deviation - on_plate * ambient_deviation

    def readings(
        self,
        zone_deviation: Float[Array, "*times channels"],
        ambient_deviation: Float[Array, "*times 1"] | Float[Array, ""] | float = 0.0,
        columns: Int[Array | np.ndarray, " channels"] | slice = slice(None),
    ) -> Float[Array, "*times channels"]:
        """The readings of the channels as deviations from the reference, ambient + gain * rise
        (+ offset), for the arguments of `rises`."""
        rise = self.rises(zone_deviation, ambient_deviation, columns)
        read = self.gain[columns] * rise + ambient_deviation
        return read if self.offset is None else read + self.offset[columns]

    def output_matrices(
        self,
    ) -> tuple[Float[Array, "channels nodes"], Float[Array, " channels"]]:
        """$C$ and $d$ of the readings $y = C x + d a$, with the deviations $x$ of the nodes and $a$
        of the ambient: the formula of `readings` as numbers, without an offset."""
        gain = jnp.asarray(self.gain)
        return gain[:, None] * jnp.asarray(self.channel_weights), 1 - gain * self.on_plate


def conductance_entries(
    wiring: Wiring, conductances: Float[Array, " links"]
) -> tuple[Float[Array, " pairs"], Float[Array, " nodes"]]:
    """The entries of the conductance matrix of a large network that are not 0: those beside the
    diagonal, with the opposite sign, for `wiring.pairs`, and the diagonal, W/K."""
    pairs, (a, b) = wiring.pair_sums(conductances), wiring.pairs
    return pairs, _to_held(wiring, conductances).at[a].add(pairs).at[b].add(pairs)


def _conductance_matrix(
    wiring: Wiring, conductances: Float[Array, " links"]
) -> Float[Array, "nodes nodes"]:
    if wiring.pair_of is not None:
        pairs = wiring.pair_sums(conductances)
        between = jnp.append(pairs, jnp.zeros((), pairs.dtype))[wiring.pair_of]
        return jnp.diag(between.sum(axis=1) + _to_held(wiring, conductances)) - between
    pairs, diagonal = conductance_entries(wiring, conductances)
    (a, b), nodes = wiring.pairs, np.arange(diagonal.size)
    rows, columns = np.concatenate([a, b, nodes]), np.concatenate([b, a, nodes])
    matrix = jnp.zeros((nodes.size, nodes.size), pairs.dtype)
    # A single assignment is used, because each one may copy the matrix.
    return matrix.at[rows, columns].set(jnp.concatenate([-pairs, -pairs, diagonal]))


def _to_held(wiring: Wiring, conductances: Float[Array, " links"]) -> Float[Array, " nodes"]:
    """The conductance from each node to everything at a fixed temperature, with the surroundings,
    W/K."""
    to_ambient = wiring.ambient_sums(conductances)
    if wiring.reservoir_sums is None:
        return to_ambient
    to_reservoirs = wiring.reservoir_sums(conductances).reshape(-1, to_ambient.size)
    return to_ambient + to_reservoirs.sum(axis=0)


def _reservoirs(
    wiring: Wiring,
    values_si: dict[str, Float[Array, ""]],
    conductances: Float[Array, " links"],
) -> Reservoirs | None:
    if wiring.reservoirs is None or wiring.reservoir_sums is None:
        return None
    temperature = wiring.reservoirs(values_si)
    sums = wiring.reservoir_sums(conductances)
    return Reservoirs(sums.reshape(temperature.size, -1), temperature)


def _loss(
    wiring: Wiring,
    values_si: dict[str, Float[Array, ""]],
    conductances: Float[Array, " links"],
    radiating: Float[Array, " elements"] | None,
) -> NonlinearLoss | None:
    if wiring.exponent is None or wiring.radiating is None or wiring.film_sums is None:
        return None
    film, paths = wiring.film_sums(conductances), wiring.loss_paths
    if wiring.convection is not None:
        film = jnp.concatenate([film, wiring.convection(values_si)])
    return NonlinearLoss(
        film=film,
        exponent=wiring.exponent(values_si),
        radiating=wiring.radiating(values_si) if radiating is None else radiating,
        linear=None
        if paths is None or paths.is_of_plate
        else jnp.asarray(paths.linear, film.dtype),
    )
