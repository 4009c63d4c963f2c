"""The network of a rig as a picture: the plate at its true size, its cells below it."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps, pyplot
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from .._number_text import short_number
from ..errors import ParameterError
from ..physics import Twin, check_twin, network_counts, network_layout, network_text
from ..rig import AMBIENT, Plate
from ._netlist_parts import (
    COLUMN_PITCH,
    LEGEND_WIDTH,
    draw_bodies,
    draw_cells,
    draw_contacts,
    draw_links_on_plate,
    draw_network,
    draw_sensors,
    netlist_layout,
    outlined,
)
from ._style import INK, OF_FIXED_SIZE, palette, points, styled

_WIDEST = {"conduction": 6.0, "film": 4.5}  # line of the largest conductance of a kind, points
_THINNEST = 0.7


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
    figure = None
    if ax is None:
        figure = pyplot.figure(layout="constrained")
        ax = figure.subplots()
    ax.set_aspect("equal")
    ax.set_axis_off()
    ax.set_title(twin.rig.name, pad=19)
    ax.annotate(
        network_text(network_counts(twin.netlist, twin.rig)), (0, 1), (0, 6), color=palette().muted,
        xycoords="axes fraction", textcoords="offset points", fontsize=points(9),
    )  # fmt: skip

    plate = twin.rig.plate
    layout = netlist_layout(plate, len(twin.rig.cells))
    on_plate = shown[: len(plate.element_names)]
    colormap = ListedColormap(colormaps[colors](np.linspace(0.06, 0.62, 256)))
    scale = ScalarMappable(Normalize(*_limits(on_plate)), colormap)
    written = [text(value) for value in on_plate]
    longest = max(map(len, (*plate.element_names, *written)), default=0)
    narrow = (0.06 + 0.075 * longest) * layout.inch  # left of the links, which run in the middle
    for element, value, color in zip(
        plate.element_names, written, scale.to_rgba(on_plate), strict=True
    ):
        _draw_element(ax, plate, element, value, color, narrow)
    handles: list[Artist] = [*_draw_conduction(ax, twin, values), *_draw_air(ax, twin, values)]
    texts = {node.name: text(value) + unit for node, value in zip(nodes, shown, strict=True)}
    draw_contacts(ax, twin, values, layout)
    draw_sensors(ax, twin, values)
    draw_links_on_plate(ax, twin, values)
    if twin.rig.has_plate:
        lowest = draw_cells(ax, twin, values, texts, layout)
        lowest = draw_bodies(ax, twin, values, texts, layout, lowest)
    else:
        columns, _ = network_layout(twin.netlist).size
        layout = replace(layout, width=COLUMN_PITCH * columns)
        lowest = draw_network(ax, twin, values, texts, 0.0)
    margin = 0.1 * layout.inch
    ax.set_xlim(layout.left - margin, layout.left + layout.width + margin)
    ax.set_ylim(lowest + 1.5 * margin, -margin)
    if twin.rig.cells:
        handles.append(Line2D([], [], color=palette().vermilion, lw=2, label="cells and sinks"))
    if not on_plate.size:
        pass  # nothing is coloured
    elif _differ(on_plate):
        bar = ax.figure.colorbar(scale, ax=ax, shrink=0.5, aspect=24, pad=0.01)
        bar.set_label(label)
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    else:  # a scale would show nothing
        handles.append(Rectangle((0, 0), 1, 1, fc=scale.to_rgba(on_plate)[0], label=label))
    in_one_row = layout.width > 2 * LEGEND_WIDTH * layout.inch
    columns = len(handles) if in_one_row else 3
    if handles:
        ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=columns)
    if figure is not None:
        width, height = np.ptp(ax.get_xlim()) / layout.inch, np.ptp(ax.get_ylim()) / layout.inch
        beside = 1.0 if _differ(on_plate) else 0.2
        below = 0.65 if not handles else 0.85 if in_one_row else 1.05
        figure.set_size_inches(width + beside, height + below)
        figure.set_gid(OF_FIXED_SIZE)
    return ax


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


def _draw_element(ax: Axes, plate: Plate, element: str, value: str, color, narrow: float) -> None:
    left, right, top, bottom = (100 * edge for edge in plate.extent(element))
    ax.add_patch(
        Rectangle(
            (left, top), right - left, bottom - top, fc=color, ec=palette().ground, lw=1.5, zorder=1
        )
    )
    # The text stands beside the links, which run through the middle, and is rotated if the element
    # is too narrow.
    corner = {
        "textcoords": "offset points",
        "va": "top",
        "color": INK,  # elements are light in every style
        "fontsize": points(7.5),
        "zorder": 6,
    }
    if (right - left) / 2 > narrow:
        ax.annotate(element, (left, top), (3, -3), fontweight="bold", **corner)
        ax.annotate(value, (left, top), (3, -13), **corner)
    else:
        text = rf"$\bf{{{element.replace('_', chr(92) + '_')}}}$  {value}"
        ax.annotate(text, (left, top), (1.5, -3), rotation=90, **corner)


def _draw_conduction(ax: Axes, twin: Twin, values: Mapping[str, float]) -> list[Line2D]:
    links = {
        (link.a, link.b): 1 / link.resistance(values)
        for link in twin.netlist.links
        if link.role == "conduction"
    }
    for (a, b), width in zip(links, _widths(list(links.values()), "conduction"), strict=True):
        (x0, y0), (x1, y1) = _centre(twin.rig.plate, a), _centre(twin.rig.plate, b)
        ax.plot([x0, x1], [y0, y1], color=palette().ink, lw=width, solid_capstyle="butt", zorder=2)
    for element in twin.rig.plate.element_names:
        ax.plot(
            *_centre(twin.rig.plate, element),
            "o",
            color=palette().ink,
            ms=5,
            mec=palette().ground,
            mew=1,
            zorder=5,
        )
    return _legend_lines(list(links.values()), "conduction", "conduction", palette().ink)


def _draw_air(ax: Axes, twin: Twin, values: Mapping[str, float]) -> list[Line2D]:
    plate = twin.rig.plate
    conductances = dict.fromkeys(plate.element_names, 0.0)
    for link in twin.netlist.links:
        if link.b == AMBIENT and link.a in conductances:
            conductances[link.a] += 1 / link.resistance(values)
    for element, width in zip(
        plate.element_names, _widths(list(conductances.values()), "film"), strict=True
    ):
        if conductances[element] == 0:
            continue
        left, right, top, bottom = (100 * edge for edge in plate.extent(element))
        x, y = _centre(plate, element)
        reach = 0.22 * min(right - left, bottom - top)
        ax.plot(
            [x, x + reach], [y, y + reach], color=palette().blue, lw=width, solid_capstyle="butt",
            zorder=3,
            path_effects=outlined(width),
        )  # fmt: skip
        ax.plot(
            x + reach,
            y + reach,
            "o",
            mfc=palette().ground,
            mec=palette().blue,
            mew=1.3,
            ms=5.5,
            zorder=4,
        )
    return _legend_lines(list(conductances.values()), "film", "to the air", palette().blue)


def _widths(conductances: list[float], role: str) -> list[float]:
    most = max(conductances, default=0.0)
    return [max(_THINNEST, _WIDEST[role] * value / most) if most else 0.0 for value in conductances]


def _legend_lines(conductances: list[float], role: str, label: str, color: str) -> list[Line2D]:
    """The largest conductance, and a quarter of it."""
    most = max(conductances, default=0.0)
    return [
        Line2D(
            [], [], color=color, lw=_WIDEST[role] * part, label=f"{label}, {most * part:.2g} W/K"
        )
        for part in (1.0, 0.25)
        if most > 0
    ]


def _centre(plate: Plate, element: str) -> tuple[float, float]:
    left, right, top, bottom = plate.extent(element)
    return 50 * (left + right), 50 * (top + bottom)
