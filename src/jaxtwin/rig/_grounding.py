"""The check that heat has a path from each node of a rig to the surroundings."""

from collections.abc import Iterator, Sequence

from ._body import Body
from ._cell import Cell
from ._circuit import Circuit, CircuitLink, NonlinearLink
from ._fields import Fields
from ._heater import Heater
from ._plate import AMBIENT, Plate


def check_grounded(
    plate: Plate,
    circuit: Circuit | None,
    cells: Sequence[Cell],
    heaters: Sequence[Heater],
    bodies: Sequence[Body],
    links: Sequence[CircuitLink | NonlinearLink],
    fields: Fields,
) -> None:
    """Refuses a part of the rig whose heat has no path to the surroundings or to a body at a fixed
    temperature: it has no steady state.

    **Arguments:** the parts of the rig.

    **Raises:** `RigError` that names the part.
    """
    pairs = [*_of_plate(plate, circuit), *_of_cells(cells)]
    pairs += [pair for link in links for pair in link.between]
    held = {AMBIENT, *(body.name for body in bodies if body.temperature is not None)}
    reached = _reached(held, pairs)
    for element in plate.element_names:
        if element not in reached:
            fields.refuse(
                "circuit.links",
                f'expected a path from each node to "{AMBIENT}", got none from {element}; add a '
                "link",
            )
    warmed = {heater.name for heater in heaters}
    for body in bodies:
        if body.name not in reached:
            part = "heaters" if body.name in warmed else "bodies"
            to = "to the plate, " if plate.columns else ""
            fields.refuse(
                f"{part}[{body.name}]",
                f"expected a path for its heat {to}to ambient or to a body that is held at a "
                "temperature, got none; add a link",
            )
    for cell in cells:
        if _name(cell) not in reached:
            fields.refuse(
                f"cells[{cell.name}]",
                "expected a path for its heat to ambient or to a body that is held at a "
                "temperature, got none; give it a sink_resistance",
            )


def _of_plate(plate: Plate, circuit: Circuit | None) -> Iterator[tuple[str, str]]:
    if circuit is None:  # the film of the outer edges, and conduction between the elements
        yield from ((element, AMBIENT) for element in plate.element_names)
        return
    for link in circuit.links:
        yield from link.between


def _of_cells(cells: Sequence[Cell]) -> Iterator[tuple[str, str]]:
    """The paths through the cells, whose two sides are taken together."""
    for cell in cells:
        yield from ((node, _name(cell)) for node, _ in cell.contacts)
        is_isolated = cell.sink_capacitance is not None and cell.sink_air_resistance is None
        if cell.sink_resistance is not None and not is_isolated:
            yield _name(cell), cell.sink or AMBIENT


def _name(cell: Cell) -> str:
    return f"cells[{cell.name}]"  # which no body has


def _reached(start: set[str], pairs: Sequence[tuple[str, str]]) -> set[str]:
    neighbours: dict[str, set[str]] = {}
    for first, second in pairs:
        neighbours.setdefault(first, set()).add(second)
        neighbours.setdefault(second, set()).add(first)
    reached, waiting = set(start), list(start)
    while waiting:
        new = neighbours.get(waiting.pop(), set()) - reached
        reached |= new
        waiting += new
    return reached
