"""Builds a plate from the table `[plate]` of a rig file: its grid, which is stated by columns and
rows or by its size and a resolution, and its material.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

from ._fields import Fields
from ._plate import Plate
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
