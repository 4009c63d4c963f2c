r"""Sensors on the plate: how their temperature follows that of the plate, and which nodes the
channels read.

A thermistor or thermocouple with a time constant $\tau$ (its lag) reads $T_s$, which follows the
mean $T$ of the elements that its channel names:

$$\tau \dot T_s = T - T_s$$

In the network it is a node of heat capacity $C_s$ with a link of $\tau / (w_i C_s)$ to each
element, whose weight in the mean is $w_i$. It must not affect the plate. $C_s$ is therefore the
fraction `RELATIVE_CAPACITY` of the heat capacity of an element: the heat that it takes changes
temperatures by about this fraction.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..rig import Channel, Rig
from ._camera import channel_weights
from ._netlist import Link, Netlist, Node

RELATIVE_CAPACITY = 1e-6
"""The heat capacity of a sensor, as a fraction of an element's."""


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
    named = {node.name: node for node in nodes}
    for channel, elements in zip(rig.channels, channel_weights(rig), strict=True):
        if channel.lag is None:
            continue
        touched = dict(zip(rig.plate.element_names, elements.tolist(), strict=True))
        touched |= _weights_of_bodies(rig, channel)
        touched = {node: weight for node, weight in touched.items() if weight > 0}
        name, first = sensor_name(channel.name), named[next(iter(touched))]
        capacitance = first.capacitance * RELATIVE_CAPACITY
        sensors.append(Node(name, "sensor", capacitance, first.initial_temperature))
        links += [
            Link(node, name, (channel.lag / (capacitance * weight),), "sensor")
            for node, weight in touched.items()
        ]
    return sensors, links


def node_weights(rig: Rig, netlist: Netlist) -> Float[np.ndarray, "channels nodes"]:
    """The weight of each node in each channel: the plate's elements and the bodies, or the sensor
    of a channel with a lag. Every row sums to 1."""
    elements = channel_weights(rig)
    weights = np.zeros((len(rig.channels), len(netlist.nodes)))
    weights[:, : elements.shape[1]] = elements
    for row, channel in zip(weights, rig.channels, strict=True):
        for body, weight in _weights_of_bodies(rig, channel).items():
            row[netlist.index[body]] = weight
        if channel.lag is not None:
            row[:] = 0.0
            row[netlist.index[sensor_name(channel.name)]] = 1.0
    return weights


def sensor_name(channel: str) -> str:
    """The name of the node of a channel's sensor."""
    return f"{channel}.SENSOR"


def _weights_of_bodies(rig: Rig, channel: Channel) -> dict[str, float]:
    bodies = {body.name for body in rig.bodies}
    return {node: 1 / len(channel.nodes) for node in channel.nodes if node in bodies}
