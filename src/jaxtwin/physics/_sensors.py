r"""Sensors on the plate: how their temperature follows that of the plate, and which nodes the
channels read.

A thermistor or thermocouple with a time constant $\tau$ (its lag) reads $T_s$, which follows the
temperature $T$ that it measures, a weighted mean over elements and bodies:

$$\tau \dot T_s = T - T_s$$

In the network it is a node of heat capacity $C_s$ with a link of $\tau / (w_i C_s)$ to each
element, whose weight in the mean is $w_i$. It must not affect the plate. $C_s$ is therefore the
fraction `RELATIVE_CAPACITY` of the heat capacity of an element: the heat that it takes changes
temperatures by about this fraction.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..errors import RigError
from ..rig import Rig
from ._netlist import Link, Netlist, Node

# The heat capacity of a sensor, as a fraction of an element's.
RELATIVE_CAPACITY = 1e-6


def lagging_sensors(rig: Rig, nodes: Sequence[Node]) -> tuple[list[Node], list[Link]]:
    """The nodes of sensors that have a lag, and their links to the nodes that they touch.

    **Arguments:**

    - `rig`: the rig with the channels.
    - `nodes`: the nodes of the plate, the cells and the bodies. A sensor starts at the temperature
      of the first node that it touches.
    """
    sensors, links = [], []
    if all(channel.lag is None for channel in rig.channels):
        return sensors, links
    for channel in rig.channels:
        if channel.lag is None:
            continue
        weights = channel.sensor.weights(rig.plate)
        touched = [(node, weights[node.name]) for node in nodes if weights.get(node.name, 0) > 0]
        name, (first, _) = sensor_name(channel.name), touched[0]
        capacitance = first.capacitance * RELATIVE_CAPACITY
        sensors.append(Node(name, "sensor", capacitance, first.initial_temperature))
        links += [
            Link(node.name, name, (channel.lag / (capacitance * weight),), "sensor")
            for node, weight in touched
        ]
    return sensors, links


def node_weights(rig: Rig, netlist: Netlist) -> Float[np.ndarray, "channels nodes"]:
    """The weight of each node in each channel: the plate's elements and the bodies, or the sensor
    of a channel with a lag. Every row sums to 1.

    **Raises:** `RigError` for a sensor that weighs something else.
    """
    weights = np.zeros((len(rig.channels), len(netlist.nodes)))
    for row, channel in zip(weights, rig.channels, strict=True):
        lags = channel.lag is not None
        read = {sensor_name(channel.name): 1.0} if lags else channel.sensor.weights(rig.plate)
        unknown = [node for node in read if node not in netlist.index]
        if unknown:
            raise RigError(
                f"{rig.source}: channels[{channel.name}]: expected a sensor that weighs elements "
                f"of the plate and bodies, got {unknown[0]!r} in {type(channel.sensor).__name__}"
            )
        row[[netlist.index[node] for node in read]] = list(read.values())
    return weights


def channel_weights(rig: Rig) -> Float[np.ndarray, "channels elements"]:
    """The weight of each plate element in the temperature that each channel's sensor measures.
    Every row sums to 1, minus the part of bodies beside the plate."""
    rows = (channel.sensor.weights(rig.plate) for channel in rig.channels)
    return np.array([[row.get(name, 0.0) for name in rig.plate.element_names] for row in rows])


def sensor_name(channel: str) -> str:
    """The name of the node of a channel's sensor."""
    return f"{channel}.SENSOR"
