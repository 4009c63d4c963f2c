"""Draws the parts beside the plate in the picture of a network: cells, sinks, surroundings, bodies,
links and sensors with a lag. The size of the picture is chosen such that all of it can be read.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch, Polygon
from matplotlib.patheffects import AbstractPathEffect, withStroke

from .._celsius import ZERO_CELSIUS
from .._number_text import short_number
from ..physics import OWN_VOLTAGE, Link, ThermoelectricElement, Twin, network_layout, sensor_name
from ..rig import AMBIENT, Channel, Plate
from ._style import INK, palette, points

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


# The distance between the plate and the first box of a cell, inches.
ABOVE = 0.62

# The largest number of contacts of a cell that are named one by one.
MAX_NAMED_CONTACTS = 4


def outlined(width: float) -> list[AbstractPathEffect]:
    """A rim for a line of this width, so that it is visible over any colour."""
    return [withStroke(linewidth=width + 1.6, foreground=palette().ground, alpha=0.75)]


def draw_contacts(ax: Axes, twin: Twin, values: Mapping[str, float], layout: NetlistLayout) -> None:
    """Draws a stub from each element to each cell that touches it, with the contact's K/W, and to
    each heater whose heat goes into it, with its power or resistance. A cell or heater that the rig
    file places is drawn as it lies on the plate.

    The stub ends in a dot with the cell's name, like a net in a circuit diagram, because wires
    across the plate could not be distinguished.

    **Arguments:**

    - `ax`: axes whose unit is 1 cm, with the plate's top left corner at 0, 0.
    - `twin`: the twin with the cells. `values`: the values of its parameters, SI.
    - `layout`: the layout of the picture.
    """
    drawn = dict.fromkeys(twin.rig.plate.element_names, 0)
    placed = {placement.name: placement for placement in twin.rig.placements}
    for name, placement in placed.items():
        _draw_placed(ax, name, 100 * placement.outline(values))
    for cell in twin.netlist.cells:
        if cell.name in placed:
            continue
        touched = [
            (link.a, f"{float(link.resistance(values)):.3g} K/W")
            for link in twin.netlist.links
            if link.role == "contact" and link.b == cell.cold
        ]
        touched += [(cell.cold, heater_text(cell, values))] if cell.is_heater else []
        for element, text in touched:
            if element not in drawn:
                continue
            left, right, top, bottom = (100 * edge for edge in twin.rig.plate.extent(element))
            x, y = (left + right) / 2, (top + bottom) / 2
            reach = 0.22 * min(right - left, bottom - top)
            # A second cell at the same element stands to the left of the first.
            x_end, y_end = x + reach * (1 - 2 * drawn[element]), y - reach
            drawn[element] += 1
            ax.plot(
                [x, x_end],
                [y, y_end],
                color=palette().vermilion,
                lw=2,
                zorder=3,
                path_effects=outlined(2.0),
            )
            ax.plot(
                x_end,
                y_end,
                "o",
                color=palette().vermilion,
                ms=6,
                mec=palette().ground,
                mew=1.2,
                zorder=5,
            )
            upright = right - left < 0.6 * layout.inch
            gap = "  " if upright else "\n"
            ax.annotate(
                f"{cell.name}{gap}{text}", (x_end, y_end),
                (0, 5), textcoords="offset points", ha="center", va="bottom", color=INK,
                fontsize=points(7.5), linespacing=1.1, rotation=90 if upright else 0, zorder=6,
            )  # fmt: skip


def _draw_placed(ax: Axes, name: str, corners: Float[np.ndarray, "corners 2"]) -> None:
    ax.add_patch(
        Polygon(
            corners, fc=palette().vermilion, ec=palette().vermilion, alpha=0.25, lw=2, zorder=2.5
        )
    )
    ax.annotate(
        name, corners.mean(axis=0), ha="center", va="center", color=INK, fontsize=points(11),
        fontweight="bold", path_effects=outlined(2.0), zorder=7,
    )  # fmt: skip


def heater_text(heater: ThermoelectricElement, values: Mapping[str, float]) -> str:
    """The power of a heater, or the resistance that the driver feeds."""
    resistance = float(heater.electrical_resistance.evaluate(values))
    if heater.has_own_supply:
        return f"{short_number(OWN_VOLTAGE.factor**2 / resistance, 3)} W"
    return f"{short_number(resistance, 3)} Ω"


def draw_cells(
    ax: Axes,
    twin: Twin,
    values: Mapping[str, float],
    texts: Mapping[str, str],
    layout: NetlistLayout,
) -> float:
    """Draws each cell as a column of boxes below the plate, in one row or several.

    **Arguments:**

    - `ax`, `twin`, `values`, `layout`: as in `draw_contacts`.
    - `texts`: the text in the box of each node.

    **Returns:** the lower edge of the lowest cell, cm.
    """
    lowest = layout.plate[3]
    top = lowest
    cells = [cell for cell in twin.netlist.cells if not cell.is_heater]
    for number, cell in enumerate(cells):
        if number % layout.columns == 0:
            top = lowest + (ABOVE + 0.2 * (number > 0)) * layout.inch
        x = layout.cell_centre(number, len(cells))
        lowest = max(
            lowest, _draw_column(ax, twin, cell, values, texts, x=x, top=top, inch=layout.inch)
        )
    return lowest


def _draw_column(
    ax: Axes,
    twin: Twin,
    cell: ThermoelectricElement,
    values: Mapping[str, float],
    texts: Mapping[str, str],
    *,
    x: float,
    top: float,
    inch: float,
) -> float:
    """Draws a cell from its contacts down to the surroundings, and returns its lower edge, cm."""
    kinds = {cell.cold: "plate side", cell.hot: "far side"}
    own = {cell.cold, cell.hot, f"{cell.name}.SINK"}
    alpha = cell.seebeck_coefficient.evaluate(values)
    R_E = cell.electrical_resistance.evaluate(values)
    begin = top - 0.24 * inch
    ax.plot([x, x], [begin, top], color=palette().vermilion, lw=2, zorder=2)
    ax.plot(x, begin, "o", color=palette().vermilion, ms=6, mec=palette().ground, mew=1.2, zorder=5)
    draw_note(ax, x + 0.12 * inch, begin, _contact_names(twin, cell))
    beside = (x - (BOX / 2 + 0.12) * inch, top + BOX_HEIGHT / 2 * inch)
    look: dict[str, Any] = {"textcoords": "offset points", "ha": "right", "va": "center"}
    ax.annotate(
        cell.name,
        beside,
        (0, 6),
        fontsize=points(11),
        fontweight="bold",
        color=palette().vermilion,
        **look,
    )
    ax.annotate(
        f"{alpha:.3g} V/K", beside, (0, -8), fontsize=points(8), color=palette().muted, **look
    )
    ax.annotate(f"{R_E:.3g} Ω", beside, (0, -19), fontsize=points(8), color=palette().muted, **look)
    node, y = cell.cold, top
    while node in own:
        draw_box(ax, x, y, inch, node, f"{kinds.get(node, 'sink')}, {texts[node]}")
        link = next((link for link in twin.netlist.links if link.a == node), None)
        if link is None:  # the far side is isolated
            return y + BOX_HEIGHT * inch
        below = y + (BOX_HEIGHT + GAP) * inch
        ax.plot([x, x], [y + BOX_HEIGHT * inch, below], color=palette().vermilion, lw=2, zorder=2)
        resistance = f"{float(link.resistance(values)):.3g} K/W"
        draw_note(ax, x + 0.12 * inch, y + (BOX_HEIGHT + 0.45 * GAP) * inch, resistance)
        node, y = link.b, below
    ax.plot(x, y, "o", mfc=palette().ground, mec=palette().blue, mew=1.6, ms=8, zorder=4)
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
    corner, rounding = (x - BOX / 2 * inch, y), 0.07 * inch
    style = f"round,pad=0,rounding_size={rounding}"
    look = {
        "boxstyle": style,
        "fc": palette().ground,
        "ec": palette().vermilion,
        "lw": 1.3,
        "zorder": 3,
    }
    ax.add_patch(FancyBboxPatch(corner, BOX * inch, BOX_HEIGHT * inch, **look))
    middle = y + BOX_HEIGHT / 2 * inch
    look = {"textcoords": "offset points", "ha": "center", "va": "center", "zorder": 4}
    ax.annotate(
        name,
        (x, middle),
        (0, 5.5),
        fontsize=points(8.5),
        fontweight="bold",
        color=palette().ink,
        **look,
    )
    ax.annotate(text, (x, middle), (0, -5.5), fontsize=points(8.5), color=palette().ink, **look)


def draw_note(ax: Axes, x: float, y: float, text: str) -> None:
    """Writes a note to the right of a point, cm."""
    ax.annotate(
        text, (x, y), ha="left", va="center", fontsize=points(8), color=palette().muted, zorder=4
    )


# The distance between two bodies, inches.
BODY_PITCH = 2.0

# The distance between two of the notes below a body, inches.
NOTE_PITCH = 0.17


def draw_bodies(
    ax: Axes,
    twin: Twin,
    values: Mapping[str, float],
    texts: Mapping[str, str],
    layout: NetlistLayout,
    top: float,
) -> float:
    """Draws each body as a box below the cells. The names of the bodies to which it is linked, with
    the resistances in K/W, are written below the box, because wires between boxes could not be
    distinguished.

    **Arguments:**

    - `ax`: axes whose unit is 1 cm, with the plate's top left corner at 0, 0.
    - `twin`: the twin with the bodies. `values`: the values of its parameters, SI.
    - `texts`: the text in the box of each node. `layout`: the layout of the picture.
    - `top`: the lower edge of the drawing above the bodies, cm.

    **Returns:** the lower edge of the lowest body, cm.
    """
    lags = {
        sensor_name(channel.name): float(channel.lag.evaluate(values))
        for channel in twin.rig.channels
        if channel.lag is not None
    }
    # The many contacts of a heater that lies on the plate are written as one.
    plate = twin.rig.plate
    placed = {p.name: frozenset(p.elements(plate)) for p in twin.rig.placements}
    # In a box, air is a body.
    surroundings = "air" if all(body.name != "air" for body in twin.rig.bodies) else AMBIENT
    lowest = top
    layout = replace(layout, columns=max(1, int(layout.width / (BODY_PITCH * layout.inch))))
    for number, body in enumerate(twin.rig.bodies):
        if number % layout.columns == 0:
            top = lowest + ABOVE / 2 * layout.inch
        x = layout.cell_centre(number, len(twin.rig.bodies))
        if body.temperature is None:
            text = f"body, {texts[body.name]}"
        else:
            text = f"held at {body.temperature.evaluate(values) - ZERO_CELSIUS:.3g} °C"
        draw_box(ax, x, top, layout.inch, body.name, text)
        y = top + BOX_HEIGHT * layout.inch
        for heater in twin.netlist.cells:
            if heater.is_heater and heater.cold == body.name:
                y += NOTE_PITCH * layout.inch
                note = f"{heater.name}, {heater_text(heater, values)}"
                draw_note(ax, x - (BOX / 2 - 0.1) * layout.inch, y, note)
        on_plate = placed.get(body.name, ())
        links = [link for link in twin.netlist.links if body.name in (link.a, link.b)]
        contacts = [link for link in links if link.b in on_plate]
        if contacts:
            y += NOTE_PITCH * layout.inch
            whole = 1 / sum(1 / link.resistance(values) for link in contacts)
            note = f"{float(whole):.3g} K/W to the plate"
            draw_note(ax, x - (BOX / 2 - 0.1) * layout.inch, y, note)
        for link in links:
            if link.b in on_plate:
                continue
            y += NOTE_PITCH * layout.inch
            other = link.a if link.b == body.name else link.b
            other = surroundings if other == AMBIENT else other
            note = f"{float(link.resistance(values)):.3g} K/W to {other}"
            if link.role in ("convection", "radiation"):
                note += f" by {link.role}"
            if other in lags:
                note = f"{other.removesuffix('.SENSOR')}, {lags[other]:.3g} s behind"
            draw_note(ax, x - (BOX / 2 - 0.1) * layout.inch, y, note)
        lowest = max(lowest, y)
    return lowest


# The distances of columns and rows of a network without a plate, inches.
COLUMN_PITCH, ROW_PITCH = 2.5, 1.35


def draw_network(
    ax: Axes, twin: Twin, values: Mapping[str, float], texts: Mapping[str, str], top: float
) -> float:
    """Draws the network of a rig without a plate: its nodes, lines between those that are linked,
    with the resistance in K/W, and the losses of each to the surroundings.

    **Arguments:** those of `draw_bodies`; the unit of the axes is 1 inch.

    **Returns:** the lower edge of the drawing.
    """
    places, links, lost = layout = network_layout(twin.netlist)
    columns, rows = layout.size
    colour = palette().vermilion

    def middle(name: str) -> tuple[float, float]:
        column, row = places[name]
        x = (column - (columns - 1) / 2) * COLUMN_PITCH
        return x, top + 0.35 + row * ROW_PITCH + BOX_HEIGHT / 2

    def whole(parallel: Sequence[Link]) -> str:
        total = 1 / sum(1 / float(link.resistance(values)) for link in parallel)
        return f"{short_number(total, 3)} K/W"

    for (a, b), parallel in links.items():
        (x1, y1), (x2, y2) = middle(a), middle(b)
        if x1 == x2:  # beside what is written below a box
            x1 = x2 = x1 + BOX / 2 - 0.08
        ax.plot([x1, x2], [y1, y2], color=colour, lw=2, zorder=2)
        ax.annotate(
            whole(parallel), ((x1 + x2) / 2, (y1 + y2) / 2), ha="center", va="center",
            fontsize=points(8), color=palette().muted, zorder=2.5,
            bbox={"boxstyle": "square,pad=0.15", "fc": palette().ground, "ec": "none"},
        )  # fmt: skip
    for name, (x, y) in ((name, middle(name)) for name in places):
        held = next(
            (reservoir for reservoir in twin.netlist.reservoirs if reservoir.name == name), None
        )
        text = texts.get(name, "")
        if held is not None:
            text = f"held at {held.temperature.evaluate(values) - ZERO_CELSIUS:.3g} °C"
        draw_box(ax, x, y - BOX_HEIGHT / 2, 1.0, name, text)
        heaters = [cell for cell in twin.netlist.cells if cell.cold == name]
        if heaters:
            note = ", ".join(f"{heater.name}, {heater_text(heater, values)}" for heater in heaters)
            draw_note(ax, x - BOX / 2, y - BOX_HEIGHT / 2 - 0.12, note)
        below = y + BOX_HEIGHT / 2
        if name in lost:
            foot = x - BOX / 2 + 0.18
            ax.plot([foot, foot], [below, below + 0.3], color=palette().blue, lw=2, zorder=2)
            ax.plot(foot, below + 0.3, "o", mfc=palette().ground, mec=palette().blue, mew=1.6, ms=7)
            kinds = sorted({link.role for link in lost[name]} & {"convection", "radiation"})
            by = f" by {' and '.join(kinds)}" if kinds else ""
            draw_note(ax, foot + 0.1, below + 0.3, f"{whole(lost[name])} to the room{by}")
        for place, channel in enumerate(
            channel for channel in twin.rig.channels if _seen_node(twin, channel) == name
        ):
            behind = "" if channel.lag is None else f", {channel.lag.evaluate(values):.3g} s behind"
            at = below + 0.12 + (0.36 if name in lost else 0.0) + NOTE_PITCH * place
            draw_note(ax, x - BOX / 2 + 0.05, at, f"{channel.name}{behind}")
    return top + 0.35 + (rows - 1) * ROW_PITCH + BOX_HEIGHT + 0.5


def _seen_node(twin: Twin, channel: Channel) -> str:
    """The node that counts most in a channel."""
    weights = channel.sensor.weights(twin.rig.plate)
    return max(weights, key=lambda name: weights[name])


def draw_links_on_plate(ax: Axes, twin: Twin, values: Mapping[str, float]) -> None:
    """Draws the links that the file gives between two elements of the plate, such as heat pipes.

    **Arguments:** those of `draw_bodies`.
    """
    plate = twin.rig.plate
    elements = set(plate.element_names)
    for link in twin.netlist.links:
        if link.role not in ("body", "convection", "radiation") or not elements.issuperset(
            (link.a, link.b)
        ):
            continue
        places = [100 * sum(plate.extent(end)[k] for k in (0, 1)) / 2 for end in (link.a, link.b)]
        heights = [100 * sum(plate.extent(end)[k] for k in (2, 3)) / 2 for end in (link.a, link.b)]
        ax.plot(
            places, heights, color=palette().purple, lw=2, ls=(0, (3, 1.5)), zorder=4,
            path_effects=outlined(2.0),
        )  # fmt: skip
        ax.annotate(
            f"{float(link.resistance(values)):.3g} K/W",
            (sum(places) / 2, sum(heights) / 2), (0, 5), textcoords="offset points", ha="center",
            va="bottom", color=INK, fontsize=points(7.5), zorder=6,
        )  # fmt: skip


# The directions of the stubs of an element's sensors, right and down, in lengths of a stub.
DIRECTIONS = ((-1.0, 1.0), (0.0, 1.0), (-1.0, 0.0))


def draw_sensors(ax: Axes, twin: Twin, values: Mapping[str, float]) -> None:
    """Draws a stub from each element to each sensor with a lag that touches it, with the lag.

    Sensors on bodies are named there: see `draw_bodies`.

    **Arguments:**

    - `ax`: axes whose unit is 1 cm, with the plate's top left corner at 0, 0.
    - `twin`: the twin with the channels. `values`: the values of its parameters, SI.
    """
    rig = twin.rig
    lags = {sensor_name(c.name): (c.name, c.lag) for c in rig.channels if c.lag is not None}
    drawn = dict.fromkeys(rig.plate.element_names, 0)
    for link in twin.netlist.links:
        if link.b not in lags or link.a not in drawn:
            continue
        channel, lag = lags[link.b]
        left, right, top, bottom = (100 * edge for edge in rig.plate.extent(link.a))
        x, y = (left + right) / 2, (top + bottom) / 2
        # The first stub points down to the left, where neither cells nor the air are drawn; the
        # second straight down, the third to the left.
        reach = 0.22 * min(right - left, bottom - top)
        right_by, down_by = DIRECTIONS[drawn[link.a] % len(DIRECTIONS)]
        drawn[link.a] += 1
        end = x + right_by * reach, y + down_by * reach
        ax.plot([x, end[0]], [y, end[1]], color=palette().green, lw=2, zorder=3,
                path_effects=outlined(2.0))  # fmt: skip
        ax.plot(*end, "s", color=palette().green, ms=6, mec=palette().ground, mew=1.2, zorder=5)
        ax.annotate(
            f"{channel}\n{float(lag.evaluate(values)):.3g} s", end, (0, -5),
            textcoords="offset points", ha="center", va="top", color=INK, fontsize=points(7.5),
            linespacing=1.1, zorder=6,
        )  # fmt: skip
