"""Reads where a cell or heater lies on the plate, and its contacts with the elements there."""

from ._fields import Fields
from ._placement import Placement
from ._plate import Plate
from ._schema import CellTable, HeaterTable
from ._units import ANGLE, COORDINATE, LENGTH, THERMAL_RESISTANCE
from ._value import Value

# The relative size of a part beside the plate that is a rounding error.
RELATIVE_TOLERANCE = 1e-9


def build_placement(
    at: str, table: CellTable | HeaterTable, plate: Plate, fields: Fields
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
    at: str, table: CellTable | HeaterTable, placement: Placement, plate: Plate, fields: Fields
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
