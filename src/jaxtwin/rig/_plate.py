"""The plate, a grid of rectangular elements, and the table `[plate]` of a rig file."""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Float

from ..errors import RigError
from ._fields import Fields
from ._toml import bundled_materials, read_bundled
from ._units import (
    CONDUCTIVITY,
    DENSITY,
    EMISSIVITY,
    EXPONENT,
    FACTOR,
    FILM_COEFFICIENT,
    LENGTH,
    SPECIFIC_HEAT,
    Kind,
)
from ._value import Value

if TYPE_CHECKING:
    from ._schema import PlateTable


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


# From the table `[plate]`: the grid, which is stated by columns and rows or by the plate's size and
# a resolution, and the material.

_OF_MATERIAL = {
    "density": DENSITY,
    "specific_heat": SPECIFIC_HEAT,
    "conductivity": CONDUCTIVITY,
}
_NEEDED = (*_OF_MATERIAL, "film_coefficient")


def build_plate(table: "PlateTable", has_circuit: bool, fields: Fields) -> Plate:
    """Builds the plate, with its material if the file states no circuit. Properties that the file
    does not state are those of the bundled material that it names.

    **Raises:** `RigError` if a value is wrong, or both or neither of them are given.
    """
    columns, rows = build_grid(table, fields)
    of_geometry = ("material", *_NEEDED, "film_row_factor", "emissivity")
    given = [name for name in of_geometry if getattr(table, name) is not None]
    exponent = fields.optional("plate", table, "film_exponent", EXPONENT)
    if has_circuit:
        if given:
            fields.refuse(
                f"plate.{given[0]}",
                "expected either this or [circuit], got both; remove one of them",
            )
        # The circuit does not follow from the thickness, so a parameter would have no effect.
        thickness = Value(fields.constant("plate.thickness", table.thickness, LENGTH))
        return Plate(columns, rows, thickness, film_exponent=exponent)
    material = None
    if table.material is not None:
        fields.check_known("plate.material", "material", table.material, bundled_materials())
        material = load_material(table.material)
    needed = _NEEDED if material is None else ("film_coefficient",)
    missing = [name for name in needed if name not in given]
    if missing:
        fields.refuse(
            f"plate.{missing[0]}",
            f"expected [circuit] or all of {', '.join(_NEEDED)}, got neither; a material stands "
            "for the first three"
            if material is None
            else "expected a value beside the material, got none",
        )
    density, specific_heat, conductivity = (
        fields.value(f"plate.{name}", text, kind)
        if (text := getattr(table, name)) is not None
        else Value(getattr(material, name))
        for name, kind in _OF_MATERIAL.items()
    )
    by_part = table.resolution is not None
    film = _each(
        "film_coefficient", table.film_coefficient, columns, FILM_COEFFICIENT, fields, by_part
    )
    factor = _each("film_row_factor", table.film_row_factor or "1", rows, FACTOR, fields, by_part)
    thickness = fields.value("plate.thickness", table.thickness, LENGTH)
    emissivity = fields.optional("plate", table, "emissivity", EMISSIVITY)
    return Plate(
        columns,
        rows,
        thickness,
        density,
        specific_heat,
        conductivity,
        film,
        factor,
        exponent,
        emissivity,
    )


def _each(
    name: str, given: Any, sizes: tuple[float, ...], kind: Kind, fields: Fields, by_part: bool
) -> tuple[Value, ...]:
    """A value for each column or row.

    **Arguments:**

    - `by_part`: whether a list has a value for each of several equal parts of the plate, in place
      of each column or row.
    """
    field = f"plate.{name}"
    if isinstance(given, str):
        return (fields.value(field, given, kind),) * len(sizes)
    if by_part:
        values = [fields.value(f"{field}[{i}]", text, kind) for i, text in enumerate(given, 1)]
        return tuple(value for value in values for _ in range(len(sizes) // len(values)))
    if len(given) != len(sizes):
        fields.refuse(
            field, f"expected {len(sizes)} values, as many as the plate has, got {len(given)}"
        )
    return tuple(fields.value(f"{field}[{i}]", text, kind) for i, text in enumerate(given, 1))


RELATIVE_TOLERANCE = 1e-9
# The largest number of elements that a resolution may ask for, so that a wrong unit does not fill
# the memory.
MAX_ELEMENTS = 100_000

Sizes = tuple[float, ...]


def build_grid(table: "PlateTable", fields: Fields) -> tuple[Sizes, Sizes]:
    """The widths of the columns and the heights of the rows, m.

    Where the file gives a resolution, all elements are equal and no larger than it. A list of film
    coefficients then stands for equal parts of the plate, whose borders are lines of the grid.

    **Raises:** `RigError` if a size is wrong or missing, or the file gives both.
    """
    listed, measured = ("columns", "rows"), ("width", "height", "resolution")
    lists = [name for name in listed if getattr(table, name) is not None]
    given = [name for name in measured if getattr(table, name) is not None]
    if lists and given:
        fields.refuse(
            f"plate.{given[0]}",
            "expected either columns and rows, or width, height and resolution, got both",
        )
    needed = measured if given else listed
    for name in needed:
        if getattr(table, name) is None:
            fields.refuse(
                f"plate.{name}",
                "missing, every plate needs columns and rows, or width, height and resolution",
            )
    if not given:
        return _sizes("columns", table.columns, fields), _sizes("rows", table.rows, fields)
    width, height, resolution = (
        fields.constant(f"plate.{name}", getattr(table, name), LENGTH) for name in measured
    )
    smaller = min(width, height)
    if resolution > smaller * (1 + RELATIVE_TOLERANCE):
        fields.refuse(
            "plate.resolution",
            f"expected at most the plate's smaller side, {100 * smaller:g} cm, got "
            f"{table.resolution!r}",
        )
    if width * height / resolution**2 > MAX_ELEMENTS:
        fields.refuse(
            "plate.resolution",
            f"expected at most {MAX_ELEMENTS} elements, got {table.resolution!r}, which makes "
            "more; make it coarser",
        )
    return (
        _equal(width, resolution, _parts(table.film_coefficient)),
        _equal(height, resolution, _parts(table.film_row_factor)),
    )


def _parts(given: Any) -> int:
    return len(given) if isinstance(given, list) else 1


def _equal(size: float, resolution: float, parts: int) -> Sizes:
    """Equal sizes of at most the resolution, as many as a multiple of the parts."""
    in_part = math.ceil(size / parts / resolution - RELATIVE_TOLERANCE)
    return (size / (parts * in_part),) * (parts * in_part)


def _sizes(name: str, texts: list[str] | None, fields: Fields) -> Sizes:
    return tuple(
        fields.constant(f"plate.{name}[{number}]", text, LENGTH)
        for number, text in enumerate(texts or (), 1)
    )


@final
@dataclass(frozen=True)
class Material:
    """A solid at room temperature.

    **Arguments:**

    - `name`, `title`, `references`: its name, a title, and the sources of the numbers.
    - `density`: kg/m^3. `specific_heat`: J/(kg K). `conductivity`: W/(m K).
    - `diffusivity`: the thermal diffusivity in the same source, m^2/s, which is conductivity /
      (density * specific heat); None if it lists none.
    """

    name: str
    title: str
    references: tuple[str, ...]
    density: float
    specific_heat: float
    conductivity: float
    diffusivity: float | None


def load_material(name: str) -> Material:
    """Loads a bundled material.

    **Arguments:**

    - `name`: one of `bundled_materials()`.

    **Raises:** `RigError` if no material has this name.
    """
    # pydantic and pint take a while to import, and only readers of a file should pay for them.
    from . import _units as units
    from ._fields import Fields
    from ._schema import MaterialTable, validate

    data, source = read_bundled("materials", name)
    table = validate(MaterialTable, data, source)
    fields = Fields(source, {}, {})
    kinds = {
        "density": units.DENSITY,
        "specific_heat": units.SPECIFIC_HEAT,
        "conductivity": units.CONDUCTIVITY,
    }
    numbers = {
        field: fields.constant(field, getattr(table, field), kind) for field, kind in kinds.items()
    }
    diffusivity = None
    if table.diffusivity is not None:
        diffusivity = fields.constant("diffusivity", table.diffusivity, units.DIFFUSIVITY)
    return Material(
        table.name, table.title, tuple(table.references), **numbers, diffusivity=diffusivity
    )
