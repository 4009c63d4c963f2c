"""Builds a circuit from the table `[circuit]` of a rig file."""

from collections.abc import Sequence

from ._circuit import Circuit, CircuitLink
from ._fields import Fields
from ._plate import AMBIENT, Plate
from ._schema import CircuitTable
from ._units import HEAT_CAPACITY


def build_circuit(table: CircuitTable, plate: Plate, fields: Fields) -> Circuit:
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
