"""Builds a plate from the table `[plate]` of a rig file."""

from typing import Any

from ._bundled import bundled_materials
from ._fields import Fields
from ._grid_table import build_grid
from ._material import load_material
from ._plate import Plate
from ._schema import PlateTable
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

_OF_MATERIAL = {
    "density": DENSITY,
    "specific_heat": SPECIFIC_HEAT,
    "conductivity": CONDUCTIVITY,
}
_NEEDED = (*_OF_MATERIAL, "film_coefficient")


def build_plate(table: PlateTable, has_circuit: bool, fields: Fields) -> Plate:
    """Builds the plate, with its material if the file states no circuit. Properties that the file
    does not state are those of the bundled material that it names.

    **Raises:** `RigError` if a value is wrong, or both or neither of them are given.
    """
    columns, rows = build_grid(table, fields)
    of_geometry = ("material", *_NEEDED, "film_row_factor", "emissivity")
    given = [name for name in of_geometry if getattr(table, name) is not None]
    exponent = _optional("film_exponent", table.film_exponent, EXPONENT, fields)
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
    emissivity = _optional("emissivity", table.emissivity, EMISSIVITY, fields)
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


def _optional(name: str, text: str | None, kind: Kind, fields: Fields) -> Value | None:
    return None if text is None else fields.value(f"plate.{name}", text, kind)


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
