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

import math
from collections.abc import Mapping
from typing import NamedTuple, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Shaped

from .._arguments import of_kind
from ..errors import RigError
from ..rig import Registration, Rig, ZoneSensor
from ..rig._zone_means import mean_weights
from ._expressions import Expressions
from ._sensors import checked_frames

# The distance from an edge's place in the rig file within which it is searched, as a fraction of
# the plate's size.
SEARCH_FRACTION = 0.25

# The number of pixels beside the plate that are necessary to detect an edge.
MIN_OUTSIDE = 2

# A step between two pixels that is larger than this multiple of the camera's noise is an edge of
# the plate.
EDGE_SIGMAS = 5.0

Lines = Float[np.ndarray, "lines 2"]


@final
class MeasuredRegistration(NamedTuple):
    """Values for `[camera.registration]` of a rig file; NaN for those whose edges the frame does
    not show.

    - `shift_x`, `shift_y`: m. `scale`. `rotation`: rad.
    """

    shift_x: float
    shift_y: float
    scale: float
    rotation: float


def measure_registration(rig: Rig, frame: Shaped[np.ndarray, "..."]) -> MeasuredRegistration:
    """Measures the camera's registration in a frame of a warm plate.

    Across each edge of the plate the temperature changes within a pixel. The place of the edge is
    known to a fraction of a pixel, because a pixel that the edge cuts reads the mean by area.
    Straight lines through these places are the plate's outline.

    **Arguments:**

    - `rig`: the rig, whose camera states the plate's approximate place.
    - `frame`: `(height, width)`, in K or degC; row 0 is the top. A mean of several has less noise.

    **Returns:** the registration for the rig file, with which its zones lie where this camera sees
    them. A shift needs both edges across its direction inside the frame, with two pixels beside
    each; scale and rotation need two opposite edges. The registration of a recording without frames
    can only be matched.

    **Raises:** `RigError` if the frame does not have the camera's resolution, or the rig has no
    camera.
    """
    of_kind("measure_registration: rig", rig, Rig, "a Rig, as load_rig reads it", RigError)
    camera, pixels = checked_frames(rig, frame)
    if pixels.ndim != 2:
        raise RigError(
            f"frame: expected a single frame (height, width), got an array of shape {pixels.shape}"
        )
    sizes = (rig.plate.width, rig.plate.height)
    # Places in the picture are in metres of the plate from its middle, by the view of the rig file.
    # The left and the right edge come first, then the top and the bottom edge.
    view_x, view_y, (width, height) = camera.view_x, camera.view_y, sizes
    edges = [
        _edges(pixels, view_x, view_y, width, height, camera.noise),
        _edges(pixels.T, view_y, view_x, height, width, camera.noise),
    ]
    slopes, scales = [], []
    for (lines, size), sign in zip(zip(edges, sizes, strict=True), (-1, 1), strict=True):
        if lines is not None:
            (low, slope_low), (high, slope_high) = lines
            slope = (slope_low + slope_high) / 2
            slopes.append(sign * slope)
            scales.append((high - low) / math.hypot(1, slope) / size)
    if not slopes:
        return MeasuredRegistration(*[math.nan] * 4)
    angle, scale = math.atan(float(np.mean(slopes))), float(np.mean(scales))
    # The middles between opposite edges cross in the plate's middle.
    x, y = (math.nan if lines is None else float(lines[:, 0].mean()) for lines in edges)
    tangent = math.tan(angle)
    middle_x = x if math.isnan(y) else (x - tangent * y) / (1 + tangent**2)
    middle_y = y + tangent * (0.0 if math.isnan(x) else middle_x)
    cos, sin = math.cos(angle) / scale, math.sin(angle) / scale
    known_x, known_y = (0.0 if math.isnan(v) else v for v in (middle_x, middle_y))
    shift_x = -(cos * known_x + sin * known_y) if not math.isnan(x) else math.nan
    shift_y = -(-sin * known_x + cos * known_y) if not math.isnan(y) else math.nan
    return MeasuredRegistration(shift_x, shift_y, 1 / scale, -angle)


def _edges(
    pixels: Float[np.ndarray, "along across"],
    view_across: tuple[float, float],
    view_along: tuple[float, float],
    size_across: float,
    size_along: float,
    noise: float,
) -> Lines | None:
    """The place and slope of the first and of the last edge across rows of pixels; None if one of
    them is not detected."""
    first, last = view_along
    rows = np.arange(math.ceil(first + 0.1 * (last - first)), int(last - 0.1 * (last - first)))
    along = ((rows + 0.5 - first) / (last - first) - 0.5) * size_along
    lines = []
    for edge in view_across:
        reach = SEARCH_FRACTION * (view_across[1] - view_across[0])
        low, high = max(0, round(edge - reach)), min(pixels.shape[1], round(edge + reach))
        outside = edge - low if edge == view_across[0] else high - edge
        if outside < MIN_OUTSIDE:
            return None
        places = np.array([_step(pixels[row, low:high], noise) for row in rows]) + low
        visible = np.isfinite(places)
        if np.count_nonzero(visible) < max(3, len(rows) // 2):
            return None
        across = ((places - view_across[0]) / (view_across[1] - view_across[0]) - 0.5) * size_across
        lines.append(_line(along[visible], across[visible]))
    return np.array(lines)


def _step(profile: Float[np.ndarray, " pixels"], noise: float) -> float:
    """The position of the largest step of a row of pixels, in pixels; NaN if none is clear."""
    steps = np.diff(profile)
    at = int(np.argmax(np.abs(steps)))
    if abs(steps[at]) <= EDGE_SIGMAS * noise:
        return math.nan
    # A pixel that the edge cuts shares the step between both of its sides.
    near = slice(max(at - 1, 0), at + 2)
    share = np.clip(steps[near] / steps[at], 0.0, None)
    return float(share @ (np.arange(len(steps))[near] + 1) / share.sum())


def _line(x: Float[np.ndarray, " points"], y: Float[np.ndarray, " points"]) -> tuple[float, float]:
    """The height at 0 and the slope of a straight line. Places far from a first line are left
    out."""
    slope, height = np.polyfit(x, y, 1)
    away = np.abs(y - height - slope * x)
    kept = away <= 3 * np.median(away) + 1e-9
    slope, height = np.polyfit(x[kept], y[kept], 1)
    return float(height), float(slope)


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
