"""The plate as a network: finite volumes from its geometry, or a circuit given link by link."""

from collections.abc import Mapping

from ..rig import Circuit, Input, Plate, Value
from ..rig._plate import AMBIENT
from ._netlist import Link

# The part of the faces of an element that nothing covers, if nothing touches it.
FULL_FACE = Value(1.0)


def element_capacitance(plate: Plate, element: str) -> Value:
    r"""Capacitance of one element, $C_T = m c$, eq. (1) of the paper, J/K."""
    assert plate.density is not None
    assert plate.specific_heat is not None
    left, right, top, bottom = plate.extent(element)
    volume = (right - left) * (bottom - top) * plate.thickness
    return plate.density * plate.specific_heat * volume


def finite_volume_links(plate: Plate, bare: Mapping[str, Value]) -> list[Link]:
    r"""All links of a plate that is given by geometry and material, eqs. (2)-(6) of the paper.

    Between neighbours: half of each element in series, $R_{Tcd} = \Delta l / (2 k A)$ each.
    To the surroundings, from both faces and from every outer edge: half the element in series
    with the film, $R_{Tcv} = 1 / (h A)$.

    **Arguments:**

    - `plate`: a plate with density, specific heat, conductivity and film coefficient.
    - `bare`: element -> the part of its two faces that nothing covers, through which heat leaves,
      0 to 1; all of those of elements that are left out.
    """
    grid = _grid(plate)
    links = []
    for r, row in enumerate(grid):
        for c, name in enumerate(row):
            if c + 1 < len(row):
                series = (_half_x(plate, name), _half_x(plate, row[c + 1]))
                links.append(Link(name, row[c + 1], series, "conduction"))
            if r + 1 < len(grid):
                series = (_half_y(plate, name), _half_y(plate, grid[r + 1][c]))
                links.append(Link(name, grid[r + 1][c], series, "conduction"))
    for r, row in enumerate(grid):
        for c, name in enumerate(row):
            left, right, top, bottom = plate.extent(name)
            width, height = right - left, bottom - top
            film = _film_coefficient(plate, r, c)
            faces = Value(2 * width * height) * bare.get(name, FULL_FACE)
            if faces.factor > 0:
                half = _half_z(plate, faces)
                links.append(Link(name, AMBIENT, (half, 1 / (film * faces)), "film"))
            ends = (c == 0) + (c == len(row) - 1)
            if ends:
                convection = 1 / (film * plate.thickness * (height * ends))
                half = _half_x(plate, name) / ends
                links.append(Link(name, AMBIENT, (half, convection), "film"))
            sides = (r == 0) + (r == len(grid) - 1)
            if sides:
                convection = 1 / (film * plate.thickness * (width * sides))
                half = _half_y(plate, name) / sides
                links.append(Link(name, AMBIENT, (half, convection), "film"))
    return links


def exposed_area(plate: Plate, element: str, bare: Value) -> tuple[Value, ...]:
    """The surface of an element that is exposed to the room, m^2: both faces without the parts that
    cells cover, and the outer edges, as terms of a sum.

    **Arguments:**

    - `bare`: the part of its two faces that nothing covers, 0 to 1.
    """
    left, right, top, bottom = plate.extent(element)
    width, height = right - left, bottom - top
    outer = [
        (left, 0.0, height),
        (right, plate.width, height),
        (top, 0.0, width),
        (bottom, plate.height, width),
    ]
    rim = sum(length for at, edge, length in outer if abs(at - edge) < 1e-9)
    return (Value(2 * width * height) * bare, plate.thickness * rim)


def circuit_links(circuit: Circuit, inputs: tuple[Input, ...]) -> list[Link]:
    """All plate links of a circuit that a rig file gives link by link."""
    return [
        Link.of(inputs, a, b, group.resistance * group.factor, _role(b))
        for group in circuit.links
        for a, b in (_ambient_last(pair) for pair in group.between)
    ]


def _role(end: str) -> str:
    return "film" if end == AMBIENT else "conduction"


def _grid(plate: Plate) -> list[tuple[str, ...]]:
    names, columns = plate.element_names, len(plate.columns)
    return [names[start : start + columns] for start in range(0, len(names), columns)]


def _half_x(plate: Plate, element: str) -> Value:
    """$R_{Tcdx}$ of eq. (3): from the centre to a face across x, K/W."""
    assert plate.conductivity is not None
    left, right, top, bottom = plate.extent(element)
    return (right - left) / 2 / (plate.conductivity * plate.thickness * (bottom - top))


def _half_y(plate: Plate, element: str) -> Value:
    """$R_{Tcdy}$ of eq. (3), K/W."""
    assert plate.conductivity is not None
    left, right, top, bottom = plate.extent(element)
    return (bottom - top) / 2 / (plate.conductivity * plate.thickness * (right - left))


def _half_z(plate: Plate, area: Value) -> Value:
    """$R_{Tcdz}$ of eq. (3) through a given area of the faces, K/W."""
    assert plate.conductivity is not None
    return plate.thickness / (plate.conductivity * (2 * area))


def _film_coefficient(plate: Plate, row: int, column: int) -> Value:
    assert plate.film_coefficient is not None
    return plate.film_coefficient[column] * plate.film_row_factor[row]


def _ambient_last(pair: tuple[str, str]) -> tuple[str, str]:
    a, b = pair
    return (b, a) if a == AMBIENT else (a, b)
