"""The layers of the picture of a network below its plate: cells, sinks, surroundings and bodies, or
the nodes of a rig without a plate. The size of the picture is chosen such that all of it can be
read.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

from .._celsius import ZERO_CELSIUS
from .._number_text import short_number
from ..physics import OWN_VOLTAGE, Link, ThermoelectricElement, Twin, network_layout, sensor_name
from ..rig import AMBIENT, Body, Channel, Plate
from ._panels import write
from ._style import palette

WIDEST, HIGHEST = 11.0, 5.2
"""The largest size of a plate whose elements are readable at this size, inches."""

SMALLEST_SIDE, LARGEST_SIDE = 1.15, 2.2
"""Limits of the size of a typical element, with room for its name and its links, inches."""

# The largest side of a plate with any number of elements, inches.
MAX_PLATE = 18.0

BOX, BOX_HEIGHT, GAP = 1.5, 0.47, 0.34
"""The width and height of a node behind the plate, and the gap between two of them, inches."""

# The distance between two cells, whose values stand beside them, inches.
CELL_PITCH = 2.85

# The largest number of cells in a row.
CELLS_PER_ROW = 4

# The width of a legend of three columns, inches.
LEGEND_WIDTH = 6.0


@final
@dataclass(frozen=True)
class NetlistLayout:
    """The positions on axes whose unit is 1 cm of the plate.

    **Arguments:**

    - `inch`: the length on the axes that is an inch of the picture, cm.
    - `plate`: the left and right edge, and the top and bottom edge, of the plate, cm.
    - `width`: the width of the whole drawing, which is centred on the plate, cm.
    - `columns`: the number of cells in a row.
    """

    inch: float
    plate: tuple[float, float, float, float]
    width: float
    columns: int

    @property
    def left(self) -> float:
        """Left edge of the drawing, cm."""
        left, right, _, _ = self.plate
        return (left + right - self.width) / 2

    def cell_centre(self, number: int, count: int) -> float:
        """The centre of one of several cells, cm from the plate's left edge."""
        row = number // self.columns
        in_row = min(self.columns, count - row * self.columns)
        return self.left + self.width * (number % self.columns + 0.5) / in_row


def netlist_layout(plate: Plate, cells: int) -> NetlistLayout:
    """The layout for a plate, or a rig without one, with this many cells."""
    rows = -(-cells // CELLS_PER_ROW)
    columns = -(-cells // rows) if rows else 1
    if not plate.columns:
        width = max(CELL_PITCH * columns, COLUMN_PITCH)
        return NetlistLayout(1.0, (0.0, 0.0, 0.0, 0.0), width, columns)
    width, height = 100 * plate.width, 100 * plate.height
    extents = 100 * np.array([plate.extent(element) for element in plate.element_names])
    side = float(np.median(np.minimum(*(np.diff(extents)[:, ::2].T))))
    scale = min(WIDEST / width, HIGHEST / height)  # inches per cm
    scale = float(np.clip(scale, SMALLEST_SIDE / side, LARGEST_SIDE / side))
    inch = 1 / min(scale, MAX_PLATE / max(width, height))
    widest = max(width, inch * CELL_PITCH * columns, inch * LEGEND_WIDTH)
    return NetlistLayout(inch, (0.0, width, 0.0, height), widest, columns)


@final
class Picture(NamedTuple):
    """What every layer of the picture of a network needs.

    - `ax`: axes whose unit is 1 cm, with the plate's top left corner at 0, 0.
    - `twin`: the twin. `values`: the values of its parameters, SI.
    - `texts`: node -> the text in its box.
    - `layout`: the positions.
    """

    ax: Axes
    twin: Twin
    values: Mapping[str, float]
    texts: Mapping[str, str]
    layout: NetlistLayout

    def resistance(self, *parallel: Link) -> str:
        """The resistance of links beside each other as text."""
        each = [float(link.resistance(self.values)) for link in parallel]
        whole = each[0] if len(each) == 1 else 1 / sum(1 / resistance for resistance in each)
        return f"{short_number(whole, 3)} K/W"

    def held(self, part: Any) -> str:
        """The temperature at which a part is held as text."""
        return f"held at {part.temperature.evaluate(self.values) - ZERO_CELSIUS:.3g} °C"

    def lags(self) -> dict[str, float]:
        """The node of each sensor with a lag -> its lag, s."""
        return {
            sensor_name(channel.name): float(channel.lag.evaluate(self.values))
            for channel in self.twin.rig.channels
            if channel.lag is not None
        }

    def heater(self, heater: ThermoelectricElement) -> str:
        """The power of a heater, or the resistance that the driver feeds, as text."""
        resistance = float(heater.electrical_resistance.evaluate(self.values))
        if heater.has_own_supply:
            return f"{short_number(OWN_VOLTAGE.factor**2 / resistance, 3)} W"
        return f"{short_number(resistance, 3)} Ω"


def draw_dot(ax: Axes, at: tuple[float, float], color: str, marker: str = "o") -> None:
    """Draws the end of a line at a part of the rig."""
    ax.plot(*at, marker, color=color, ms=6, mec=palette().ground, mew=1.2, zorder=5)


def draw_ring(ax: Axes, at: tuple[float, float], size: float | int) -> None:
    """Draws the end of a line to the surroundings."""
    look = {"mfc": palette().ground, "mec": palette().blue, "mew": size / 5}
    ax.plot(*at, "o", ms=size, zorder=4, **look)


# The distance between the plate and the first box of a cell, inches.
ABOVE = 0.62

# The largest number of contacts of a cell that are named one by one.
MAX_NAMED_CONTACTS = 4


def draw_cells(picture: Picture) -> float:
    """Draws each cell as a column of boxes below the plate, in one row or several.

    **Returns:** the lower edge of the lowest cell, cm.
    """
    layout = picture.layout
    lowest = top = layout.plate[3]
    cells = [cell for cell in picture.twin.netlist.cells if not cell.is_heater]
    for number, cell in enumerate(cells):
        if number % layout.columns == 0:
            top = lowest + (ABOVE + 0.2 * (number > 0)) * layout.inch
        x = layout.cell_centre(number, len(cells))
        lowest = max(lowest, _draw_column(picture, cell, x, top))
    return lowest


def _draw_column(picture: Picture, cell: ThermoelectricElement, x: float, top: float) -> float:
    """Draws a cell from its contacts down to the surroundings, and returns its lower edge, cm."""
    ax, twin, values, color = picture.ax, picture.twin, picture.values, palette().vermilion
    inch = picture.layout.inch
    begin = top - 0.24 * inch
    ax.plot([x, x], [begin, top], color=color, lw=2, zorder=2)
    draw_dot(ax, (x, begin), color)
    draw_note(ax, x + 0.12 * inch, begin, _contact_names(twin, cell))
    beside = (x - (BOX / 2 + 0.12) * inch, top + BOX_HEIGHT / 2 * inch)
    look = {"ha": "right", "va": "center"}
    write(ax, cell.name, beside, (0, 6), size=11, color=color, fontweight="bold", **look)
    alpha = cell.seebeck_coefficient.evaluate(values)
    R_E = cell.electrical_resistance.evaluate(values)
    write(ax, f"{alpha:.3g} V/K", beside, (0, -8), size=8, **look)
    write(ax, f"{R_E:.3g} Ω", beside, (0, -19), size=8, **look)
    kinds = {cell.cold: "plate side", cell.hot: "far side", f"{cell.name}.SINK": "sink"}
    node, y = cell.cold, top
    while node in kinds:
        draw_box(ax, x, y, inch, node, f"{kinds[node]}, {picture.texts[node]}")
        link = next((link for link in twin.netlist.links if link.a == node), None)
        if link is None:  # the far side is isolated
            return y + BOX_HEIGHT * inch
        below = y + (BOX_HEIGHT + GAP) * inch
        ax.plot([x, x], [y + BOX_HEIGHT * inch, below], color=color, lw=2, zorder=2)
        middle = y + (BOX_HEIGHT + 0.45 * GAP) * inch
        draw_note(ax, x + 0.12 * inch, middle, picture.resistance(link))
        node, y = link.b, below
    draw_ring(ax, (x, y), 8)
    ambient = twin.rig.ambient_temperature.evaluate(values) - ZERO_CELSIUS
    end = f"air, {ambient:.3g} °C" if node == AMBIENT else node
    draw_note(ax, x + 0.17 * inch, y + 0.03 * inch, end)
    return y


def _contact_names(twin: Twin, cell: ThermoelectricElement) -> str:
    for placement in twin.rig.placements:
        if placement.name == cell.name:
            width, height = (100 * side for side in placement.size)
            return f"on {width:g} cm × {height:g} cm of the plate"
    names = [link.a for link in twin.netlist.links if link.b == cell.cold]
    if len(names) > MAX_NAMED_CONTACTS:
        return f"on {len(names)} elements"
    return f"on {', '.join(names)}"


def draw_box(ax: Axes, x: float, y: float, inch: float, name: str, text: str) -> None:
    """Draws a node behind the plate: a box whose upper edge has its middle at x and y, cm."""
    style = f"round,pad=0,rounding_size={0.07 * inch}"
    look = {"fc": palette().ground, "ec": palette().vermilion, "lw": 1.3, "zorder": 3}
    corner = (x - BOX / 2 * inch, y)
    ax.add_patch(FancyBboxPatch(corner, BOX * inch, BOX_HEIGHT * inch, boxstyle=style, **look))
    middle = (x, y + BOX_HEIGHT / 2 * inch)
    look = {"size": 8.5, "ha": "center", "va": "center", "color": palette().ink, "zorder": 4}
    write(ax, name, middle, (0, 5.5), fontweight="bold", **look)
    write(ax, text, middle, (0, -5.5), **look)


def draw_note(ax: Axes, x: float, y: float, text: str) -> None:
    """Writes a note to the right of a point, cm."""
    write(ax, text, (x, y), size=8, ha="left", va="center", zorder=4)


# The distance between two bodies, inches.
BODY_PITCH = 2.0

# The distance between two of the notes below a body, inches.
NOTE_PITCH = 0.17


def draw_bodies(picture: Picture, top: float) -> float:
    """Draws each body as a box below the cells. The names of the bodies to which it is linked, with
    the resistances in K/W, are written below the box, because wires between boxes could not be
    distinguished.

    **Arguments:**

    - `top`: the lower edge of the drawing above the bodies, cm.

    **Returns:** the lower edge of the lowest body, cm.
    """
    inch, bodies = picture.layout.inch, picture.twin.rig.bodies
    columns = max(1, int(picture.layout.width / (BODY_PITCH * inch)))
    layout = replace(picture.layout, columns=columns)
    lowest = top
    for number, body in enumerate(bodies):
        if number % columns == 0:
            top = lowest + ABOVE / 2 * inch
        x = layout.cell_centre(number, len(bodies))
        is_free = body.temperature is None
        text = f"body, {picture.texts[body.name]}" if is_free else picture.held(body)
        draw_box(picture.ax, x, top, inch, body.name, text)
        y = top + BOX_HEIGHT * inch
        for note in _body_notes(picture, body):
            y += NOTE_PITCH * inch
            draw_note(picture.ax, x - (BOX / 2 - 0.1) * inch, y, note)
        lowest = max(lowest, y)
    return lowest


def _body_notes(picture: Picture, body: Body) -> Iterator[str]:
    """The heaters in a body, and what it is linked to."""
    rig, netlist, lags = picture.twin.rig, picture.twin.netlist, picture.lags()
    for heater in netlist.cells:
        if heater.is_heater and heater.cold == body.name:
            yield f"{heater.name}, {picture.heater(heater)}"
    links = [link for link in netlist.links if body.name in (link.a, link.b)]
    # The many contacts of a heater that lies on the plate are written as one.
    placed = {place.name: place.elements(rig.plate) for place in rig.placements}
    on_plate = placed.get(body.name, ())
    contacts = [link for link in links if link.b in on_plate]
    if contacts:
        yield f"{picture.resistance(*contacts)} to the plate"
    # In a box, air is a body.
    surroundings = "air" if all(body.name != "air" for body in rig.bodies) else AMBIENT
    for link in links:
        if link.b in on_plate:
            continue
        other = link.a if link.b == body.name else link.b
        if other in lags:
            yield f"{other.removesuffix('.SENSOR')}, {lags[other]:.3g} s behind"
            continue
        by = f" by {link.role}" if link.role in ("convection", "radiation") else ""
        name = surroundings if other == AMBIENT else other
        yield f"{picture.resistance(link)} to {name}{by}"


# The distances of columns and rows of a network without a plate, inches.
COLUMN_PITCH, ROW_PITCH = 2.5, 1.35


def draw_network(picture: Picture) -> float:
    """Draws the network of a rig without a plate: its nodes, lines between those that are linked,
    with the resistance in K/W, and the losses of each to the surroundings. The unit of the axes is
    1 inch.

    **Returns:** the lower edge of the drawing.
    """
    ax, netlist = picture.ax, picture.twin.netlist
    places, links, lost = layout = network_layout(netlist)
    columns, rows = layout.size
    middles = {
        name: ((column - (columns - 1) / 2) * COLUMN_PITCH, 0.35 + row * ROW_PITCH + BOX_HEIGHT / 2)
        for name, (column, row) in places.items()
    }
    for (a, b), parallel in links.items():
        (x1, y1), (x2, y2) = middles[a], middles[b]
        if x1 == x2:  # beside what is written below a box
            x1 = x2 = x1 + BOX / 2 - 0.08
        ax.plot([x1, x2], [y1, y2], color=palette().vermilion, lw=2, zorder=2)
        middle = ((x1 + x2) / 2, (y1 + y2) / 2)
        box = {"boxstyle": "square,pad=0.15", "fc": palette().ground, "ec": "none"}
        look = {"ha": "center", "va": "center", "zorder": 2.5, "bbox": box}
        write(ax, picture.resistance(*parallel), middle, size=8, **look)
    held = {reservoir.name: picture.held(reservoir) for reservoir in netlist.reservoirs}
    for name, middle in middles.items():
        text = held.get(name, picture.texts.get(name, ""))
        _draw_node(picture, name, middle, text, lost.get(name, ()))
    return 0.35 + (rows - 1) * ROW_PITCH + BOX_HEIGHT + 0.5


def _draw_node(
    picture: Picture, name: str, middle: tuple[float, float], text: str, lost: Sequence[Link]
) -> None:
    """Draws a node with its heaters above it, and its losses and sensors below."""
    ax, twin = picture.ax, picture.twin
    x, y = middle
    draw_box(ax, x, y - BOX_HEIGHT / 2, 1.0, name, text)
    left, below = x - BOX / 2, y + BOX_HEIGHT / 2
    heaters = [cell for cell in twin.netlist.cells if cell.cold == name]
    if heaters:
        note = ", ".join(f"{heater.name}, {picture.heater(heater)}" for heater in heaters)
        draw_note(ax, left, y - BOX_HEIGHT / 2 - 0.12, note)
    if lost:
        foot = (left + 0.18, below + 0.3)
        ax.plot([foot[0], foot[0]], [below, foot[1]], color=palette().blue, lw=2, zorder=2)
        draw_ring(ax, foot, 7)
        kinds = sorted({link.role for link in lost} & {"convection", "radiation"})
        by = f" by {' and '.join(kinds)}" if kinds else ""
        draw_note(ax, foot[0] + 0.1, foot[1], f"{picture.resistance(*lost)} to the room{by}")
        below += 0.36
    seen = [channel for channel in twin.rig.channels if _seen_node(twin, channel) == name]
    for place, channel in enumerate(seen):
        lag = channel.lag
        behind = "" if lag is None else f", {lag.evaluate(picture.values):.3g} s behind"
        at = below + 0.12 + NOTE_PITCH * place
        draw_note(ax, left + 0.05, at, f"{channel.name}{behind}")


def _seen_node(twin: Twin, channel: Channel) -> str:
    """The node that counts most in a channel."""
    weights = channel.sensor.weights(twin.rig.plate)
    return max(weights, key=lambda name: weights[name])
