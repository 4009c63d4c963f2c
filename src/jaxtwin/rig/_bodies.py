"""Bodies beside the plate and its cells, such as a second plate, a common sink or coolant, and
links between nodes: the tables `[[bodies]]`, `[[links]]` and `[circuit]` of a rig file.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, final

from ._fields import Fields
from ._plate import AMBIENT, Plate
from ._units import (
    AREA,
    CONDUCTANCE,
    EMISSIVITY,
    EXPONENT,
    FACTOR,
    HEAT_CAPACITY,
    TEMPERATURE,
    THERMAL_RESISTANCE,
)
from ._value import Switched, Value

if TYPE_CHECKING:
    from ._schema import BodyLinkTable, BodyTable, CircuitTable, FanTable


@final
@dataclass(frozen=True)
class Body:
    """A body of uniform temperature, which links and cells connect to the rest of a rig.

    **Arguments:**

    - `name`: unique among bodies and plate elements.
    - `capacitance`: the heat capacity, J/K; None for a body at a fixed temperature.
    - `temperature`: the fixed temperature of a body such as coolant or an ice bath, K; None for a
      body with a heat capacity.
    - `initial_temperature`: the temperature at the start, K; None means that of the plate.
    """

    name: str
    capacitance: Value | None = None
    temperature: Value | None = None
    initial_temperature: Value | None = None


@final
@dataclass(frozen=True)
class CircuitLink:
    """A named resistance, and the pairs of nodes that it connects.

    **Arguments:**

    - `resistance`: K/W, or one for each state of an input.
    - `factor`: each link has factor times the resistance.
    - `between`: pairs of node names (plate elements, bodies or "ambient"). A pair may occur more
      than once: an edge element can lose heat to the surroundings in several ways.
    """

    resistance: Value | Switched
    factor: float
    between: tuple[tuple[str, str], ...]


@final
@dataclass(frozen=True)
class NonlinearLink:
    """Natural convection, radiation or both between the two nodes of each pair; what a resistance
    carries beside them is a `CircuitLink`.

    **Arguments:**

    - `convection`: the conductance of natural convection at a temperature difference of
      `FILM_REFERENCE`, W/K; it grows with the difference to the power of `exponent`. None for no
      convection.
    - `exponent`: dimensionless.
    - `radiating_area`: emissivity times area, m^2; None for no radiation.
    - `between`: pairs of names as in `CircuitLink`.
    """

    convection: Value | None
    exponent: Value
    radiating_area: Value | None
    between: tuple[tuple[str, str], ...]


@final
@dataclass(frozen=True)
class Circuit:
    """The plate as an explicit network of equal capacitances and named resistances.

    **Arguments:**

    - `capacitance`: the heat capacity of every plate element, J/K.
    - `links`: groups of links that share a resistance.
    """

    capacitance: Value
    links: tuple[CircuitLink, ...]


# The exponent of natural convection in laminar flow.
LAMINAR = Value(0.25)


def build_bodies(tables: "Sequence[BodyTable]", plate: Plate, fields: Fields) -> tuple[Body, ...]:
    """The bodies of a file.

    **Raises:** `RigError` if a value or a name is wrong, or a body has neither a heat capacity
    nor a fixed temperature, or both.
    """
    fields.check_unique("bodies", [table.name for table in tables])
    return tuple(body_of(table, f"bodies[{table.name}]", plate, fields) for table in tables)


def body_of(table: "BodyTable", at: str, plate: Plate, fields: Fields) -> Body:
    """A body.

    **Arguments:**

    - `at`: the place of its table in the file, for messages.

    **Raises:** `RigError` as `build_bodies`.
    """
    if not table.name.isidentifier() or table.name in (AMBIENT, *plate.element_names):
        fields.refuse(
            f"{at}.name",
            "expected letters, digits and _, and neither an element of the plate nor "
            f"{AMBIENT!r}, got {table.name!r}",
        )
    if (table.capacitance is None) == (table.temperature is None):
        result = "neither" if table.capacitance is None else "both"
        fields.refuse(at, f"expected either a capacitance or a temperature, got {result}")
    if table.temperature is not None and table.initial_temperature is not None:
        fields.refuse(
            f"{at}.initial_temperature", "expected none beside a temperature; remove one of them"
        )
    convert = {
        "capacitance": partial(fields.value, kind=HEAT_CAPACITY),
        "temperature": partial(fields.input_or_value, kind=TEMPERATURE),
        "initial_temperature": partial(fields.value, kind=TEMPERATURE),
    }
    values = {
        name: None if text is None else converted(f"{at}.{name}", text)
        for name, converted in convert.items()
        for text in (getattr(table, name),)
    }
    return Body(table.name, **values)


def build_links(
    tables: "Sequence[BodyLinkTable]", plate: Plate, bodies: Sequence[Body], fields: Fields
) -> tuple[CircuitLink | NonlinearLink, ...]:
    """The links between bodies, elements of the plate and the surroundings.

    **Raises:** `RigError` if a value is wrong, an end is unknown, both ends have a fixed
    temperature, or a link carries no heat.
    """
    held = {AMBIENT, *(body.name for body in bodies if body.temperature is not None)}
    others = (AMBIENT, *(body.name for body in bodies))
    links: list[CircuitLink | NonlinearLink] = []
    for table in tables:
        at = f"links[{table.resistance or table.between[0]}]"
        resistance = None
        if table.resistance is not None:
            resistance = fields.varying_path(f"{at}.resistance", table.resistance)
        nonlinear = _nonlinear(table, at, fields)
        pairs = []
        for text in table.between:
            ends = link_ends(f"{at}.between", text, plate.element_names, fields, others)
            if held.issuperset(ends):
                fields.refuse(
                    f"{at}.between",
                    f"expected an end whose temperature is not held, got {text!r}; remove the link",
                )
            pairs.append(ends)
        if resistance is not None:
            resistance = blown(resistance, table.fan, at, fields)
            links.append(CircuitLink(resistance, table.factor, tuple(pairs)))
        if nonlinear is not None:
            _check_ends(pairs, bodies, at, fields)
            links.append(replace(nonlinear, between=tuple(pairs)))
    return tuple(links)


def _nonlinear(table: "BodyLinkTable", at: str, fields: Fields) -> NonlinearLink | None:
    """The natural convection and radiation of a link, without its ends; None for neither.

    **Raises:** `RigError` if a value is wrong, or a key has another beside it that it needs.
    """
    needed = {
        "convection_exponent": "convection",
        "emissivity": "radiating_area",
        "fan": "resistance",
    }
    for key, beside in needed.items():
        if getattr(table, key) is not None and getattr(table, beside) is None:
            fields.refuse(f"{at}.{key}", f"expected {beside} beside it, got none; give it")
    if table.factor != 1 and table.resistance is None:
        fields.refuse(f"{at}.factor", "expected a resistance beside it, got none; remove it")
    if table.convection is None and table.radiating_area is None:
        if table.resistance is None:
            expected = f"a resistance, {THERMAL_RESISTANCE}, or convection or a radiating_area"
            fields.refuse(at, f"expected {expected}, got none of them")
        return None

    optional = partial(fields.optional, at, table)
    area = optional("radiating_area", AREA)
    emissivity = optional("emissivity", EMISSIVITY)
    return NonlinearLink(
        convection=optional("convection", CONDUCTANCE),
        exponent=optional("convection_exponent", EXPONENT) or LAMINAR,
        radiating_area=area * emissivity if area and emissivity else area,
        between=(),
    )


def _check_ends(
    pairs: Sequence[tuple[str, str]], bodies: Sequence[Body], at: str, fields: Fields
) -> None:
    """Refuses convection and radiation to a body whose temperature is an input."""
    temperatures = {body.name: body.temperature for body in bodies}
    for end in (end for pair in pairs for end in pair):
        temperature = temperatures.get(end)
        if temperature is not None and fields.depends_on_input(temperature):
            fields.refuse(
                f"{at}.between",
                "expected an end whose temperature is no input beside convection or a "
                f"radiating_area, got {end!r}; give the link a resistance instead",
            )


def build_circuit(table: "CircuitTable", plate: Plate, fields: Fields) -> Circuit:
    """Builds the circuit that a file states link by link.

    **Raises:** `RigError` if a link has an unknown end or the same end twice.
    """
    links = []
    for link in table.links:
        field = f"circuit.links[{link.resistance}]"
        resistance = fields.path(f"{field}.resistance", link.resistance)
        pairs = tuple(
            link_ends(f"{field}.between", text, plate.element_names, fields)
            for text in link.between
        )
        if resistance is not None:
            links.append(CircuitLink(resistance, link.factor, pairs))
    capacitance = fields.value("circuit.capacitance", table.capacitance, HEAT_CAPACITY)
    return Circuit(capacitance, tuple(links))


def link_ends(
    field: str,
    text: str,
    elements: tuple[str, ...],
    fields: Fields,
    others: Sequence[str] = (AMBIENT,),
) -> tuple[str, str]:
    """The two ends of a link such as "V11-V12".

    **Arguments:**

    - `field`, `text`: the name of the field, and its text.
    - `elements`: the names of the elements of the plate. `others`: other names that an end may
      have.

    **Raises:** `RigError` if it does not have two different known ends.
    """
    ends = text.split("-")
    if len(ends) != 2:
        fields.refuse(field, f'expected two nodes such as "V11-V12", got {text!r}')
    first, second = (end.strip() for end in ends)
    for end in (first, second):
        if end not in others:
            fields.check_element(field, end, elements, [o for o in others if o != AMBIENT])
    if first == second:
        fields.refuse(field, f"expected two different nodes, got {text!r}")
    return first, second


def blown(
    resistance: Value | Switched, fan: "FanTable | None", at: str, fields: Fields
) -> Value | Switched:
    r"""A resistance to air that a fan moves, $R n^{-m}$, K/W.

    The fan's speed $n$ may be an input, which may be 0: no heat then passes this resistance. It is
    relative to the speed for which the resistance $R$ is stated. The
    velocity of the air is proportional to it, and heat transfer to air that flows along a surface
    rises with its velocity to the power of $m$ = 1/2 if the flow is laminar (Pohlhausen), of 4/5
    if it is turbulent.

    **Arguments:**

    - `resistance`: $R$, K/W. `fan`: the table of the fan; None without a fan.
    - `at`: the place of the table `fan` in the file, for messages.

    **Raises:** `RigError` if the speed is no number above 0.
    """
    if fan is None:
        return resistance
    speed = fields.input_or_value(f"{at}.fan.speed", fan.speed, FACTOR)
    return resistance * speed**-fan.exponent
