"""Quantities with units by pint, which users may pass in place of numbers."""

from typing import Any

from .errors import JaxtwinError


def is_pint(value: Any) -> bool:
    """Whether a value is a quantity of pint, without importing it."""
    return hasattr(value, "magnitude") and hasattr(value, "units") and hasattr(value, "to")


def in_unit(where: str, value: Any, unit: str, error: type[JaxtwinError]) -> Any:
    """The numbers of a quantity in a unit. Anything but a quantity is returned as it is, and has
    that unit already.

    **Arguments:**

    - `where`: the argument, for the message.
    - `unit`: the unit, such as `"s"` or `"degC"`; empty for a plain number.

    **Raises:** `error` for a quantity of another kind.
    """
    if not is_pint(value):
        return value
    try:
        return value.to(unit.replace("^", "**") or "dimensionless").magnitude
    except Exception:  # pint's own errors have no common class in all of its versions
        raise error(
            f"{where}: expected {unit or 'a number without unit'}, got {value.units}"
        ) from None
