r"""What inputs change in the equations: links, the supply's voltage, bodies at a given temperature.

A system holds the values that apply where no input is stated. A link whose conductance then is
$g_0$, and $g$ under the inputs of a moment, carries $(g - g_0)$ times the temperature difference at
its ends in addition. The nodes and the links are therefore the same for all inputs. The simulation
finds the modes of the network under each regime of the inputs (`simulation/_integrate.py`), and
only what a moment's inputs change beyond its regime is a force in these modes.
"""

from collections.abc import Mapping
from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..rig import Input, Rig, Value
from ..rig._plate import AMBIENT
from ..rig._value import depends_on
from ._expressions import Expressions
from ._netlist import Netlist


@final
class Conditions(eqx.Module):
    """The equations' changes under the inputs of a moment, or of many, with a leading axis.

    - `conductance`: the conductances of the links that inputs change, as differences from those
      where no input is stated, W/K.
    - `reservoirs`: the same for the temperatures of bodies, K.
    - `supply_voltage`: the voltage of the supply, V.
    """

    conductance: Float[Array, "*moments links"]
    reservoirs: Float[Array, "*moments reservoirs"]
    supply_voltage: Float[Array, "*moments"]


@final
class InputWiring:
    """The parts of a rig that its inputs change, as constant arrays and expressions.

    - `inputs`: the inputs, in the order of all arrays.
    - `links`: the numbers of the links that inputs change, and their `conductances`, which are sums
      of products; `own_conductances`: these products without the inputs, such as the conductance
      of a link in each state.
    - `differences` (links, nodes): the temperature at the end of each of these links minus that at
      its start, as far as these are nodes; `to_ambient` (links,) and `to_reservoir` (links,
      reservoirs): the same for ends at the surroundings and at bodies of a given temperature.
    - `reservoirs`, `supply_voltage`: the other values that inputs may change.
    """

    def __init__(self, rig: Rig, netlist: Netlist):
        self.inputs: tuple[Input, ...] = rig.inputs
        changed = [
            number
            for number, link in enumerate(netlist.links)
            if any(depends_on(value, rig.inputs) for value in link.conductances)
        ]
        self.links = np.array(changed, np.int32)
        chosen = [netlist.links[number] for number in self.links]
        self.conductances = Expressions([link.conductances for link in chosen])
        names = {name for rig_input in rig.inputs for name in rig_input.names}
        own = (
            tuple(power for power in product.powers if power[0] not in names)
            for product in self.conductances.products
        )
        self.own_conductances = Expressions([[Value(1.0, powers)] for powers in own])
        nodes, held = netlist.index, [reservoir.name for reservoir in netlist.reservoirs]
        self.differences = np.zeros((len(chosen), len(nodes)))
        self.to_ambient = np.array([float(link.b == AMBIENT) for link in chosen])
        self.to_reservoir = np.zeros((len(chosen), len(held)))
        for row, link in enumerate(chosen):
            self.differences[row, nodes[link.a]] = -1.0
            if link.b in nodes:
                self.differences[row, nodes[link.b]] = 1.0
            elif link.b != AMBIENT:
                self.to_reservoir[row, held.index(link.b)] = 1.0
        self.reservoirs = Expressions([[reservoir.temperature] for reservoir in netlist.reservoirs])
        self.supply_voltage = Expressions([[rig.driver.supply_voltage]])

    def used(self, values_si: Mapping[str, Float[Array, ""]]) -> dict[str, Float[Array, ""]]:
        """The parameters on which the effects of the inputs depend."""
        tables = (self.conductances, self.reservoirs, self.supply_voltage)
        names = set().union(*(table.names for table in tables))
        inputs = {name for rig_input in self.inputs for name in rig_input.names}
        return {name: values_si[name] for name in sorted(names - inputs)}

    def conditions(
        self, values_si: Mapping[str, Float[Array, ""]], levels: Float[Array, " inputs"]
    ) -> Conditions:
        """The changes under given inputs.

        **Arguments:**

        - `values_si`: the parameters that `used` names.
        - `levels`: the numbers of the states, or the values in SI units.
        """
        parts = (self.conductances, self.reservoirs, self.supply_voltage)
        shares = {
            name: number
            for rig_input, level in zip(self.inputs, levels, strict=True)
            for name, number in rig_input.shares(level).items()
        }
        nominal = {
            name: jnp.asarray(number, levels.dtype)
            for rig_input in self.inputs
            for name, number in rig_input.nominal.items()
        }
        now = [part({**values_si, **shares}) for part in parts]
        before = [part({**values_si, **nominal}) for part in parts]
        return Conditions(now[0] - before[0], now[1] - before[1], now[2][0])
