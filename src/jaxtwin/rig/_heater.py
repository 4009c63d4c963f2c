"""Resistive heaters, relays that switch them, and the tables `[[heaters]]` of a rig file."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, final

from ._bodies import Body, CircuitLink, body_of
from ._fields import Fields
from ._placement import Placement, build_placement, placed_contacts
from ._plate import AMBIENT, Plate
from ._units import (
    DRIVE_EXPONENT,
    DURATION,
    ELECTRICAL_RESISTANCE,
    HEATER_POWER,
    SHORTEST,
    is_quantity,
)
from ._value import Value

if TYPE_CHECKING:
    from ._schema import HeaterTable, TimeProportionalTable


@final
@dataclass(frozen=True)
class RelayWindow:
    """A relay, solid-state relay or contactor that gives a heater its duty by the time for which it
    is on in each window.

    At the beginning of a window the on time is chosen: nothing, the whole window, or a time between
    that leaves the relay on and off for its minimum times; of these the one that is nearest to what
    is asked for. The difference is carried to the next window, so that the mean over many windows
    is the duty. A duty of 0 is never on and a full one never off; they leave what is carried as it
    is.

    **Arguments:**

    - `period`: the period of the window, s.
    - `minimum_on`, `minimum_off`: the shortest time for which the relay stays on, or off, s.
    """

    period: float
    minimum_on: float = 0.0
    minimum_off: float = 0.0

    def on_time(self, duty: float, carried: float) -> tuple[float, float]:
        """The time of a window for which the relay is on, from its beginning, and the time that is
        carried to the next one, s.

        **Arguments:**

        - `duty`: the duty at the beginning of the window, 0 to 1.
        - `carried`: the time that the windows before have left over, below 0 where they were on for
          longer than asked.
        """
        if not 0 < duty < 1:
            return (self.period if duty >= 1 else 0.0), carried
        wanted = duty * self.period + carried
        longest = self.period - self.minimum_off
        choices = [0.0, self.period]
        if self.minimum_on <= longest:
            choices.append(min(max(wanted, self.minimum_on), longest))
        on = min(choices, key=lambda choice: abs(choice - wanted))
        return on, wanted - on


@final
@dataclass(frozen=True)
class Heater:
    """A resistive heater, which heats one node of the rig and cannot cool it.

    It has either a power or an electrical resistance.

    **Arguments:**

    - `name`: unique among cells and heaters.
    - `node`: the element of the plate or the body that its heat goes into. A heater with a heat
      capacity of its own is also one of the rig's bodies, which has its name.
    - `power`: the power at full duty, to which the heat is proportional, W.
    - `electrical_resistance`: the resistance that the driver connects to its supply, ohm.
    - `placement`: its place on the plate; None if the file lists contacts.
    - `drive_exponent`: the heat is the power times the duty to this power; None for a heat that is
      proportional to the duty.
    - `full_scale`: what a column of a recording in W, V or A has at full duty: the number and this
      unit; None for recordings of the duty.
    - `time_proportional`: the relay that switches it; None where the duty is that of a fast PWM.
    """

    name: str
    node: str
    power: Value | None = None
    electrical_resistance: Value | None = None
    placement: Placement | None = None
    # A matter of recordings, not of temperatures, and so no part of the fingerprint.
    full_scale: tuple[float, str] | None = field(default=None, repr=False)
    # Part of the fingerprint of a rig, but not of one without it.
    drive_exponent: Value | None = field(default=None, repr=False)
    # A twin has the mean over a window, so that its temperatures, and the fingerprint of its rig,
    # which is made of this text, do not depend on it.
    time_proportional: RelayWindow | None = field(default=None, repr=False)


def heater_bodies(
    tables: "Iterable[HeaterTable]", plate: Plate, bodies: Sequence[Body], fields: Fields
) -> tuple[Body, ...]:
    """The bodies that heaters with a heat capacity are.

    **Arguments:**

    - `bodies`: the bodies that the file gives by themselves. A heater starts at the temperature of
      the first of them that it touches, unless the file gives its own.

    **Raises:** `RigError` if a value is wrong, or a heater has the name of a node.
    """
    starts = {body.name: body.temperature or body.initial_temperature for body in bodies}
    result: list[Body] = []
    for table in tables:
        if table.capacitance is None:
            if table.initial_temperature is not None:
                fields.refuse(
                    f"heaters[{table.name}].initial_temperature",
                    "expected a capacitance beside it, got none; a heater without one has no "
                    "temperature of its own",
                )
            continue
        from ._schema import BodyTable  # with pydantic, which only readers of a rig should pay for

        as_body = BodyTable(
            name=table.name,
            capacitance=table.capacitance,
            initial_temperature=table.initial_temperature,
        )
        at = f"heaters[{table.name}]"
        if any(table.name == body.name for body in (*bodies, *result)):
            fields.refuse(
                f"{at}.name",
                f"expected no name of a body, because a heater with a capacitance is one itself, "
                f"got {table.name!r}",
            )
        body = body_of(as_body, at, plate, fields)
        if body.initial_temperature is None:
            touched = [starts[name] for name in table.contacts or () if name in starts]
            body = replace(body, initial_temperature=touched[0] if touched else None)
        result.append(body)
    return tuple(result)


def heater_links(
    tables: "Iterable[HeaterTable]", plate: Plate, bodies: Sequence[Body], fields: Fields
) -> list[CircuitLink]:
    """The links between heaters with a heat capacity and what they touch.

    **Raises:** `RigError` if a heater touches something unknown or itself, a resistance is wrong,
    or a heater without a heat capacity has a resistance.
    """
    links = []
    for table in tables:
        placement = build_placement(f"heaters[{table.name}]", table, plate, fields)
        if placement is not None:
            links += _placed_links(table, placement, plate, fields)
            continue
        at = f"heaters[{table.name}].contacts"
        if isinstance(table.contacts, list):
            if table.capacitance is not None:
                fields.refuse(
                    at,
                    "expected a table of resistances beside a capacitance, such as "
                    '{ air = "2 K/W" }, got a list of names',
                )
            continue
        if table.capacitance is None:
            fields.refuse(
                at,
                'expected a list of one name, such as ["air"], which takes up the heat of a heater '
                "without a capacitance, got "
                f"{'none' if table.contacts is None else 'resistances; give it a capacitance too'}",
            )
        others = [AMBIENT, *(body.name for body in bodies if body.name != table.name)]
        for node, text in (table.contacts or {}).items():
            if node != AMBIENT:
                fields.check_element(at, node, plate.element_names, others[1:])
            resistance = fields.path(f"{at}.{node}", text)
            if resistance is not None:
                links.append(CircuitLink(resistance, 1.0, ((table.name, node),)))
    return links


def _placed_links(
    table: "HeaterTable", placement: Placement, plate: Plate, fields: Fields
) -> list[CircuitLink]:
    """The links of a heater that lies on the plate.

    **Raises:** `RigError` if it has no heat capacity.
    """
    at = f"heaters[{table.name}]"
    if table.capacitance is None:
        fields.refuse(
            f"{at}.capacitance",
            "expected a value beside at, got none; the heat of a heater without a capacitance goes "
            "into one node, which contacts name",
        )
    contacts = placed_contacts(at, table, placement, plate, fields)
    return [CircuitLink(value, 1.0, ((table.name, element),)) for element, value in contacts]


def build_heater(
    table: "HeaterTable", plate: Plate, bodies: Sequence[Body], fields: Fields
) -> Heater:
    """A heater.

    **Arguments:**

    - `bodies`: all bodies, with those that are heaters.

    **Raises:** `RigError` if it has neither or both of a power and a resistance, or its heat goes
    into no node or into several.
    """
    at = f"heaters[{table.name}]"
    exponent = _drive_exponent(f"{at}.drive", table, fields)
    full_scale = fields.full_scale(f"{at}.full_scale", table.full_scale)
    if exponent is not None and full_scale is not None and full_scale[1] == "W":
        fields.refuse(
            f"{at}.full_scale",
            "expected a voltage or a current beside a drive that is not proportional, because the "
            f"heat is proportional to a power, got {table.full_scale!r}",
        )
    if (table.power is None) == (table.electrical_resistance is None):
        result = "neither" if table.power is None else "both"
        fields.refuse(at, f"expected either a power or an electrical_resistance, got {result}")
    return Heater(
        name=table.name,
        node=table.name if table.capacitance is not None else _heated(table, plate, bodies, fields),
        power=fields.optional(at, table, "power", HEATER_POWER),
        electrical_resistance=fields.optional(
            at, table, "electrical_resistance", ELECTRICAL_RESISTANCE
        ),
        placement=build_placement(at, table, plate, fields),
        drive_exponent=exponent,
        full_scale=full_scale,
        time_proportional=None
        if table.time_proportional is None
        else _time_proportional(f"{at}.time_proportional", table.time_proportional, fields),
    )


# The laws of the drive that have names, as exponents of the duty.
DRIVES = {"proportional": None, "quadratic": Value(2.0)}


def _drive_exponent(at: str, table: "HeaterTable", fields: Fields) -> Value | None:
    """The exponent of the duty to which the heat is proportional; None for the duty itself.

    **Raises:** `RigError` for a law beside a resistance, whose driver has one, or beside a relay.
    """
    if table.drive in DRIVES:
        exponent = DRIVES[table.drive]
    elif table.drive.isidentifier() or is_quantity(table.drive):
        exponent = fields.value(at, table.drive, DRIVE_EXPONENT)
    else:
        fields.refuse(
            at,
            f"expected {' or '.join(map(repr, DRIVES))}, or an exponent of the duty, "
            f"{DRIVE_EXPONENT}, got {table.drive!r}",
        )
    if exponent is not None and table.power is None:
        fields.refuse(
            at,
            "expected a power beside it, got an electrical_resistance, whose law is the "
            'driver\'s: averaging = "on-off" is proportional, "voltage" quadratic',
        )
    if exponent is not None and table.time_proportional is not None:
        fields.refuse(
            at, "expected none beside time_proportional: the heat of a relay is proportional"
        )
    return exponent


def _time_proportional(at: str, table: "TimeProportionalTable", fields: Fields) -> RelayWindow:
    period = fields.constant(f"{at}.period", table.period, DURATION)
    shortest = {}
    for name in ("minimum_on", "minimum_off"):
        text = getattr(table, name)
        shortest[name] = fields.constant(f"{at}.{name}", text, SHORTEST)
        if shortest[name] > period:
            fields.refuse(
                f"{at}.{name}",
                f"expected at most the period of the window, {period:g} s, got {text!r}",
            )
    return RelayWindow(period, **shortest)


def _heated(table: "HeaterTable", plate: Plate, bodies: Sequence[Body], fields: Fields) -> str:
    at = f"heaters[{table.name}].contacts"
    names = list(table.contacts or ())
    if len(names) != 1:
        fields.refuse(
            at,
            f"expected one name in the list, got {len(names)}; a heater that heats several nodes "
            "needs a capacitance and a resistance to each of them",
        )
    free = [body.name for body in bodies if body.temperature is None]
    fields.check_element(at, names[0], plate.element_names, free)
    return names[0]
