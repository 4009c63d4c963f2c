"""Reads the grid of a plate: its columns and rows, or its size and the resolution wanted."""

import math
from typing import Any

from ._fields import Fields
from ._schema import PlateTable
from ._units import LENGTH

RELATIVE_TOLERANCE = 1e-9
# The largest number of elements that a resolution may ask for, so that a wrong unit does not fill
# the memory.
MAX_ELEMENTS = 100_000

Sizes = tuple[float, ...]


def build_grid(table: PlateTable, fields: Fields) -> tuple[Sizes, Sizes]:
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
