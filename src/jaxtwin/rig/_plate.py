"""The plate: a grid of rectangular elements."""

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import final

import numpy as np
from jaxtyping import Float

from ..errors import RigError
from ._value import Value

# The reserved name of the surroundings in links.
AMBIENT = "ambient"

# The rise above the surroundings for which film coefficients are given, K.
FILM_REFERENCE = 20.0


@final
@dataclass(frozen=True)
class Plate:
    """A thin rectangular plate that is divided into a grid of elements, Fig. 7a and 12a of the
    paper.

    Elements are named `V<row><column>`, counted from 1 at the top left (V11, V12, ...); with ten or
    more rows or columns `V<row>_<column>`.
    x runs from left to right, y from top to bottom, both from 0 at the top left corner.

    **Arguments:**

    - `columns`, `rows`: element widths (x) and heights (y), m.
    - `thickness`: m.
    - `density` (kg/m^3), `specific_heat` (J/(kg K)), `conductivity` (W/(m K)): of the material.
    - `film_coefficient`: heat transfer to air, W/(m^2 K), one for each column.
    - `film_row_factor`: factor on the film coefficient, one for each row.
    - `film_exponent`: the conductance of the film is proportional to the temperature difference to
      this power, and is that of `film_coefficient` (or of the circuit's links to the surroundings)
      at a difference of 20 K; None for a constant film.
    - `emissivity`: the emissivity of the uncovered faces and edges, for radiation in addition to
      the film; None for no radiation.

    Density, specific heat, conductivity, film coefficient and emissivity are None if the rig
    gives its circuit link by link; the sizes then only serve maps and pictures.
    """

    columns: tuple[float, ...]
    rows: tuple[float, ...]
    thickness: Value
    density: Value | None = None
    specific_heat: Value | None = None
    conductivity: Value | None = None
    film_coefficient: tuple[Value, ...] | None = None
    film_row_factor: tuple[Value, ...] = ()
    film_exponent: Value | None = None
    emissivity: Value | None = None

    def __post_init__(self):
        if not self.film_row_factor:
            object.__setattr__(self, "film_row_factor", (Value(1.0),) * len(self.rows))

    @cached_property
    def element_names(self) -> tuple[str, ...]:
        """All element names, row by row from the top left."""
        return names_of_elements(len(self.rows), len(self.columns))

    @property
    def width(self) -> float:
        """Size in x, m."""
        return sum(self.columns, 0.0)

    @property
    def height(self) -> float:
        """Size in y, m."""
        return sum(self.rows, 0.0)

    @cached_property
    def column_edges(self) -> tuple[float, ...]:
        """Edges of the columns from left to right, m."""
        return tuple(accumulate(self.columns, initial=0.0))

    @cached_property
    def row_edges(self) -> tuple[float, ...]:
        """Edges of the rows from top to bottom, m."""
        return tuple(accumulate(self.rows, initial=0.0))

    def extent(self, element: str) -> tuple[float, float, float, float]:
        """Left, right, top and bottom of an element, m.

        **Raises:** `KeyError` if the plate has no such element.
        """
        return self._extents[element]

    def area(self, element: str) -> float:
        """The area of a face of an element, m^2.

        **Raises:** `KeyError` if the plate has no such element.
        """
        left, right, top, bottom = self._extents[element]
        return (right - left) * (bottom - top)

    def mean_weights(self, x: tuple[float, float], y: tuple[float, float]) -> dict[str, float]:
        """The weights of the elements in the mean over a rectangle of the temperature, which is
        interpolated linearly between their centres. They sum to 1; weights of 0 are left out.

        **Arguments:**

        - `x`, `y`: left and right, top and bottom edge of the rectangle, m.
        """
        self._check_is_there()
        from ._zone_means import mean_weights  # with JAX's types, which readers should not pay for

        along_x, along_y = (
            mean_weights(np.array(edges), np.array(low), np.array(high))
            for edges, (low, high) in ((self.column_edges, x), (self.row_edges, y))
        )
        return self._named(np.outer(along_y, along_x))

    def point_weights(self, x: float, y: float) -> dict[str, float]:
        """The weights of the elements in the temperature at a point, interpolated linearly between
        their centres. They sum to 1; weights of 0 are left out.

        **Arguments:**

        - `x`, `y`: the point, m.
        """
        self._check_is_there()
        from ._zone_means import point_weights

        along_x = point_weights(np.array(self.column_edges), x)
        along_y = point_weights(np.array(self.row_edges), y)
        return self._named(np.outer(along_y, along_x))

    def _check_is_there(self) -> None:
        if not self.columns:
            raise RigError("expected a rig with a plate, on which a sensor has a place, got none")

    def _named(self, weights: Float[np.ndarray, "rows columns"]) -> dict[str, float]:
        shares = (weights / weights.sum()).ravel().tolist()
        return {name: w for name, w in zip(self.element_names, shares, strict=True) if w != 0}

    @cached_property
    def _extents(self) -> dict[str, tuple[float, float, float, float]]:
        x, y = self.column_edges, self.row_edges
        corners = [
            (x[column], x[column + 1], y[row], y[row + 1])
            for row in range(len(self.rows))
            for column in range(len(self.columns))
        ]
        return dict(zip(self.element_names, corners, strict=True))


# The plate of a rig that has none: it has no elements.
NO_PLATE = Plate((), (), Value(1.0))


def names_of_elements(rows: int, columns: int) -> tuple[str, ...]:
    """The names of the elements of a plate, row by row from the top left."""
    joint = "_" if max(rows, columns) > 9 else ""
    return tuple(
        f"V{row}{joint}{column}" for row in range(1, rows + 1) for column in range(1, columns + 1)
    )
