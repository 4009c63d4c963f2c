"""What stands behind the plate in the picture of a network: cells, sinks, surroundings."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch
from matplotlib.patheffects import AbstractPathEffect, withStroke

from ..physics import ThermoelectricElement, Twin
from ..rig import AMBIENT
from ._labels import spread
from ._style import BLUE, INK, MUTED, VERMILION

_BOX_WIDTH, _BOX_HEIGHT, _GAP, _BELOW = 3.4, 1.05, 0.75, 1.25  # on a plate of the paper's size, cm


def draw_cells(ax: Axes, twin: Twin, values: Mapping[str, float], texts: Mapping[str, str]) -> None:
    """Draws each cell as a column of boxes below the plate, and sets the limits of the axes.

    **Arguments:**

    - `ax`: its unit is 1 cm, the plate's top left corner is at 0, 0.
    - `twin`: has the cells.
    - `values`: of its parameters, SI.
    - `texts`: what is written into the box of each node.
    """
    plate = twin.rig.plate
    unit = max(100 * plate.width / 25.5, 100 * plate.height / 11.5)
    wires = [_contacts(twin, cell, values) for cell in twin.netlist.cells]
    wanted = np.array([np.mean([x for x, _, _ in wire]) for wire in wires])
    bottom = 100 * plate.height
    lowest = bottom
    centres = spread(wanted, 2 * _BOX_WIDTH * unit)
    for cell, x, wire in zip(twin.netlist.cells, centres, wires, strict=True):
        top = bottom + _BELOW * unit
        _draw_contacts(ax, wire, bottom, float(x), top, unit)
        end = _draw_column(ax, twin, cell, values, texts, float(x), top, unit)
        lowest = max(lowest, end)
    margin, half = 0.3 * unit, _BOX_WIDTH / 2 * unit
    left = min(0.0, centres.min() - half - 1.8 * unit)  # where the cells' names stand
    right = max(100 * plate.width, centres.max() + half)
    ax.set_xlim(left - margin, right + margin)
    ax.set_ylim(lowest + 0.4 * unit, -margin)


def outlined(width: float) -> list[AbstractPathEffect]:
    """A white rim for a line of this width, over colours that it could be lost on."""
    return [withStroke(linewidth=width + 1.6, foreground="white", alpha=0.75)]


def _contacts(
    twin: Twin, cell: ThermoelectricElement, values: Mapping[str, float]
) -> list[tuple[float, float, float]]:
    """Where each contact of a cell begins (cm), right of the element's own links, and its K/W."""
    links = [link for link in twin.netlist.links if link.b == cell.cold and link.role == "contact"]
    step = min(0.14, 0.5 / len(links))
    begins = []
    for number, link in enumerate(links):
        left, right, top, bottom = twin.rig.plate.extent(link.a)
        aside = 0.72 + step * (number - (len(links) - 1) / 2)
        x = (left + right) / 2 + aside * (right - left) / 2
        begins.append((100 * x, 50 * (top + bottom), float(link.resistance(values))))
    return begins


def _draw_contacts(
    ax: Axes,
    wire: list[tuple[float, float, float]],
    plate_bottom: float,
    x: float,
    top: float,
    unit: float,
) -> None:
    for number, (begin, y, _) in enumerate(wire):
        end = x + 0.28 * unit * (number - (len(wire) - 1) / 2)
        bend = plate_bottom + 0.35 * unit
        ax.plot(
            [begin, begin, end, end], [y, bend, bend + 0.3 * unit, top],
            color=VERMILION, lw=2, zorder=4, path_effects=outlined(2.0),
        )  # fmt: skip
        ax.plot(begin, y, "o", color=VERMILION, ms=6, mec="white", mew=1.2, zorder=5)
    resistances = ", ".join(f"{resistance:.3g}" for _, _, resistance in wire)
    beside = x + 0.28 * unit * (len(wire) - 1) / 2 + 0.25 * unit
    _note(ax, beside, top - 0.4 * unit, f"{resistances} K/W")


def _draw_column(
    ax: Axes,
    twin: Twin,
    cell: ThermoelectricElement,
    values: Mapping[str, float],
    texts: Mapping[str, str],
    x: float,
    top: float,
    unit: float,
) -> float:
    """From the plate side down to the surroundings; returns where it ends, cm."""
    kinds = {cell.cold: "plate side", cell.hot: "far side"}
    alpha = cell.seebeck_coefficient.evaluate(values)
    R_E = cell.electrical_resistance.evaluate(values)
    beside = (x - (_BOX_WIDTH / 2 + 0.3) * unit, top + _BOX_HEIGHT / 2 * unit)
    look: dict[str, Any] = {"textcoords": "offset points", "ha": "right", "va": "center"}
    ax.annotate(cell.name, beside, (0, 6), fontsize=11, fontweight="bold", color=VERMILION, **look)
    ax.annotate(f"{alpha:.3g} V/K", beside, (0, -8), fontsize=8, color=MUTED, **look)
    ax.annotate(f"{R_E:.3g} Ω", beside, (0, -19), fontsize=8, color=MUTED, **look)
    node, y = cell.cold, top
    while node != AMBIENT:
        _box(ax, x, y, unit, node, f"{kinds.get(node, 'sink')}, {texts[node]}")
        link = next(link for link in twin.netlist.links if link.a == node)
        below = y + (_BOX_HEIGHT + _GAP) * unit
        ax.plot([x, x], [y + _BOX_HEIGHT * unit, below], color=VERMILION, lw=2, zorder=2)
        resistance = f"{float(link.resistance(values)):.3g} K/W"
        _note(ax, x + 0.25 * unit, y + (_BOX_HEIGHT + _GAP / 2) * unit, resistance)
        node, y = link.b, below
    ax.plot(x, y, "o", mfc="white", mec=BLUE, mew=1.6, ms=8, zorder=4)
    ambient = twin.rig.ambient_temperature.evaluate(values) - 273.15
    _note(ax, x + 0.4 * unit, y, f"air, {ambient:.3g} °C")
    return y


def _box(ax: Axes, x: float, y: float, unit: float, name: str, text: str) -> None:
    corner, rounding = (x - _BOX_WIDTH / 2 * unit, y), 0.15 * unit
    style = f"round,pad=0,rounding_size={rounding}"
    look = {"boxstyle": style, "fc": "white", "ec": VERMILION, "lw": 1.3, "zorder": 3}
    ax.add_patch(FancyBboxPatch(corner, _BOX_WIDTH * unit, _BOX_HEIGHT * unit, **look))
    middle = y + _BOX_HEIGHT / 2 * unit
    look = {"textcoords": "offset points", "ha": "center", "va": "center", "zorder": 4}
    ax.annotate(name, (x, middle), (0, 5.5), fontsize=8.5, fontweight="bold", color=INK, **look)
    ax.annotate(text, (x, middle), (0, -5.5), fontsize=8.5, color=INK, **look)


def _note(ax: Axes, x: float, y: float, text: str) -> None:
    ax.annotate(text, (x, y), ha="left", va="center", fontsize=8, color=MUTED, zorder=4)
