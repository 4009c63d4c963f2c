"""The place of a rectangular cell or heater on the plate: its shares on the elements there, and how
a rig file states it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from ._fields import Fields
from ._plate import Plate
from ._units import ANGLE, COORDINATE, LENGTH, THERMAL_RESISTANCE
from ._value import Value

if TYPE_CHECKING:
    from ._schema import CellTable, HeaterTable


# The share of a face that is taken as none: it is the rounding error of an edge that lies on a line
# of the grid.
MIN_SHARE = 1e-9

_AT = "@"


@final
@dataclass(frozen=True)
class Placement:
    """A rectangle on the plate, the face of a cell or heater.

    **Arguments:**

    - `name`: the name of the cell or heater.
    - `x`, `y`: its middle, m; numbers or parameters.
    - `size`: its width and height before it is turned, m.
    - `x_range`, `y_range`: the lowest and the highest x and y that it may have, m: the bounds of
      the parameters.
    - `angle`: the angle by which it is turned about its middle, from x towards y, which is
      clockwise in pictures, rad.
    """

    name: str
    x: Value
    y: Value
    size: tuple[float, float]
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    angle: float = 0.0

    @property
    def area(self) -> float:
        """The area of the face, m^2."""
        return self.size[0] * self.size[1]

    @property
    def is_fixed(self) -> bool:
        """Whether no parameter moves it."""
        return self.x.is_constant and self.y.is_constant

    @property
    def box(self) -> tuple[float, float]:
        """The width and height of the part of the plate along x and y that it occupies, m."""
        return bounding_box(self.size, self.angle)

    @property
    def reach(self) -> tuple[float, float, float, float]:
        """Left, right, top and bottom of the part of the plane that it may touch, m."""
        half_x, half_y = (side / 2 for side in self.box)
        (left, right), (top, bottom) = self.x_range, self.y_range
        return left - half_x, right + half_x, top - half_y, bottom + half_y

    def outline(self, values_si: Mapping[str, Any]) -> np.ndarray:
        """Its corners for given parameters, m: four pairs (x, y)."""
        middle = [float(self.x.evaluate(values_si)), float(self.y.evaluate(values_si))]
        return corners(self.size, self.angle) + np.array(middle)

    def elements(self, plate: Plate) -> tuple[str, ...]:
        """The elements of the plate that it may touch, row by row."""
        columns, rows = self._block(plate)
        width, names = len(plate.columns), plate.element_names
        return tuple(names[row * width + column] for row in rows for column in columns)

    def overlaps(self, plate: Plate, values_si: Mapping[str, Any]) -> Any:
        """The area of each of `elements` that it covers for given parameters, `(..., elements)`,
        m^2."""
        columns, rows = self._block(plate)
        x_edges = np.array(plate.column_edges)[columns.start : columns.stop + 1]
        y_edges = np.array(plate.row_edges)[rows.start : rows.stop + 1]
        place = self.x.evaluate(values_si), self.y.evaluate(values_si)
        areas = overlap_areas(x_edges, y_edges, place, self.size, self.angle)
        return areas.reshape(*areas.shape[:-2], len(rows) * len(columns))

    def shares(self, plate: Plate) -> dict[str, Value]:
        """The share of the face on each element. They sum to 1.

        **Returns:** element -> a number, or a quantity that the place determines: a `Value` of the
        name `share_name`, for which there is a number for each place.
        """
        elements = self.elements(plate)
        if not self.is_fixed:
            return {name: Value(1.0, ((self.share_name(name), 1.0),)) for name in elements}
        # Rounded, so that mirror images on a symmetric plate are equal.
        result = np.round(self.overlaps(plate, {}) / self.area, 12).tolist()
        return {
            name: Value(share)
            for name, share in zip(elements, result, strict=True)
            if share > MIN_SHARE
        }

    def share_name(self, element: str) -> str:
        """The name of its share on an element in a `Value`."""
        return f"{self.name}{_AT}{element}"

    def _block(self, plate: Plate) -> tuple[range, range]:
        """The columns and rows of the plate that it may touch."""
        left, right, top, bottom = self.reach
        return _touched(plate.column_edges, left, right), _touched(plate.row_edges, top, bottom)


def is_derived(value: Value) -> bool:
    """Whether a value depends on a quantity that the place of a cell or heater determines."""
    return any(_AT in name for name, _ in value.powers)


def bare_name(element: str) -> str:
    """The name of the part of an element's faces that nothing covers in a `Value`."""
    return f"bare{_AT}{element}"


def _touched(edges: tuple[float, ...], low: float, high: float) -> range:
    tiny = MIN_SHARE * (high - low)
    count = len(edges) - 1
    inside = [n for n in range(count) if edges[n + 1] > low + tiny and edges[n] < high - tiny]
    return range(inside[0], inside[-1] + 1)


# The relative size of a part beside the plate that is a rounding error.
RELATIVE_TOLERANCE = 1e-9


def build_placement(
    at: str, table: "CellTable | HeaterTable", plate: Plate, fields: Fields
) -> Placement | None:
    """The place of a cell or heater; None if it has contacts instead.

    **Arguments:**

    - `at`: its table in the file, for messages.

    **Raises:** `RigError` if a value is wrong or missing, the file gives contacts too, or a part of
    it does not lie on the plate.
    """
    if table.at is None:
        for name in ("size", "angle", "contact_resistance"):
            if getattr(table, name) is not None:
                fields.refuse(
                    f"{at}.{name}",
                    'expected a place beside it, such as at = ["6 cm", "4 cm"], got none',
                )
        return None
    if table.contacts is not None:
        fields.refuse(f"{at}.at", "expected either contacts or at, got both; remove one of them")
    if not plate.columns:
        fields.refuse(
            f"{at}.at", "expected a [plate], on which it lies, got none; give contacts instead"
        )
    for name, example in (("size", '"4 cm"'), ("contact_resistance", '"0.6 K/W"')):
        if getattr(table, name) is None:
            fields.refuse(
                f"{at}.{name}", f"expected a value beside at, such as {example}, got none"
            )
    x, y = (
        fields.value(f"{at}.at[{number}]", text, COORDINATE)
        for number, text in enumerate(table.at, 1)
    )
    angle = 0.0 if table.angle is None else fields.constant(f"{at}.angle", table.angle, ANGLE)
    placement = Placement(
        name=table.name,
        x=x,
        y=y,
        size=_size(f"{at}.size", table.size, fields),
        x_range=fields.bounds(x),
        y_range=fields.bounds(y),
        angle=angle,
    )
    _check_on_plate(at, table.at, placement, plate, fields)
    return placement


def placed_contacts(
    at: str, table: "CellTable | HeaterTable", placement: Placement, plate: Plate, fields: Fields
) -> tuple[tuple[str, Value], ...]:
    """The contacts of a cell or heater that lies on the plate: the conductance of its whole face,
    shared by the elements under it as the areas that they have in common with it.

    **Returns:** pairs (element, resistance in K/W).
    """
    assert table.contact_resistance is not None
    whole = fields.value(f"{at}.contact_resistance", table.contact_resistance, THERMAL_RESISTANCE)
    return tuple((element, whole / share) for element, share in placement.shares(plate).items())


def _size(field: str, given: str | list[str], fields: Fields) -> tuple[float, float]:
    texts = [given] if isinstance(given, str) else given
    if len(texts) not in (1, 2):
        fields.refuse(
            field, f"expected the side of a square, or width and height, got {len(texts)} entries"
        )
    sides = [fields.constant(field, text, LENGTH) for text in texts]
    return sides[0], sides[-1]


def _check_on_plate(
    at: str, texts: list[str], placement: Placement, plate: Plate, fields: Fields
) -> None:
    ranges, sizes = (placement.x_range, placement.y_range), (plate.width, plate.height)
    for axis, text, (lowest, highest), side, size in zip(
        "xy", texts, ranges, placement.box, sizes, strict=True
    ):
        tiny = RELATIVE_TOLERANCE * size
        if side > size + tiny:
            fields.refuse(
                f"{at}.size",
                f"expected at most the {100 * size:.6g} cm of the plate along {axis}, got "
                f"{100 * side:.6g} cm",
            )
        first, last = side / 2, size - side / 2
        if lowest >= first - tiny and highest <= last + tiny:
            continue
        inside = f"{100 * first:.6g} cm to {100 * last:.6g} cm"
        if lowest == highest:
            fields.refuse(
                f"{at}.at",
                f"expected {axis} from {inside}, so that all of it lies on the plate, got {text!r}",
            )
        fields.refuse(
            f"{at}.at",
            f"expected bounds of {text!r} within {inside}, so that all of it lies on the plate, "
            f"got {100 * lowest:.6g} cm to {100 * highest:.6g} cm",
        )


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
