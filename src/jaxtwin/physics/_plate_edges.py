"""Where a frame shows the plate: the camera's registration from the plate's own edges."""

import math
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float, Shaped

from .._arguments import of_kind
from .._errors import RigError
from ..rig import Rig
from ._camera import checked_frames

MARGIN = 0.25
"""The range in which an edge is searched about its place in the rig file, as a fraction of the
plate's size."""

LEAST_OUTSIDE = 2
"""Pixels beside the plate without which an edge is not seen."""

CLEAR = 5.0
"""A step from pixel to pixel of so many times the camera's noise is the plate's edge."""

Lines = Float[np.ndarray, "lines 2"]


@final
class MeasuredRegistration(NamedTuple):
    """Values for `[camera.registration]` of a rig file; NaN where the frame does not show the edges
    that tell.

    - `shift_x`, `shift_y`: m. `scale`. `rotation`: rad.
    """

    shift_x: float
    shift_y: float
    scale: float
    rotation: float


def measure_registration(rig: Rig, frame: Shaped[np.ndarray, "..."]) -> MeasuredRegistration:
    """The camera's registration from a frame of a warm plate.

    Across each edge of the plate the temperature steps within a pixel; where it does is known to a
    fraction of it, as a pixel that the edge cuts reads the mean by area. Straight lines through
    these places are the plate's outline.

    **Arguments:**

    - `rig`: its camera says where the plate is about.
    - `frame`: `(height, width)`, in K or degC; row 0 is the top. A mean of several has less noise.

    **Returns:** what a rig file's registration has to say for zones to lie as its channels do. A
    shift needs both edges across it inside the frame with two pixels beside each, scale and
    rotation two opposite edges. A recording without frames tells its registration by its channels
    alone, in a match.

    **Raises:** `RigError` where the frame does not have the camera's resolution, or the rig has no
    camera.
    """
    of_kind("measure_registration: rig", rig, Rig, "a Rig, as load_rig reads it", RigError)
    camera, pixels = checked_frames(rig, frame)
    if pixels.ndim != 2:
        raise RigError(
            f"frame: expected a single frame (height, width), got an array of shape {pixels.shape}"
        )
    sizes = (rig.plate.width, rig.plate.height)
    # Places in the picture are counted in metres of the plate from its middle, as the rig file has
    # it. The left and the right edge first, then those that columns run across.
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
    """Place and slope of the first and the last edge that rows of pixels run across; None where one
    is not seen."""
    first, last = view_along
    rows = np.arange(math.ceil(first + 0.1 * (last - first)), int(last - 0.1 * (last - first)))
    along = ((rows + 0.5 - first) / (last - first) - 0.5) * size_along
    lines = []
    for edge in view_across:
        reach = MARGIN * (view_across[1] - view_across[0])
        low, high = max(0, round(edge - reach)), min(pixels.shape[1], round(edge + reach))
        outside = edge - low if edge == view_across[0] else high - edge
        if outside < LEAST_OUTSIDE:
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
    if abs(steps[at]) <= CLEAR * noise:
        return math.nan
    # A pixel that the edge cuts shares the step between both of its sides.
    near = slice(max(at - 1, 0), at + 2)
    share = np.clip(steps[near] / steps[at], 0.0, None)
    return float(share @ (np.arange(len(steps))[near] + 1) / share.sum())


def _line(x: Float[np.ndarray, " points"], y: Float[np.ndarray, " points"]) -> tuple[float, float]:
    """Height at 0 and slope of a straight line; places far from the first one count no more."""
    slope, height = np.polyfit(x, y, 1)
    away = np.abs(y - height - slope * x)
    kept = away <= 3 * np.median(away) + 1e-9
    slope, height = np.polyfit(x[kept], y[kept], 1)
    return float(height), float(slope)
