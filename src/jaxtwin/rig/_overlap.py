"""The area that a rectangle and each element of a grid have in common, in closed form.

The functions compute with NumPy or, under a transformation, with JAX: the areas are differentiable
in the place of the rectangle wherever none of its edges lies on a line of the grid.
"""

import math
from typing import Any

import numpy as np

RIGHT_ANGLE = math.pi / 2
# The angle below which a rectangle is taken as parallel to the grid, rad.
PARALLEL = 1e-9


def overlap_areas(
    columns: np.ndarray,
    rows: np.ndarray,
    place: tuple[Any, Any],
    size: tuple[float, float],
    angle: float = 0.0,
) -> Any:
    """The area that a rectangle and each element of a grid have in common, m^2.

    **Arguments:**

    - `columns`, `rows`: the edges of the grid's columns and rows, ascending, m.
    - `place`: x and y of the middle of the rectangle, m; numbers, or arrays of one shape.
    - `size`: its width and height, m.
    - `angle`: the angle by which it is turned, from x towards y, rad.

    **Returns:** an array `(..., rows, columns)`.
    """
    xp = _namespace(*place)
    x, y = (xp.asarray(coordinate)[..., None] for coordinate in place)
    turns = round(angle / RIGHT_ANGLE)
    if abs(angle - turns * RIGHT_ANGLE) < PARALLEL:
        width, height = size if turns % 2 == 0 else size[::-1]
        across, down = _common_lengths(xp, columns, x, width), _common_lengths(xp, rows, y, height)
        return down[..., :, None] * across[..., None, :]
    return _common_areas(xp, columns, rows, (x, y), size, angle)


def bounding_box(size: tuple[float, float], angle: float) -> tuple[float, float]:
    """The width and height of the smallest rectangle along x and y that holds a turned one, m."""
    cos, sin = abs(math.cos(angle)), abs(math.sin(angle))
    width, height = size
    return width * cos + height * sin, width * sin + height * cos


def corners(size: tuple[float, float], angle: float) -> np.ndarray:
    """The corners of a turned rectangle, from its middle, m: four pairs (x, y)."""
    cos, sin = math.cos(angle), math.sin(angle)
    at = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]) * np.array(size) / 2
    return at @ np.array([[cos, sin], [-sin, cos]])


def _common_lengths(xp: Any, edges: np.ndarray, middle: Any, size: float) -> Any:
    """The length that a range and each element of one axis have in common, m."""
    within = xp.clip(edges, middle - size / 2, middle + size / 2)
    return within[..., 1:] - within[..., :-1]


def _common_areas(
    xp: Any,
    columns: np.ndarray,
    rows: np.ndarray,
    place: tuple[Any, Any],
    size: tuple[float, float],
    angle: float,
) -> Any:
    r"""The areas for a rectangle that is not parallel to the grid.

    The area of a convex outline within the columns $l$ to $r$ and the rows $t$ to $b$ is the
    integral $\oint \min(\max(y, t), b)\,dx$ along the part of the outline between $l$ and $r$. On
    a straight edge, $dx$ is $dy$ divided by its slope.
    """
    left, right = columns[:-1], columns[1:]
    top, bottom = rows[:-1, None], rows[1:, None]
    (x, y), outline = place, corners(size, angle)
    total: Any = 0.0
    for (x_0, y_0), (x_1, y_1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        slope = (y_1 - y_0) / (x_1 - x_0)
        ends = (xp.clip(x + end, left, right)[..., None, :] for end in (x_0, x_1))
        first, last = (y[..., None] + y_0 + slope * (end - x[..., None] - x_0) for end in ends)
        total = (
            total
            + (_integral_of_clip(xp, last, top, bottom) - _integral_of_clip(xp, first, top, bottom))
            / slope
        )
    return xp.abs(total)


def _integral_of_clip(xp: Any, y: Any, low: np.ndarray, high: np.ndarray) -> Any:
    """An antiderivative of y held between low and high."""
    held = xp.clip(y, low, high)
    return low * xp.minimum(y, low) + held**2 / 2 + high * xp.maximum(y, high)


def _namespace(*numbers: Any) -> Any:
    """jax.numpy if one of the numbers is an array of JAX, else numpy."""
    for number in numbers:
        if not isinstance(number, float | int | np.ndarray | np.generic):
            return number.__array_namespace__()
    return np
