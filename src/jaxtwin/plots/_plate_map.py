"""The layers of pictures of a plate: its elements, cells and channels at their true size, coloured
by temperatures on one scale.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon, Rectangle

from ..control import ClosedLoopRun
from ..errors import JaxtwinError, ParameterError
from ..rig import Cell, Channel, Heater, Plate, Rig, check_has_plate
from ..simulation import Run
from ._panels import panels, title_aside, without_frame, write
from ._style import INK, PALE, palette, rim

# The colours of temperatures. The coldest is a dark violet, because black shows no differences.
HEAT = ListedColormap(colormaps["inferno"](np.linspace(0.18, 1.0, 256)))

MAP_WIDTH, ROOM_ABOVE, ROOM_BELOW, ROOM_BESIDE = 4.0, 0.36, 0.2, 1.4
"""The width of a map, the room above it and below all of them, and that of the scale of colours,
inches."""

Extent = tuple[float, float, float, float]


def runs_of_plate(where: str, rig: Rig, runs: Mapping[str, Run | ClosedLoopRun]) -> dict[str, Run]:
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


def samples_at(
    where: str, run: Run, times: Sequence[float | int], error: type[JaxtwinError], of: str = ""
) -> list[int]:
    """The samples of a run nearest to given times.

    **Raises:** `error` for a time that lies outside of the run.
    """
    for time in times:
        if not run.time[0] <= time <= run.time[-1]:
            raise error(
                f"{where}: times: expected {run.time[0]:g} to {run.time[-1]:g} s{of}, got "
                f"{time:.10g} s"
            )
    return [int(np.argmin(np.abs(run.time - time))) for time in times]


def map_panels(plate: Plate, rows: int, columns: int) -> tuple[Figure, np.ndarray]:
    """A figure with a grid of panels for maps of a plate, with room for a scale of colours."""
    height = ROOM_ABOVE + MAP_WIDTH * plate.height / plate.width
    figure, grid = panels(
        rows, columns, MAP_WIDTH * columns + ROOM_BESIDE, height * rows + ROOM_BELOW
    )
    for axes in grid.flat:
        frame(axes, plate)
    return figure, grid


def frame(axes: Axes, plate: Plate) -> None:
    """Sets the axes to cm with the plate's proportions, y from the top."""
    axes.set(aspect="equal", xticks=[], yticks=[])
    axes.set_xlim(-0.3, 100 * plate.width + 0.3)
    axes.set_ylim(100 * plate.height + 0.3, -0.3)
    without_frame(axes)


def heat_scale(*temperatures: np.ndarray) -> ScalarMappable:
    """The scale of colours of all temperatures that a picture shows."""
    lowest = min(float(np.nanmin(values)) for values in temperatures)
    highest = max(float(np.nanmax(values)) for values in temperatures)
    return ScalarMappable(Normalize(lowest, highest), HEAT)


def draw_map(
    axes: Axes,
    rig: Rig,
    title: str,
    values: Float[np.ndarray, " elements"],
    scale: ScalarMappable,
    note: str | None = None,
) -> list[Rectangle]:
    """Draws temperatures over the plate, with its cells.

    **Arguments:**

    - `note`: what is written beside the title; by default the range of the temperatures.

    **Returns:** the elements, which `paint` may give other temperatures.
    """
    frame(axes, rig.plate)
    extents = [rig.plate.extent(element) for element in rig.plate.element_names]
    elements = [rectangle(extent) for extent in extents]
    paint(elements, values, scale)
    for element in elements:
        axes.add_patch(element)
    draw_cells(axes, rig)
    axes.set_title(title)
    title_aside(axes, range_text(values) if note is None else note)
    return elements


def paint(
    elements: Sequence[Rectangle], values: Float[np.ndarray, " elements"], scale: ScalarMappable
) -> None:
    """Gives elements the colours of temperatures."""
    for element, color in zip(elements, scale.to_rgba(values), strict=True):
        # A rim of the same colour covers the thin gap between neighbours.
        element.set(facecolor=color, edgecolor=color, linewidth=0.3)


def range_text(values: np.ndarray, unit: str = "°C") -> str:
    """The lowest and the highest of some values that are known."""
    known = values[~np.isnan(values)]
    if not known.size:
        return "no sample"
    return f"{known.min():.1f} … {known.max():.1f} {unit}".replace("-", "−")


def draw_readings(
    axes: Axes,
    plate: Plate,
    channels: Sequence[Channel],
    readings: Float[np.ndarray, " channels"],
    scale: ScalarMappable,
) -> None:
    """Draws the readings of channels, each in its place; a place without a reading stays empty."""

    def area(number: int) -> float:
        places = channels[number].sensor.outline(plate)
        return sum((right - left) * (bottom - top) for left, right, top, bottom in places)

    # Small places are drawn last, because taps lie inside of zones.
    for number in sorted(range(len(channels)), key=lambda number: -area(number)):
        reading = np.array(readings[number])
        color = "none" if np.isnan(reading) else scale.to_rgba(reading)
        for place in channels[number].sensor.outline(plate):
            axes.add_patch(rectangle(place, fc=color, ec=palette().faint, lw=1.2))
    outline = (0.0, plate.width, 0.0, plate.height)
    axes.add_patch(rectangle(outline, fc="none", ec=palette().muted, lw=0.8))


def write_extremes(axes: Axes, plate: Plate, values: Float[np.ndarray, " elements"]) -> None:
    """Writes the temperatures of the hottest and the coldest element into them."""
    for number in (values.argmax(), values.argmin()):
        extent = plate.extent(plate.element_names[number])
        write_inside(axes, extent, f"{values[number]:.1f}")


def write_inside(axes: Axes, extent: Extent, text: str) -> None:
    """Writes in the middle of a place on the plate."""
    left, right, top, bottom = extent
    middle = (50 * (left + right), 50 * (top + bottom))
    look = {"ha": "center", "va": "center", "color": PALE, "path_effects": rim(INK, 2)}
    write(axes, text, middle, size=8, **look)


def draw_cells(axes: Axes, rig: Rig) -> None:
    """Draws a dashed line around each cell, where the rig file places it or around the elements
    that it touches, and its name; likewise heaters that are placed."""
    look = {"fc": "none", "ec": PALE, "lw": 1.2, "ls": (0, (4, 2))}
    _draw_outlines(axes, rig, PALE, INK, path_effects=rim(INK, 2.2), **look)


def draw_channels(axes: Axes, rig: Rig) -> None:
    """Draws the places of the channels and the cells, with their names."""
    plate = rig.plate
    extent = (0.0, plate.width, 0.0, plate.height)
    axes.add_patch(rectangle(extent, fc=palette().faint, ec=palette().muted, lw=1))
    for channel in rig.channels:
        for place in channel.sensor.outline(plate):
            axes.add_patch(rectangle(place, fc="none", ec=palette().blue, lw=1.2))
    color = palette().vermilion
    _draw_outlines(axes, rig, color, palette().faint, fc=color, alpha=0.25, lw=0)
    for channel in rig.channels:
        if channel.sensor.outline(plate):
            _name_channel(axes, plate, channel)
    axes.set_title("channels and cells")


def _name_channel(axes: Axes, plate: Plate, channel: Channel) -> None:
    """Writes the name of a channel in its middle, rotated if the channel is narrow, or below it if
    it is small in both directions."""
    extents = np.array(channel.sensor.outline(plate))
    middle = (100 * extents[:, :2].mean(), 100 * extents[:, 2:].mean())
    is_narrow = np.ptp(extents[:, :2]) < 0.07 * plate.width
    is_low = np.ptp(extents[:, 2:]) < 0.07 * plate.width
    write(
        axes, channel.name, middle, (0, -11 if is_narrow and is_low else 0), size=7.5,
        ha="center", va="center", color=palette().ink,
        rotation=90 if is_narrow and not is_low else 0,
        path_effects=rim(palette().faint, 2.5),
    )  # fmt: skip


def _draw_outlines(axes: Axes, rig: Rig, color: str, around: str, **look: Any) -> None:
    """Draws the outline of each cell, and of heaters that are placed, with its name in the lower
    left corner."""
    placed = [heater for heater in rig.heaters if heater.placement is not None]
    for cell in (*rig.cells, *placed):
        outline, corner = _outline(rig, cell, **look)
        axes.add_patch(outline)
        bold = {"fontweight": "bold", "path_effects": rim(around, 2.2)}
        write(axes, cell.name, corner, (4, 4), size=8, color=color, **bold)


def _outline(rig: Rig, cell: Cell | Heater, **look: Any) -> tuple[Patch, tuple[float, float]]:
    """The outline of a cell, at its place by the rig's values or around the elements that it
    touches, and its lower left corner."""
    if cell.placement is None:
        assert isinstance(cell, Cell)
        extents = np.array([rig.plate.extent(element) for element, _ in cell.contacts])
        left, right = extents[:, 0].min(), extents[:, 1].max()
        top, bottom = extents[:, 2].min(), extents[:, 3].max()
        return rectangle((left, right, top, bottom), **look), (100 * left, 100 * bottom)
    values = {name: row.to_si(row.value) for name, row in rig.parameters.items()}
    corners = 100 * cell.placement.outline(values)
    return Polygon(corners, **look), tuple(corners[(corners[:, 1] - corners[:, 0]).argmax()])


def rectangle(extent: Extent, **look: Any) -> Rectangle:
    """A rectangle given in m on axes in cm."""
    left, right, top, bottom = (100 * edge for edge in extent)
    return Rectangle((left, top), right - left, bottom - top, **look)
