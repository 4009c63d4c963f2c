r"""The camera's registration: how the zones of its picture lie on the plate.

A zone is a fixed rectangle of the picture. The place of the picture on the plate differs from day
to day: the point that the rig file calls $p$ is really at

$$p' = c + d + s R(\varphi) (p - c)$$

with the plate's centre $c$ and the shift $d$, scale $s$ and rotation $\varphi$ of the rig's
`Registration`.

Zones often end at the plate's outline, where the picture steps from the plate to the surroundings.
Optics and pixels spread this step over about a pixel (at wavelengths of 10 um the optics of small
cameras resolve no less). With a sharp step, the cost of a match would have a kink at exactly the
registration at which the zones lie as in the rig file, and matches would stop there.
"""

from collections.abc import Mapping
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..rig import Registration, Rig, ZoneSensor
from ..rig._zone_means import mean_weights
from ._expressions import Expressions

# The number of tiles into which a zone is divided in each direction. The tiles move with the
# picture and stay parallel to the plate's edges, which is exact without rotation. With rotation the
# edge of a zone becomes a staircase, whose steps at 5 degrees have 2 % of the zone's height.
TILES = 4


@final
class RegisteredZones:
    """The zones of a rig whose camera has a registration.

    - `registration`: shift in x and y, scale and rotation, as `Expressions`.
    - `pixel_size`: width and height of a pixel on the plate, m.
    """

    def __init__(self, rig: Rig, registration: Registration):
        plate = rig.plate
        self.registration = Expressions(
            [
                [registration.shift_x],
                [registration.shift_y],
                [registration.scale],
                [registration.rotation],
            ]
        )
        self._edges = np.array(plate.column_edges), np.array(plate.row_edges)
        self._middle = np.array([plate.width, plate.height]) / 2
        camera = rig.camera
        assert camera is not None
        views = (camera.view_x, camera.view_y)
        sizes = zip((plate.width, plate.height), views, strict=True)
        self.pixel_size = tuple(size / (view[1] - view[0]) for size, view in sizes)
        sensors = [c.sensor for c in rig.channels if isinstance(c.sensor, ZoneSensor)]
        ranges = np.array([(zone.x, zone.y) for zone in sensors], float)
        tile_middles = (np.arange(TILES) + 0.5) / TILES
        low, size = ranges[..., 0], ranges[..., 1] - ranges[..., 0]
        middles = low[..., None] + size[..., None] * tile_middles  # (channels, axes, tiles)
        x, y = middles[:, 0, None, :], middles[:, 1, :, None]
        tiles = np.stack(np.broadcast_arrays(x, y), axis=1).reshape(len(ranges), 2, -1)
        self._tiles = tiles - self._middle[:, None]
        self._half_sizes = size[..., None] / TILES / 2

    def element_weights(
        self,
        values_si: Mapping[str, Float[Array, ""]],
        moved: tuple[Float[ArrayLike, ""], Float[ArrayLike, ""]] = (0.0, 0.0),
    ) -> Float[Array, "channels elements"]:
        """The weight of each plate element in the mean over each channel's zone, where the picture
        has `moved` by so much in addition, m.

        Rows of zones that reach beyond the plate sum to less than 1: the camera sees the
        surroundings there. In a zone that ends at the outline, they take an eighth of a pixel's
        width.
        """
        shift_x, shift_y, scale, rotation = self.registration(values_si)
        cos, sin = scale * jnp.cos(rotation), scale * jnp.sin(rotation)
        x, y = self._tiles[:, 0], self._tiles[:, 1]
        shift_x, shift_y = shift_x + moved[0], shift_y + moved[1]
        middles = cos * x - sin * y + shift_x, sin * x + cos * y + shift_y
        along = []
        for axis, middle in enumerate(middles):
            centre = self._middle[axis] + middle
            half = scale * self._half_sizes[:, axis]
            blur = scale * self.pixel_size[axis]
            along.append(mean_weights(self._edges[axis], centre - half, centre + half, blur))
        weights = jnp.einsum("ctx,cty->cyx", *along) / TILES**2
        return weights.reshape(len(weights), -1)
