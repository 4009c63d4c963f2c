"""The plate as a map of temperatures at several times, Figs. 5 and 13b of the paper."""

from collections.abc import Sequence
from typing import overload

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps, pyplot
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Polygon, Rectangle
from matplotlib.patheffects import withStroke

from ..errors import ParameterError
from ..rig import Cell, Channel, Heater, Plate, Rig
from ..rig._plate_needed import check_has_plate
from ._style import INK, PALE, palette, points, styled

_MAP_WIDTH, _ROOM_ABOVE = 4.3, 0.42  # width of a panel and room above it, inches

# The colours of temperatures. The coldest is a dark violet, because black shows no differences.
HEAT = ListedColormap(colormaps["inferno"](np.linspace(0.18, 1.0, 256)))


@overload
def plot_plate_map(
    rig: Rig,
    temperatures: Float[np.ndarray, "maps elements"],
    titles: Sequence[str],
    *,
    columns: int = 2,
    ax: None = None,
) -> Figure: ...


@overload
def plot_plate_map(
    rig: Rig,
    temperatures: Float[np.ndarray, "maps elements"],
    titles: Sequence[str],
    *,
    ax: Axes,
) -> Axes: ...


@styled
def plot_plate_map(
    rig: Rig,
    temperatures: Float[np.ndarray, "maps elements"],
    titles: Sequence[str],
    *,
    columns: int = 2,
    ax: Axes | None = None,
) -> Figure | Axes:
    """Plots temperatures over the plate, a panel for each time, and a panel that names the
    channels.

    Every element is drawn at its true size in one colour, because the twin has one temperature for
    it. A dashed line surrounds the elements that a cell touches.

    **Arguments:**

    - `rig`: the rig, whose plate, cells and channels are drawn.
    - `temperatures`: the temperatures of the plate elements, degC, in the order of
      `rig.plate.element_names`: `run.states[[100, 300, 500], :elements]`, for example.
    - `titles`: the titles of the maps, such as `"100 s"`.
    - `columns`: the number of columns of the figure.
    - `ax`: axes to draw a single map into, without the panel that names the channels; None for a
      new figure.

    **Returns:** the figure; or the axes, if they are given.

    **Raises:** `ParameterError` if there is not one temperature for each element and one title
    for each map, or if several maps are to go into given axes.
    """
    check_has_plate("plot_plate_map", rig, ParameterError)
    shape = (len(titles), len(rig.plate.element_names))
    if np.shape(temperatures) != shape:
        raise ParameterError(
            f"temperatures: expected shape {shape} for {shape[0]} titles and the elements of "
            f"{rig.name}, got {np.shape(temperatures)}"
        )
    norm = Normalize(float(np.min(temperatures)), float(np.max(temperatures)))
    scale = ScalarMappable(norm, HEAT)
    if ax is not None:
        if len(titles) != 1:
            raise ParameterError(
                f"ax: expected a single map to draw into given axes, got {len(titles)}; draw each "
                "into its own, or leave ax out"
            )
        ax.set_axis_off()
        draw_map(ax, rig, titles[0], np.asarray(temperatures)[0], scale)
        draw_scale(ax.figure, scale, ax, 20)
        return ax
    panels = len(titles) + 1
    rows = -(-panels // columns)
    height = _ROOM_ABOVE + _MAP_WIDTH * rig.plate.height / rig.plate.width
    figure = pyplot.figure(figsize=(_MAP_WIDTH * columns + 1, height * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for axes, title, values in zip(grid.flat, titles, temperatures, strict=False):
        draw_map(axes, rig, title, values, scale)
    _draw_channels(grid.flat[panels - 1], rig)
    draw_scale(figure, scale, grid, 28)
    return figure


def draw_scale(
    figure: Figure | SubFigure, scale: ScalarMappable, beside: Axes | np.ndarray, aspect: int
) -> None:
    """Draws the bar of the colours of temperatures beside some axes."""
    bar = figure.colorbar(scale, ax=beside, shrink=0.7, aspect=aspect, pad=0.02)
    bar.set_label("temperature, °C")
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]


def draw_map(
    axes: Axes, rig: Rig, title: str, values: Float[np.ndarray, " elements"], scale: ScalarMappable
) -> None:
    """Draws temperatures over the plate, with its cells, and their range beside the title."""
    frame(axes, rig.plate)
    for element, color in zip(rig.plate.element_names, scale.to_rgba(values), strict=True):
        # A rim of the same colour covers the thin gap between neighbours.
        axes.add_patch(rectangle(rig.plate.extent(element), fc=color, ec=color, lw=0.3))
    draw_cells(axes, rig)
    axes.set_title(title)
    axes.set_title(
        f"{values.min():.1f} … {values.max():.1f} °C",
        loc="right", fontsize=points(9), fontweight="normal", color=palette().muted,
    )  # fmt: skip


def draw_cells(axes: Axes, rig: Rig) -> None:
    """Draws a dashed line around each cell, where the rig file places it or around the elements
    that it touches, and its name; likewise heaters that are placed."""
    for cell in _drawn(rig):
        rim = [withStroke(linewidth=2.6, foreground=INK, alpha=0.7)]
        look = {"fc": "none", "ec": PALE, "lw": 1.2, "ls": (0, (4, 2)), "path_effects": rim}
        _draw_cell(axes, rig, cell, PALE, INK, **look)


def _draw_channels(axes: Axes, rig: Rig) -> None:
    frame(axes, rig.plate)
    extents = [(0.0, rig.plate.width, 0.0, rig.plate.height)]
    axes.add_patch(rectangle(extents[0], fc=palette().faint, ec=palette().muted, lw=1))
    for channel in rig.channels:
        for place in channel.sensor.outline(rig.plate):
            axes.add_patch(rectangle(place, fc="none", ec=palette().blue, lw=1.2))
    for cell in _drawn(rig):
        look = {"fc": palette().vermilion, "alpha": 0.25, "lw": 0}
        _draw_cell(axes, rig, cell, palette().vermilion, palette().faint, **look)
    for channel in rig.channels:
        if channel.sensor.outline(rig.plate):
            _name_channel(axes, rig.plate, channel)
    axes.set_title("channels and cells")


def _name_channel(axes: Axes, plate: Plate, channel: Channel) -> None:
    """Writes the name of a channel in its middle, rotated if the channel is narrow, or below it if
    it is small in both directions."""
    extents = np.array(channel.sensor.outline(plate))
    x, y = extents[:, :2].mean(), extents[:, 2:].mean()
    narrow = np.ptp(extents[:, :2]) < 0.07 * plate.width
    low = np.ptp(extents[:, 2:]) < 0.07 * plate.width
    axes.annotate(
        channel.name, (100 * x, 100 * y), (0, -11 if narrow and low else 0),
        textcoords="offset points", ha="center", va="center", fontsize=points(7.5),
        color=palette().ink,
        rotation=90 if narrow and not low else 0,
        path_effects=[withStroke(linewidth=2.5, foreground=palette().faint)],
    )  # fmt: skip


def frame(axes: Axes, plate: Plate) -> None:
    """Sets the axes to cm with the plate's proportions, y from the top."""
    axes.set_aspect("equal")
    axes.set_xlim(-0.3, 100 * plate.width + 0.3)
    axes.set_ylim(100 * plate.height + 0.3, -0.3)


def _drawn(rig: Rig) -> tuple[Cell | Heater, ...]:
    return (*rig.cells, *(heater for heater in rig.heaters if heater.placement is not None))


def _draw_cell(axes: Axes, rig: Rig, cell: Cell | Heater, color: str, rim: str, **look) -> None:
    """Draws the outline of a cell, at its place by the rig's values or around the elements that it
    touches, and its name in the lower left corner."""
    if cell.placement is None:
        assert isinstance(cell, Cell)
        extents = np.array([rig.plate.extent(element) for element, _ in cell.contacts])
        left, right = extents[:, 0].min(), extents[:, 1].max()
        top, bottom = extents[:, 2].min(), extents[:, 3].max()
        axes.add_patch(rectangle((left, right, top, bottom), **look))
        corner = (100 * left, 100 * bottom)
    else:
        values = {name: row.to_si(row.value) for name, row in rig.parameters.items()}
        corners = 100 * cell.placement.outline(values)
        axes.add_patch(Polygon(corners, **look))
        corner = corners[(corners[:, 1] - corners[:, 0]).argmax()]
    axes.annotate(
        cell.name, corner, (4, 4), textcoords="offset points",
        fontsize=points(8),
        color=color, fontweight="bold", path_effects=[withStroke(linewidth=2.2, foreground=rim)],
    )  # fmt: skip


def rectangle(extent: tuple[float, float, float, float], **look) -> Rectangle:
    """A rectangle given in m on axes in cm."""
    left, right, top, bottom = (100 * edge for edge in extent)
    return Rectangle((left, top), right - left, bottom - top, **look)
