"""Orders from the JSON of a command, which the page or an MQTT broker has sent."""

import json
from collections.abc import Sequence
from concurrent.futures import Future
from reprlib import repr as shortened
from typing import Any, final

from ..errors import JaxtwinError
from ..live import Publisher
from ._access import MAX_BODY
from ._desk import (
    AcknowledgeOrder,
    Answer,
    Desk,
    DriveOrder,
    HoldOrder,
    Order,
    PromoteOrder,
    RefitOrder,
    RollbackOrder,
)
from ._recent_samples import MAX_SAMPLES, SPACING_SECONDS

# The longest time for which a duty is held, s of the rig.
MAX_HOLD_SECONDS = 86_400.0

# The longest reason, letters.
MAX_TEXT = 300

# Above all numbers of versions, which are those of SQLite.
MAX_VERSION = 2**63

COLDEST, HOTTEST = -100.0, 500.0
"""The range of references, degC; those that no duty can hold are refused when they are tried."""

# The kinds of orders, which are the ends of their addresses.
KINDS = ("drive", "hold", "promote", "rollback", "refit", "acknowledge")


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
            return PromoteOrder(_version(fields), _reason(fields))
        case "refit":
            check_names(fields, {"seconds"})
            return RefitOrder(
                _number("seconds", fields.get("seconds"), 300.0, MAX_SAMPLES * SPACING_SECONDS)
            )
        case "rollback":
            check_names(fields, {"reason"})
            return RollbackOrder(_reason(fields))
        case "acknowledge":
            check_names(fields, set())
            return AcknowledgeOrder()
    raise JaxtwinError(f"expected one of {', '.join(KINDS)}, got {kind!r}")


def fields_of(body: bytes) -> dict[str, Any]:
    """The fields of a JSON object; none for an empty body.

    **Raises:** `JaxtwinError` if it is something else.
    """
    try:
        result = json.loads(body or b"{}")
    except (ValueError, RecursionError):
        raise JaxtwinError("expected JSON") from None
    if not isinstance(result, dict):
        raise JaxtwinError(f"expected an object, got {type(result).__name__}")
    return result


def check_names(fields: dict[str, Any], known: set[str]) -> None:
    """Refuses fields that nobody knows.

    **Raises:** `JaxtwinError`.
    """
    if unknown := sorted(fields.keys() - known):
        expected = ", ".join(sorted(known)) or "no field"
        raise JaxtwinError(f"expected {expected}, got {shortened(unknown[0])}")


def _numbers(
    name: str, fields: dict[str, Any], ranges: Sequence[tuple[float, float]]
) -> tuple[float, ...]:
    value = fields.get(name)
    if not isinstance(value, list) or len(value) != len(ranges):
        raise JaxtwinError(
            f"{name}: expected a list of {len(ranges)} numbers, got {shortened(value)}"
        )
    return tuple(_number(name, number, *ends) for number, ends in zip(value, ranges, strict=True))


def _seconds(fields: dict[str, Any]) -> float:
    return _number("seconds", fields.get("seconds"), 1.0, MAX_HOLD_SECONDS)


def _reset(fields: dict[str, Any]) -> bool:
    reset = fields.get("reset", False)
    if not isinstance(reset, bool):
        raise JaxtwinError(f"reset: expected true or false, got {shortened(reset)}")
    return reset


def _number(name: str, value: Any, low: float, high: float) -> float:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    # Compared as it is: an int may be too large for a float, and NaN is in no range.
    if not is_number or not low <= value <= high:
        text = shortened(value)
        raise JaxtwinError(f"{name}: expected a number from {low:g} to {high:g}, got {text}")
    return float(value)


def _version(fields: dict[str, Any]) -> str:
    version = fields.get("version")
    is_known = isinstance(version, int | str) and not isinstance(version, bool)
    text = str(version) if is_known else ""
    is_text = bool(text) and text.isprintable() and len(text) <= MAX_TEXT
    if not is_text or (text.isdecimal() and int(text) >= MAX_VERSION):
        raise JaxtwinError(f"version: expected a number or an alias, got {shortened(version)}")
    return text


def _reason(fields: dict[str, Any]) -> str:
    reason = fields.get("reason")
    text = " ".join(reason.split()) if isinstance(reason, str) else ""
    # What cannot be printed, such as half a character of UTF-16, cannot be stored either.
    if not text or not text.isprintable() or len(text) > MAX_TEXT:
        raise JaxtwinError(f"reason: expected a sentence of at most {MAX_TEXT} letters")
    return text


# Orders to the store of a rig from an MQTT broker, with the rules of those of the page.

# The orders that are taken, the ends of their topics: none of them drives a rig.
MQTT_KINDS = ("promote", "rollback", "refit", "acknowledge")


@final
class MqttOrders:
    """Takes orders from `TOPIC/orders/KIND`, whose messages are the JSON of the same orders of the
    page, and answers each on `TOPIC/answers`. Who may publish there is the broker's to say.

    One order is taken at a time: a flood of them is refused, and never fills the desk.

    **Arguments:**

    - `publisher`: the connection to the broker.
    - `desk`: where the orders are left.
    """

    def __init__(self, publisher: Publisher, desk: Desk):
        self._publisher, self._desk = publisher, desk
        self._waiting: Future[Answer] | None = None
        for kind in MQTT_KINDS:
            publisher.subscribe(f"orders/{kind}", lambda body, kind=kind: self._hear(kind, body))

    def _hear(self, kind: str, body: bytes) -> None:
        try:
            if len(body) > MAX_BODY:
                raise JaxtwinError(f"expected at most {MAX_BODY} bytes")
            if self._waiting is not None and not self._waiting.done():
                raise JaxtwinError("expected one order at a time; the one before is not answered")
            order = order_of(kind, body, (), 0)
        except JaxtwinError as error:
            self._publisher.send_answer(kind, False, str(error))
            return
        self._waiting = self._desk.ask(order)

        def answered(done: "Future[Answer]") -> None:
            self._publisher.send_answer(kind, *done.result())

        self._waiting.add_done_callback(answered)
