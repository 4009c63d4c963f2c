"""Renders camera frames of a twin, whose channels have exactly the twin's readings."""

from dataclasses import replace
from typing import final

import jax
import numpy as np
from jaxtyping import Float, UInt16

from ..._celsius import ZERO_CELSIUS
from ...physics import System, Twin, pixel_weights
from ...rig import Camera, Channel, NodesSensor, Rig


@final
class VirtualPicture:
    """Renders frames of a twin, linear in its temperatures.

    A pixel is the mean by area of the plate elements, and of the surroundings, that it covers. The
    smallest correction (least squares) is added that makes each channel's mean equal to its
    reading, including its gain. It represents the uneven emissivity of the surface, of which only
    the means over the channels are known.
    """

    def __init__(self, twin: Twin, camera: Camera, system: System):
        rig = twin.rig
        self._shape = (camera.height, camera.width)
        elements = _elements(rig, camera)
        nodes = len(twin.netlist.nodes)
        plain = np.zeros((self._shape[0] * self._shape[1], nodes))
        plain[:, : elements.shape[1]] = elements
        means = pixel_weights(rig).reshape(len(rig.channels), -1)
        with jax.enable_x64(True):
            wanted = np.asarray(system.output_matrices()[0])
        spread = np.linalg.pinv(means)
        self._map = plain + spread @ (wanted - means @ plain)
        offset = np.zeros(len(means)) if system.offset is None else np.asarray(system.offset)
        self._offset = (spread @ offset).reshape(self._shape)

    def frame(
        self,
        nodes: Float[np.ndarray, " nodes"],
        ambient: float,
        error: Float[np.ndarray, "height width"] | float = 0.0,
    ) -> UInt16[np.ndarray, "height width"]:
        """Returns a frame in units of 0.01 K, for temperatures in degC and an error of the camera
        in K."""
        rise = (self._map @ (nodes - ambient)).reshape(self._shape)
        celsius = ambient + rise + self._offset + error
        return np.clip(np.rint((celsius + ZERO_CELSIUS) * 100), 0, 65535).astype(np.uint16)


def _elements(rig: Rig, camera: Camera) -> Float[np.ndarray, "pixels elements"]:
    """The fraction of each pixel that each element of the plate covers."""
    plate = rig.plate
    names = plate.element_names
    channels = tuple(Channel(name, NodesSensor((name,))) for name in names)
    shares = pixel_weights(replace(rig, channels=channels)).reshape(len(names), -1)
    x = (camera.view_x[1] - camera.view_x[0]) / plate.width
    y = (camera.view_y[1] - camera.view_y[0]) / plate.height
    extents = np.array([plate.extent(name) for name in names])
    areas = (extents[:, 1] - extents[:, 0]) * x * (extents[:, 3] - extents[:, 2]) * y
    return (shares * areas[:, None]).T
