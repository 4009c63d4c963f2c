"""The place of a rectangular cell or heater on the plate, and its shares on the elements there."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from ._overlap import bounding_box, corners, overlap_areas
from ._plate import Plate
from ._value import Value

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
