"""Builds a circuit from the table `[circuit]` of a rig file."""

from collections.abc import Sequence

from ._body import Body
from ._circuit import Circuit, CircuitLink
from ._fields import Fields
from ._plate import AMBIENT, Plate
from ._schema import CellTable, CircuitTable
from ._units import HEAT_CAPACITY, THERMAL_RESISTANCE


def build_circuit(
    table: CircuitTable,
    plate: Plate,
    cells: list[CellTable],
    bodies: Sequence[Body],
    body_links: Sequence[CircuitLink],
    fields: Fields,
) -> Circuit:
    """Builds the circuit that a file states link by link.

    **Arguments:**

    - `cells`, `bodies`, `body_links`: the other parts through which heat may leave the plate.

    **Raises:** `RigError` if a link has an unknown end or the same end twice, or if an
    element of the plate has no path to the surroundings.
    """
    nodes = (*plate.element_names, AMBIENT)
    links = []
    for link in table.links:
        field = f"circuit.links[{link.resistance}]"
        resistance = fields.value(f"{field}.resistance", link.resistance, THERMAL_RESISTANCE)
        pairs = tuple(
            link_ends(f"{field}.between", text, plate.element_names, fields)
            for text in link.between
        )
        links.append(CircuitLink(resistance, link.factor, pairs))
    capacitance = fields.value("circuit.capacitance", table.capacitance, HEAT_CAPACITY)
    # A cell is a path to the surroundings, through its sink. A body at a fixed temperature counts
    # as the surroundings.
    held = {body.name: AMBIENT for body in bodies if body.temperature is not None}
    paths = [
        (element, cell.sink or AMBIENT)
        for cell in cells
        for element in cell.contacts
        if element in nodes
    ]
    paths += [pair for link in (*links, *body_links) for pair in link.between]
    paths = [(held.get(a, a), held.get(b, b)) for a, b in paths]
    free = tuple(body.name for body in bodies if body.temperature is None)
    _check_grounded(paths, (*nodes, *free), fields)
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


def _check_grounded(pairs: list[tuple[str, str]], nodes: tuple[str, ...], fields: Fields) -> None:
    # A part of the plate without a way to the surroundings has no steady state.
    neighbours: dict[str, set[str]] = {node: set() for node in nodes}
    for first, second in pairs:
        neighbours[first].add(second)
        neighbours[second].add(first)
    reached, waiting = {AMBIENT}, [AMBIENT]
    while waiting:
        new = neighbours[waiting.pop()] - reached
        reached |= new
        waiting += new
    for node in nodes:
        if node not in reached:
            fields.refuse(
                "circuit.links",
                f'expected a path from each node to "{AMBIENT}", got none from {node}; add a link',
            )
