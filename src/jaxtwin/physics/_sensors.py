r"""What is read of the plate: sensors, which nodes they weigh and how they follow them, and an
infrared camera, how pixels of its frames become channels.

A thermistor or thermocouple with a time constant $\tau$ (its lag) reads $T_s$, which follows the
temperature $T$ that it measures, a weighted mean over elements and bodies:

$$\tau \dot T_s = T - T_s$$

In the network it is a node of heat capacity $C_s$ with a link of $\tau / (w_i C_s)$ to each
element, whose weight in the mean is $w_i$. It must not affect the plate. $C_s$ is therefore the
fraction `RELATIVE_CAPACITY` of the heat capacity of an element: the heat that it takes changes
temperatures by about this fraction.
"""

from collections.abc import Sequence
from typing import final

import numpy as np
from jaxtyping import Float, Shaped

from .._arguments import of_kind
from ..errors import RigError
from ..rig import Camera, CommonError, Rig
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


# The infrared camera: how pixels of frames become channels, and its recalibrations.


def frame_to_channels(
    rig: Rig, frames: Shaped[np.ndarray, "*frames height width"]
) -> Float[np.ndarray, "*frames channels"]:
    """Computes the readings of the channels in camera frames, Fig. 5d of the paper.

    A channel is the mean of the pixels under its rectangle of the plate, each weighted by the area
    inside the rectangle, so that the edge of a zone may run through a pixel. A channel that is
    given by nodes is the plain mean over these elements, of which each is the mean of its pixels.

    **Arguments:**

    - `rig`: the rig, whose camera states which pixels show the plate.
    - `frames`: a frame `(height, width)` or many frames `(..., height, width)`, in any unit of
      temperature; row 0 is the top.

    **Returns:** `(..., channels)` in the order of the rig, in the unit of the frames.

    **Raises:** `RigError` if the frames do not have the camera's resolution, or the rig has no
    camera.
    """
    of_kind("frame_to_channels: rig", rig, Rig, "a Rig, as load_rig reads it", RigError)
    _, frames = checked_frames(rig, frames)
    return np.einsum("...hw,chw->...c", frames, pixel_weights(rig))


def checked_frames(
    rig: Rig, frames: Shaped[np.ndarray, "*frames height width"]
) -> tuple[Camera, Float[np.ndarray, "*frames height width"]]:
    """The camera of a rig and its frames.

    **Raises:** `RigError` if the frames do not have the camera's resolution, or the rig has no
    camera.
    """
    camera = _camera(rig)
    frames = np.asarray(frames)
    if frames.dtype.kind not in "iuf" or frames.ndim < 2:
        raise RigError(
            f"frames: expected numbers of shape (..., height, width), got {frames.dtype} values "
            f"of shape {frames.shape}"
        )
    if frames.shape[-2:] != (camera.height, camera.width):
        raise RigError(
            f"{rig.source}: camera.resolution: expected frames of {camera.width} x "
            f"{camera.height} pixels, got {frames.shape[-1]} x {frames.shape[-2]}"
        )
    return camera, np.asarray(frames, float)


def pixel_weights(rig: Rig) -> Float[np.ndarray, "channels height width"]:
    """The weight of each pixel in each channel; every channel sums to 1.

    **Raises:** `RigError` if the rig has no camera.
    """
    camera, plate = _camera(rig), rig.plate
    x = _pixel_edges(camera.width, camera.view_x, plate.width)
    y = _pixel_edges(camera.height, camera.view_y, plate.height)
    weights = np.zeros((len(rig.channels), camera.height, camera.width))
    for number, channel in enumerate(rig.channels):
        for x0, x1, y0, y1 in channel.sensor.outline(plate):
            area = np.outer(_covered(y, y0, y1), _covered(x, x0, x1))
            weights[number] += area / area.sum()
    return weights / weights.sum(axis=(1, 2), keepdims=True)


def _camera(rig: Rig) -> Camera:
    if rig.camera is None:
        raise RigError(f"{rig.source}: camera: expected a rig with a camera, got one without")
    return rig.camera


def _pixel_edges(pixels: int, view: tuple[float, float], size: float) -> np.ndarray:
    """Edges of the pixels of one axis in plate coordinates, m."""
    first, last = view
    return (np.arange(pixels + 1) - first) / (last - first) * size


def _covered(edges: np.ndarray, low: float, high: float) -> np.ndarray:
    """Length of each interval between neighbouring edges that lies between low and high."""
    return np.clip(np.minimum(edges[1:], high) - np.maximum(edges[:-1], low), 0, None)


# A camera's recalibrations: a shutter that closes, and an offset that jumps and fades.

# The time for which a recalibration freezes the image, s.
SHUTTER_SECONDS = 1.0

# Size (K) and duration (s) of a jump of the camera's offset, if the rig file states none.
JUMP_KELVIN, JUMP_DECAY = 0.8, 25.0


@final
class Recalibrations:
    r"""The recalibrations of a camera: the times at which its shutter is closed, and its offset.

    At a recalibration the offset jumps to $\sum_j b_j$ and fades as $\sum_j b_j e^{-t / \tau_j}$.
    The time constants are those of `[camera.common_error]`, and each $b_j$ is drawn from the prior
    that a match has for it: normal, with the standard deviation `jump`.

    The virtual rig and a simulated closed loop with the same seed see the same jumps.

    **Arguments:**

    - `interval`: the time between two recalibrations, s; 0: never.
    - `seed`: the seed of the jumps.
    - `common_error`: the common error in the rig file; None for `JUMP_KELVIN` and `JUMP_DECAY`.
    """

    def __init__(self, interval: float, seed: int, common_error: CommonError | None):
        self._interval = interval
        self._random = np.random.default_rng([seed, 1])
        self._size, relaxation = JUMP_KELVIN, (JUMP_DECAY,)
        if common_error is not None:
            self._size, relaxation = common_error.jump, common_error.relaxation
        self._relaxation = np.array(relaxation)
        self._jump = np.zeros(len(relaxation))
        self._at = 0.0

    def advance(self, time: float) -> None:
        """Advances to a time, s."""
        while self._interval and time >= self._at + self._interval:
            self._at += self._interval
            self._jump = self._random.normal(0, self._size, len(self._relaxation))

    def is_closed(self, time: float) -> bool:
        """Whether the shutter is closed."""
        return self._at > 0 and time - self._at < SHUTTER_SECONDS

    def offset(self, time: float) -> float:
        """Offset of all pixels, K."""
        return float(self._jump @ np.exp(-(time - self._at) / self._relaxation))
