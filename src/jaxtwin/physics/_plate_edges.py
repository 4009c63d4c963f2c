"""Measures the camera's registration from the edges of the plate in a frame."""

import math
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float, Shaped

from .._arguments import of_kind
from ..errors import RigError
from ..rig import Rig
from ._camera import checked_frames

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
