"""The plate as a map of temperatures: at several times (Figs. 5 and 13b of the paper), in several
runs, beside what the channels see, and before and after a design of its rig.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, overload

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps, pyplot
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Polygon, Rectangle
from matplotlib.patheffects import withStroke

from ..control import ClosedLoopRun, OperatingPoint, PlacedCells, RigDesign
from ..errors import ControlError, ParameterError
from ..rig import Cell, Channel, Heater, Plate, Rig, check_has_plate
from ..simulation import Run
from ._panels import title_aside
from ._style import INK, PALE, palette, points, styled

if TYPE_CHECKING:
    from ..control import ClosedLoopRun


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
    title_aside(axes, f"{values.min():.1f} … {values.max():.1f} °C")


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


WIDTH, ROOM_ABOVE = 3.7, 0.3
"""Width of a map and room above it, inches."""


@styled
def plot_plates(
    rig: Rig, runs: "Mapping[str, Run | ClosedLoopRun]", times: Sequence[float | int]
) -> Figure:
    """Plots the plate at several times, a column for each run, such as the loops of several
    controllers, and a row for each time. All maps have one scale.

    **Arguments:**

    - `rig`: the rig, whose plate and cells are drawn.
    - `runs`: name -> run of a twin of this rig (`Twin.simulate`), or of a closed loop.
    - `times`: the times of the rows, s; the nearest sample is shown.

    **Returns:** the figure.

    **Raises:** `ParameterError` if there is no run, one is of another rig, or a time lies outside
    of one.
    """
    where = "plot_plates"
    simulated = runs_of_plate(where, rig, runs)
    if not len(times):
        raise ParameterError(f"{where}: times: expected at least one, got none")
    count = len(rig.plate.element_names)
    maps = []
    for time in times:
        for name, run in simulated.items():
            if not run.time[0] <= time <= run.time[-1]:
                raise ParameterError(
                    f"{where}: times: expected {run.time[0]:g} to {run.time[-1]:g} s, the time of "
                    f"{name}, got {time!r} s"
                )
            maps.append(run.states[int(np.abs(run.time - time).argmin()), :count])
    scale = ScalarMappable(Normalize(float(np.min(maps)), float(np.max(maps))), HEAT)
    height = ROOM_ABOVE + WIDTH * rig.plate.height / rig.plate.width
    figure = pyplot.figure(
        figsize=(WIDTH * len(simulated) + 1, height * len(times) + 0.3), layout="constrained"
    )
    grid = figure.subplots(len(times), len(simulated), squeeze=False)
    for axes, values in zip(grid.flat, maps, strict=True):
        draw_map(axes, rig, "", values, scale)
        look = {"fontsize": points(9), "fontweight": "normal", "color": palette().muted}
        axes.set_title(f"range {np.ptp(values):.1f} K", loc="right", **look)
        axes.set(xticks=[], yticks=[])
        axes.grid(visible=False)
        axes.spines[:].set_visible(False)
    for axes, name in zip(grid[0], simulated, strict=True):
        axes.set_title(name, loc="left")
    for axes, time in zip(grid[:, 0], times, strict=True):
        axes.set_ylabel(f"{time:g} s", color=palette().ink)
    draw_scale(figure, scale, grid, 24)
    return figure


def runs_of_plate(
    where: str, rig: Rig, runs: "Mapping[str, Run | ClosedLoopRun]"
) -> dict[str, Run]:
    """The runs of a rig with a plate by name, those of closed loops among them.

    **Raises:** `ParameterError` if there is none, or one is of another rig.
    """
    check_has_plate(where, rig, ParameterError)
    if not runs:
        raise ParameterError(f"{where}: runs: expected at least one, got none")
    elements = tuple(rig.plate.element_names)
    simulated = {name: run if isinstance(run, Run) else run.run for name, run in runs.items()}
    for run in simulated.values():
        if tuple(run.nodes[: len(elements)]) != elements:
            raise ParameterError(
                f"{where}: expected a run of {rig.name}, got one of {run.rig} with other plate "
                "elements"
            )
    return simulated


@styled
def plot_plate_seen(rig: Rig, at: ClosedLoopRun | OperatingPoint) -> Figure:
    """Plots the temperatures of the elements, with the hottest and the coldest of them, and beside
    them the readings of the channels, each in its place.

    A channel is the mean over its place, and some elements are in no place: what the channels see
    is more even than the plate.

    **Arguments:**

    - `rig`: the rig, whose plate, cells and channels are drawn.
    - `at`: a steady state, such as `most_even_point` finds; or a closed loop, at its end.

    **Returns:** the figure.

    **Raises:** `ControlError` for a rig without a plate.
    """
    check_has_plate("plot_plate_seen", rig, ControlError)
    count = len(rig.plate.element_names)
    if isinstance(at, OperatingPoint):
        elements, readings = np.asarray(at.nodes)[:count], np.asarray(at.outputs)
    else:
        elements, readings = at.run.states[-1, :count], at.run.temperatures[-1]
    drawn = np.concatenate([elements, readings])
    scale = ScalarMappable(Normalize(float(drawn.min()), float(drawn.max())), HEAT)
    figure = pyplot.figure(figsize=(9.4, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    for axes in (left, right):
        axes.set_axis_off()
        frame(axes, rig.plate)
    places = [rig.plate.extent(name) for name in rig.plate.element_names]
    for place, color in zip(places, scale.to_rgba(elements), strict=True):
        # A rim of the same colour covers the thin gap between neighbours.
        left.add_patch(rectangle(place, fc=color, ec=color, lw=0.3))
    draw_cells(left, rig)
    for number in (elements.argmax(), elements.argmin()):
        write_inside(left, places[number], f"{elements[number]:.1f}")
    _entitle(left, "elements of the plate", elements)
    for channel, reading in zip(rig.channels, readings, strict=True):
        for place in channel.sensor.outline(rig.plate):
            rim = {"ec": palette().faint, "lw": 1.5}
            right.add_patch(rectangle(place, fc=scale.to_rgba(reading), **rim))
    for channel, reading in zip(rig.channels, readings, strict=True):
        for place in channel.sensor.outline(rig.plate)[:1]:
            write_inside(right, place, f"{reading:.1f}")
    _entitle(right, "readings of the channels", readings)
    draw_scale(figure, scale, np.array([left, right]), 24)
    return figure


def _entitle(axes: Axes, title: str, values: np.ndarray) -> None:
    axes.set_title(title)
    title_aside(axes, f"range {np.ptp(values):.1f} K")


def write_inside(axes: Axes, place: tuple[float, float, float, float], text: str) -> None:
    """Writes in the middle of a place on the plate."""
    left, right, top, bottom = place
    axes.text(
        50 * (left + right), 50 * (top + bottom), text, ha="center", va="center",
        fontsize=points(8), color=PALE, path_effects=[withStroke(linewidth=2, foreground=INK)],
    )  # fmt: skip


@styled
def plot_rig_design(design: RigDesign) -> Figure:
    """Plots the plate at its most even rest with the cells where they were and where the design
    places them, with the hottest and the coldest element.

    **Arguments:**

    - `design`: the result of `jaxtwin.design_rig`.

    **Returns:** the figure.
    """
    both = {"before": design.before, "designed": design.after}
    drawn = np.concatenate([_elements(placed) for placed in both.values()])
    scale = ScalarMappable(Normalize(float(drawn.min()), float(drawn.max())), HEAT)
    plate = design.rig.plate
    figure = pyplot.figure(
        figsize=(9.4, 0.65 + 4.1 * plate.height / plate.width), layout="constrained"
    )
    grid = figure.subplots(1, 2)
    for axes, (title, placed) in zip(grid, both.items(), strict=True):
        axes.set_axis_off()
        rig, elements = placed.twin.rig, _elements(placed)
        draw_map(axes, rig, title, elements, scale)
        for number in (elements.argmax(), elements.argmin()):
            place = rig.plate.extent(rig.plate.element_names[number])
            write_inside(axes, place, f"{elements[number]:.1f}")
        duty = " and ".join(f"{100 * each:.0f} %" for each in np.asarray(placed.point.duty))
        title_aside(axes, f"range {placed.point.range:.1f} K, duty {duty}")
    draw_scale(figure, scale, grid, 24)
    return figure


def _elements(placed: PlacedCells) -> np.ndarray:
    return np.asarray(placed.point.nodes)[: placed.point.elements]
