"""Draws the bodies beside plate and cells in the picture of a network, and the links between
elements."""

from collections.abc import Mapping
from dataclasses import replace

from matplotlib.axes import Axes

from .._celsius import ZERO_CELSIUS
from ..physics import Twin
from ..physics._sensors import sensor_name
from ..rig._plate import AMBIENT
from ._netlist_cells import ABOVE, draw_box, draw_note, heater_text, outlined
from ._netlist_layout import BOX, BOX_HEIGHT, NetlistLayout
from ._style import INK, palette, points

# The distance between two bodies, inches.
PITCH = 2.0

# The distance between two of the notes below a body, inches.
LINE = 0.17


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
    layout = replace(layout, columns=max(1, int(layout.width / (PITCH * layout.inch))))
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
                y += LINE * layout.inch
                note = f"{heater.name}, {heater_text(heater, values)}"
                draw_note(ax, x - (BOX / 2 - 0.1) * layout.inch, y, note)
        on_plate = placed.get(body.name, ())
        links = [link for link in twin.netlist.links if body.name in (link.a, link.b)]
        contacts = [link for link in links if link.b in on_plate]
        if contacts:
            y += LINE * layout.inch
            whole = 1 / sum(1 / link.resistance(values) for link in contacts)
            note = f"{float(whole):.3g} K/W to the plate"
            draw_note(ax, x - (BOX / 2 - 0.1) * layout.inch, y, note)
        for link in links:
            if link.b in on_plate:
                continue
            y += LINE * layout.inch
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
