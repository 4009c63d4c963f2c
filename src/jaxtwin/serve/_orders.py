"""Orders from the JSON of a command."""

import json
import math
from collections.abc import Sequence
from typing import Any

from .._errors import JaxtwinError
from ._desk import DriveOrder, HoldOrder, Order, PromoteOrder, RefitOrder, RollbackOrder
from ._recent_samples import KEPT, SPACING

LONGEST = 86_400.0
"""The longest time for which a duty is held, s of the rig."""

LONGEST_TEXT = 300
"""The longest reason, letters."""

COLDEST, HOTTEST = -100.0, 500.0
"""The range of references, degC; those that no duty can hold are refused when they are tried."""

KINDS = ("drive", "hold", "promote", "rollback", "refit")
"""The kinds of orders, which are the ends of their addresses."""


def order_of(kind: str, body: bytes, lowest: Sequence[float], outputs: int) -> Order:
    """Reads an order.

    **Arguments:**

    - `kind`: one of `KINDS`.
    - `body`: the JSON.
    - `lowest`: the lowest duty of each cell and heater.
    - `outputs`: the number of outputs of the controller, 0 without one.

    **Raises:** `JaxtwinError` that names the field and what is allowed.
    """
    fields = fields_of(body)
    match kind:
        case "drive":
            check_names(fields, {"duty", "seconds", "reset"})
            duty = _numbers("duty", fields, [(low, 1.0) for low in lowest])
            return DriveOrder(duty, _seconds(fields), _reset(fields))
        case "hold":
            check_names(fields, {"references", "seconds", "reset"})
            references = _numbers("references", fields, [(COLDEST, HOTTEST)] * outputs)
            return HoldOrder(references, _seconds(fields), _reset(fields))
        case "promote":
            check_names(fields, {"version", "reason"})
            version = fields.get("version")
            if not isinstance(version, int | str) or isinstance(version, bool):
                raise JaxtwinError(f"version: expected a number or an alias, got {version!r}")
            return PromoteOrder(str(version)[:LONGEST_TEXT], _reason(fields))
        case "refit":
            check_names(fields, {"seconds"})
            return RefitOrder(_number("seconds", fields.get("seconds"), 300.0, KEPT * SPACING))
        case "rollback":
            check_names(fields, {"reason"})
            return RollbackOrder(_reason(fields))
    raise JaxtwinError(f"expected one of {', '.join(KINDS)}, got {kind!r}")


def fields_of(body: bytes) -> dict[str, Any]:
    """The fields of a JSON object; none for an empty body.

    **Raises:** `JaxtwinError` if it is something else.
    """
    try:
        found = json.loads(body or b"{}")
    except (ValueError, RecursionError):
        raise JaxtwinError("expected JSON") from None
    if not isinstance(found, dict):
        raise JaxtwinError(f"expected an object, got {type(found).__name__}")
    return found


def check_names(fields: dict[str, Any], known: set[str]) -> None:
    """Refuses fields that nobody knows.

    **Raises:** `JaxtwinError`.
    """
    if unknown := sorted(fields.keys() - known):
        expected = ", ".join(sorted(known)) or "no field"
        raise JaxtwinError(f"expected {expected}, got {unknown[0]!r}")


def _numbers(
    name: str, fields: dict[str, Any], ranges: Sequence[tuple[float, float]]
) -> tuple[float, ...]:
    value = fields.get(name)
    if not isinstance(value, list) or len(value) != len(ranges):
        raise JaxtwinError(f"{name}: expected a list of {len(ranges)} numbers, got {value!r}")
    return tuple(_number(name, one, *ends) for one, ends in zip(value, ranges, strict=True))


def _seconds(fields: dict[str, Any]) -> float:
    return _number("seconds", fields.get("seconds"), 1.0, LONGEST)


def _reset(fields: dict[str, Any]) -> bool:
    reset = fields.get("reset", False)
    if not isinstance(reset, bool):
        raise JaxtwinError(f"reset: expected true or false, got {reset!r}")
    return reset


def _number(name: str, value: Any, low: float, high: float) -> float:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not math.isfinite(value) or not low <= value <= high:
        raise JaxtwinError(f"{name}: expected a number from {low:g} to {high:g}, got {value!r}")
    return float(value)


def _reason(fields: dict[str, Any]) -> str:
    reason = fields.get("reason")
    if not isinstance(reason, str) or not reason.strip() or len(reason) > LONGEST_TEXT:
        raise JaxtwinError(f"reason: expected a sentence of at most {LONGEST_TEXT} letters")
    return " ".join(reason.split())
