"""The network of a rig as a picture: the plate at its true size, its cells below it."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.patches import Polygon, Rectangle

from .._number_text import short_number
from ..errors import ParameterError
from ..physics import Twin, check_twin, network_counts, network_layout, network_text
from ..rig import AMBIENT, Plate
from ._netlist_parts import (
    COLUMN_PITCH,
    LEGEND_WIDTH,
    Picture,
    draw_bodies,
    draw_cells,
    draw_dot,
    draw_network,
    draw_ring,
    netlist_layout,
)
from ._panels import axes_or_new, color_bar, write
from ._plate_map import rectangle
from ._style import INK, OF_FIXED_SIZE, palette, rim, styled

_WIDEST_CONDUCTION, _WIDEST_FILM, _THINNEST = 6.0, 4.5, 0.7
"""The widths of the lines of the largest conductances, and of the thinnest line, points."""


@styled
def plot_netlist(
    twin: Twin, temperatures: Float[np.ndarray, " nodes"] | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plots the twin's thermal network, Figs. 8 and 13a of the paper.

    Plate elements are drawn at their true size. Lines between their centres are links, and a stub
    with a ring at its end stands for all links from an element to the air. The width of both is
    proportional to the conductance, each on a separate scale that the legend shows. A stub with a
    dot and a cell's name is the contact of that cell; a stub with a square and a channel's name is
    a sensor with a lag. The nodes behind each cell, with the resistances between them, and the
    bodies with their links are drawn below the plate. A rig without a plate is drawn as its nodes
    with lines between them.

    **Arguments:**

    - `twin`: a twin with one value for each parameter.
    - `temperatures`: the temperatures of all nodes, degC, in the order of `twin.netlist.nodes`: a
      row of `run.states`, for example. They colour the plate. With None the heat capacities of the
      elements colour it.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.

    **Raises:** `ParameterError` if something else than a twin is given, or not one temperature
    for each node, or not one value for each parameter.
    """
    check_twin("plot_netlist: twin", twin, ParameterError)
    values = twin.numbers_si
    nodes = twin.netlist.nodes
    if temperatures is None:
        shown = np.array([node.capacitance.evaluate(values) for node in nodes])
        colors, label, text, unit = "Greens", "heat capacity, J/K", _capacity, " J/K"
    else:
        shown, unit = temperatures, " °C"
        colors, label, text = "YlOrRd", "temperature, °C", "{:.1f}".format
    if np.shape(shown) != (len(nodes),):
        raise ParameterError(
            f"temperatures: expected one for each of the {len(nodes)} nodes of {twin.rig.name}, "
            f"got shape {np.shape(shown)}"
        )
    axes = axes_or_new(ax, 6.4, 4.8)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(twin.rig.name, pad=19)
    counts = network_text(network_counts(twin.netlist, twin.rig))
    write(axes, counts, (0, 1), (0, 6), xycoords="axes fraction")
    plate = twin.rig.plate
    layout = netlist_layout(plate, len(twin.rig.cells))
    if not twin.rig.has_plate:
        layout = replace(layout, width=COLUMN_PITCH * network_layout(twin.netlist).size[0])
    texts = {node.name: text(value) + unit for node, value in zip(nodes, shown, strict=True)}
    picture = Picture(axes, twin, values, texts, layout)
    on_plate = shown[: len(plate.element_names)]
    colormap = ListedColormap(colormaps[colors](np.linspace(0.06, 0.62, 256)))
    scale = ScalarMappable(Normalize(*_limits(on_plate)), colormap)
    _draw_elements(picture, scale.to_rgba(on_plate), [text(value) for value in on_plate])
    _draw_conduction(picture)
    _draw_air(picture)
    _draw_contacts(picture)
    _draw_sensors(picture)
    _draw_links_on_plate(picture)
    if twin.rig.has_plate:
        lowest = draw_bodies(picture, draw_cells(picture))
    else:
        lowest = draw_network(picture)
    margin = 0.1 * layout.inch
    axes.set_xlim(layout.left - margin, layout.left + layout.width + margin)
    axes.set_ylim(lowest + 1.5 * margin, -margin)
    if twin.rig.cells:
        axes.plot([], [], color=palette().vermilion, lw=2, label="cells and sinks")
    if _differ(on_plate):
        color_bar(axes, scale, label, shrink=0.5, aspect=24, pad=0.01)
    handles, _ = axes.get_legend_handles_labels()
    if on_plate.size and not _differ(on_plate):  # a scale would show nothing
        handles.append(Rectangle((0, 0), 1, 1, fc=scale.to_rgba(on_plate)[0], label=label))
    in_one_row = layout.width > 2 * LEGEND_WIDTH * layout.inch
    if handles:
        columns = len(handles) if in_one_row else 3
        below_all = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0)}
        axes.legend(handles=handles, ncols=columns, **below_all)
    if ax is None:
        figure = axes.get_figure(root=True)
        assert figure is not None
        width, height = np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())
        beside = 1.0 if _differ(on_plate) else 0.2
        below = 0.65 if not handles else 0.85 if in_one_row else 1.05
        figure.set_size_inches(width / layout.inch + beside, height / layout.inch + below)
        figure.set_gid(OF_FIXED_SIZE)
    return axes


def _capacity(value: float) -> str:
    return short_number(float(value), 3)


def _differ(values: Float[np.ndarray, " elements"]) -> bool:
    return values.size > 0 and bool(np.ptp(values) > 1e-9 * abs(values.max()))


def _limits(values: Float[np.ndarray, " elements"]) -> tuple[float, float]:
    """The lowest and the highest value, widened if all are equal."""
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    return (low, high) if _differ(values) else (0.9 * low - 0.1, 1.1 * high + 0.1)


def _draw_elements(picture: Picture, colors: np.ndarray, texts: list[str]) -> None:
    """Draws the elements with their names and a number. Both stand beside the links, which run
    through the middle, and are rotated if the element is too narrow."""
    ax, plate = picture.ax, picture.twin.rig.plate
    longest = max(map(len, (*plate.element_names, *texts)), default=0)
    narrow = (0.06 + 0.075 * longest) * picture.layout.inch
    # Elements are light in every style.
    letters = {"size": 7.5, "va": "top", "color": INK, "zorder": 6}
    for element, text, color in zip(plate.element_names, texts, colors, strict=True):
        left, right, top, _ = _extent_cm(plate, element)
        corner = (left, top)
        look = {"fc": color, "ec": palette().ground, "lw": 1.5, "zorder": 1}
        ax.add_patch(rectangle(plate.extent(element), **look))
        if (right - left) / 2 > narrow:
            write(ax, element, corner, (3, -3), fontweight="bold", **letters)
            write(ax, text, corner, (3, -13), **letters)
        else:
            name = element.replace("_", r"\_")
            write(ax, rf"$\bf{{{name}}}$  {text}", corner, (1.5, -3), rotation=90, **letters)


def _draw_conduction(picture: Picture) -> None:
    """Draws the links between elements, which the largest conductance makes the widest."""
    ax, twin, color = picture.ax, picture.twin, palette().ink
    plate = twin.rig.plate
    links = {
        (link.a, link.b): 1 / link.resistance(picture.values)
        for link in twin.netlist.links
        if link.role == "conduction"
    }
    widths = _widths(ax, list(links.values()), _WIDEST_CONDUCTION, "conduction", color)
    for (a, b), width in zip(links, widths, strict=True):
        (x1, y1), (x2, y2) = _centre(plate, a), _centre(plate, b)
        ax.plot([x1, x2], [y1, y2], color=color, lw=width, solid_capstyle="butt", zorder=2)
    for element in plate.element_names:
        ground = palette().ground
        ax.plot(*_centre(plate, element), "o", color=color, ms=5, mec=ground, mew=1, zorder=5)


def _draw_air(picture: Picture) -> None:
    """Draws a stub from each element to the air."""
    color = palette().blue
    conductances = dict.fromkeys(picture.twin.rig.plate.element_names, 0.0)
    for link in picture.twin.netlist.links:
        if link.b == AMBIENT and link.a in conductances:
            conductances[link.a] += 1 / link.resistance(picture.values)
    widths = _widths(picture.ax, list(conductances.values()), _WIDEST_FILM, "to the air", color)
    for element, width in zip(conductances, widths, strict=True):
        if conductances[element] > 0:
            end = _draw_stub(picture, element, 1, 1, color, width)
            draw_ring(picture.ax, end, 5.5)


def _widths(
    ax: Axes, conductances: list[float], widest: float, label: str, color: str
) -> list[float]:
    """The widths of the lines of some conductances, of which the largest and a quarter of it are in
    the legend."""
    most = max(conductances, default=0.0)
    if most == 0:
        return [0.0] * len(conductances)
    for part in (1.0, 0.25):
        text = f"{label}, {most * part:.2g} W/K"
        ax.plot([], [], color=color, lw=widest * part, label=text)
    return [max(_THINNEST, widest * value / most) for value in conductances]


# The length of a stub, as a part of the smaller side of its element.
STUB = 0.22


def _draw_stub(
    picture: Picture,
    element: str,
    right: float | int,
    down: float | int,
    color: str,
    width: float = 2.0,
) -> tuple[float, float]:
    """Draws a line from the middle of an element that ends within it, and returns the end.

    A stub ends with a name, like a net in a circuit diagram, because wires across the plate could
    not be distinguished.

    **Arguments:**

    - `right`, `down`: the direction of the stub, in lengths of a stub.
    """
    plate = picture.twin.rig.plate
    x, y = _centre(plate, element)
    left_edge, right_edge, top, bottom = _extent_cm(plate, element)
    reach = STUB * min(right_edge - left_edge, bottom - top)
    end = x + right * reach, y + down * reach
    look = {"zorder": 3, "solid_capstyle": "butt", "path_effects": rim(width=width + 1.6)}
    picture.ax.plot([x, end[0]], [y, end[1]], color=color, lw=width, **look)
    return end


def _draw_contacts(picture: Picture) -> None:
    """Draws a stub from each element to each cell that touches it, with the contact's K/W, and to
    each heater whose heat goes into it, with its power or resistance. A cell or heater that the rig
    file places is drawn as it lies on the plate."""
    ax, twin, color = picture.ax, picture.twin, palette().vermilion
    bold = {"ha": "center", "va": "center", "fontweight": "bold", "path_effects": rim()}
    for placement in twin.rig.placements:
        corners = 100 * placement.outline(picture.values)
        ax.add_patch(Polygon(corners, fc=color, ec=color, alpha=0.25, lw=2, zorder=2.5))
        middle = tuple(corners.mean(axis=0))
        write(ax, placement.name, middle, size=11, color=INK, zorder=7, **bold)
    drawn = dict.fromkeys(twin.rig.plate.element_names, 0)
    for element, name, text in _contacts(picture):
        if element not in drawn:
            continue
        # A second cell at the same element stands to the left of the first.
        end = _draw_stub(picture, element, 1 - 2 * drawn[element], -1, color)
        drawn[element] += 1
        draw_dot(ax, end, color)
        left, right, _, _ = _extent_cm(twin.rig.plate, element)
        is_upright = right - left < 0.6 * picture.layout.inch
        gap = "  " if is_upright else "\n"
        _name_stub(ax, f"{name}{gap}{text}", end, rotation=90 if is_upright else 0)


def _contacts(picture: Picture) -> Iterator[tuple[str, str, str]]:
    """Each element that a cell or heater touches, the name of the cell, and a number about it."""
    placed = {placement.name for placement in picture.twin.rig.placements}
    for cell in picture.twin.netlist.cells:
        if cell.name in placed:
            continue
        for link in picture.twin.netlist.links:
            if link.role == "contact" and link.b == cell.cold:
                yield link.a, cell.name, picture.resistance(link)
        if cell.is_heater:
            yield cell.cold, cell.name, picture.heater(cell)


def _name_stub(
    ax: Axes, text: str, end: tuple[float, float], *, is_below: bool = False, rotation: int = 0
) -> None:
    """Writes the name and the number of what a stub leads to above its end, or below."""
    shift, va = ((0, -5), "top") if is_below else ((0, 5), "bottom")
    look = {"size": 7.5, "color": INK, "linespacing": 1.1, "zorder": 6}
    write(ax, text, end, shift, ha="center", va=va, rotation=rotation, **look)


# The directions of the stubs of an element's sensors, right and down: the first points down to the
# left, where neither cells nor the air are drawn; the second straight down, the third to the left.
DIRECTIONS = ((-1.0, 1.0), (0.0, 1.0), (-1.0, 0.0))


def _draw_sensors(picture: Picture) -> None:
    """Draws a stub from each element to each sensor with a lag that touches it, with the lag.
    Sensors on bodies are named there: see `draw_bodies`."""
    drawn = dict.fromkeys(picture.twin.rig.plate.element_names, 0)
    lags = picture.lags()
    for link in picture.twin.netlist.links:
        if link.b not in lags or link.a not in drawn:
            continue
        right, down = DIRECTIONS[drawn[link.a] % len(DIRECTIONS)]
        drawn[link.a] += 1
        end = _draw_stub(picture, link.a, right, down, palette().green)
        draw_dot(picture.ax, end, palette().green, "s")
        text = f"{link.b.removesuffix('.SENSOR')}\n{lags[link.b]:.3g} s"
        _name_stub(picture.ax, text, end, is_below=True)


def _draw_links_on_plate(picture: Picture) -> None:
    """Draws the links that the file gives between two elements of the plate, such as heat pipes."""
    plate = picture.twin.rig.plate
    elements = set(plate.element_names)
    for link in picture.twin.netlist.links:
        is_given = link.role in ("body", "convection", "radiation")
        if not is_given or not elements.issuperset((link.a, link.b)):
            continue
        (x1, y1), (x2, y2) = _centre(plate, link.a), _centre(plate, link.b)
        look = {"ls": (0, (3, 1.5)), "zorder": 4, "path_effects": rim()}
        picture.ax.plot([x1, x2], [y1, y2], color=palette().purple, lw=2, **look)
        _name_stub(picture.ax, picture.resistance(link), ((x1 + x2) / 2, (y1 + y2) / 2))


def _extent_cm(plate: Plate, element: str) -> tuple[float, float, float, float]:
    """The left, right, top and bottom edge of an element, cm."""
    left, right, top, bottom = plate.extent(element)
    return 100 * left, 100 * right, 100 * top, 100 * bottom


def _centre(plate: Plate, element: str) -> tuple[float, float]:
    """The centre of an element, cm."""
    left, right, top, bottom = _extent_cm(plate, element)
    return (left + right) / 2, (top + bottom) / 2
