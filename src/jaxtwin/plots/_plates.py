"""Pictures of a plate: its temperatures at several times (Figs. 5 and 13b of the paper) and in
several runs, beside what the channels see and what was recorded, and before and after a design of
its rig.
"""

from collections.abc import Mapping, Sequence
from typing import overload

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import CenteredNorm
from matplotlib.figure import Figure

from ..control import ClosedLoopRun, OperatingPoint, RigDesign
from ..errors import ControlError, ParameterError, SimulationError
from ..physics import plate_map
from ..rig import Rig, check_has_plate
from ..simulation import Run
from ._layers import recorded_temperatures
from ._panels import color_bar, title_aside
from ._plate_map import (
    draw_cells,
    draw_channels,
    draw_map,
    draw_readings,
    frame,
    heat_scale,
    map_panels,
    range_text,
    runs_of_plate,
    samples_at,
    write_extremes,
    write_inside,
)
from ._style import palette, styled

BAR = {"label": "temperature, °C", "shrink": 0.7, "pad": 0.02}
"""The look of the bar beside maps of temperatures."""


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
    rig: Rig, temperatures: Float[np.ndarray, "maps elements"], titles: Sequence[str], *, ax: Axes
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
    """Plots temperatures over the plate, a panel for each title, and a panel that names the
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
    scale = heat_scale(np.asarray(temperatures))
    if ax is not None:
        if len(titles) != 1:
            raise ParameterError(
                f"ax: expected a single map to draw into given axes, got {len(titles)}; draw each "
                "into its own, or leave ax out"
            )
        draw_map(ax, rig, titles[0], np.asarray(temperatures)[0], scale)
        color_bar(ax, scale, **BAR)
        return ax
    figure, grid = map_panels(rig.plate, -(-(len(titles) + 1) // columns), columns)
    for axes, title, values in zip(grid.flat, titles, temperatures, strict=False):
        draw_map(axes, rig, title, values, scale)
    draw_channels(grid.flat[len(titles)], rig)
    color_bar(grid, scale, aspect=28, **BAR)
    return figure


@styled
def plot_plates(
    rig: Rig, runs: Mapping[str, Run | ClosedLoopRun], times: Sequence[float | int]
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
    maps = []
    for name, run in simulated.items():
        samples = samples_at(where, run, times, ParameterError, f", the time of {name}")
        maps.append(run.states[samples, : len(rig.plate.element_names)])
    scale = heat_scale(*maps)
    figure, grid = map_panels(rig.plate, len(times), len(simulated))
    for column, name, states in zip(grid.T, simulated, maps, strict=True):
        for axes, values in zip(column, states, strict=True):
            title = name if axes is column[0] else ""
            draw_map(axes, rig, title, values, scale, f"range {np.ptp(values):.1f} K")
    for axes, time in zip(grid[:, 0], times, strict=True):
        axes.set_ylabel(f"{time:g} s", color=palette().ink)
    color_bar(grid, scale, aspect=24, **BAR)
    return figure


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
    scale = heat_scale(elements, readings)
    figure, grid = map_panels(rig.plate, 1, 2)
    left, right = grid.flat
    draw_map(left, rig, "elements of the plate", elements, scale, f"range {np.ptp(elements):.1f} K")
    write_extremes(left, rig.plate, elements)
    draw_readings(right, rig.plate, rig.channels, readings, scale)
    for channel, reading in zip(rig.channels, readings, strict=True):
        for place in channel.sensor.outline(rig.plate)[:1]:
            write_inside(right, place, f"{reading:.1f}")
    right.set_title("readings of the channels")
    title_aside(right, f"range {np.ptp(readings):.1f} K")
    color_bar(grid, scale, **BAR)
    return figure


@styled
def plot_rig_design(design: RigDesign) -> Figure:
    """Plots the plate at its most even rest with the cells where they were and where the design
    places them, with the hottest and the coldest element.

    **Arguments:**

    - `design`: the result of `jaxtwin.design_rig`.

    **Returns:** the figure.
    """
    both = {"before": design.before, "designed": design.after}
    elements = [np.asarray(each.point.nodes)[: each.point.elements] for each in both.values()]
    scale = heat_scale(*elements)
    figure, grid = map_panels(design.rig.plate, 1, 2)
    for axes, (title, placed), values in zip(grid.flat, both.items(), elements, strict=True):
        duty = " and ".join(f"{100 * each:.0f} %" for each in np.asarray(placed.point.duty))
        note = f"range {placed.point.range:.1f} K, duty {duty}"
        draw_map(axes, placed.twin.rig, title, values, scale, note)
        write_extremes(axes, placed.twin.rig.plate, values)
    color_bar(grid, scale, **BAR)
    return figure


@styled
def plot_plate_beside(rig: Rig, runs: Sequence[Run], times: Sequence[float]) -> Figure:
    """Plots the plate at several times, in rows: the simulated temperatures, the simulated readings
    of the camera, and the recorded readings.

    The last row is the difference of recorded and simulated readings, on a separate scale about 0.
    Places whose sample is missing stay empty.

    **Arguments:**

    - `rig`: the rig of the runs.
    - `runs`: runs of experiments that have recorded temperatures. If several with the same drive
      show different zones, their readings are drawn on one plate, whose simulated temperatures are
      those of the first run.
    - `times`: the times of the columns, s; the nearest sample is shown.

    **Returns:** the figure.

    **Raises:** `SimulationError` if a run has nothing recorded, or a time lies outside of it.
    """
    check_has_plate("plot_plate_beside", rig, SimulationError)
    every = [recorded_temperatures(run) for run in runs]
    samples = [samples_at("plot_plate_beside", run, times, SimulationError) for run in runs]
    recorded = np.concatenate([r[at] for r, at in zip(every, samples, strict=True)], axis=1)
    twin = [run.temperatures[at] for run, at in zip(runs, samples, strict=True)]
    read = np.concatenate(twin, axis=1)
    states = runs[0].states[samples[0], : len(rig.plate.element_names)]
    fields = plate_map(rig, states).temperatures
    scale = heat_scale(fields, read, recorded)
    widest = float(np.abs(np.nan_to_num(recorded - read)).max()) or 1.0
    apart = ScalarMappable(CenteredNorm(0.0, widest), "RdBu_r")
    figure, grid = map_panels(rig.plate, 4, len(times))
    for axes, time, field in zip(grid[0], times, fields, strict=True):
        extent = (0.0, 100 * rig.plate.width, 100 * rig.plate.height, 0.0)
        look = {"norm": scale.norm, "cmap": scale.cmap, "interpolation": "bilinear"}
        axes.imshow(field, extent=extent, **look)
        frame(axes, rig.plate)  # the image has set the limits to its own
        draw_cells(axes, rig)
        axes.set_title(f"{time:g} s")
        title_aside(axes, range_text(field))
    named = {channel.name: channel for channel in rig.channels}
    channels = [named[name] for run in runs for name in run.channels]
    for row, values, colors, unit in (
        (grid[1], read, scale, "°C"),
        (grid[2], recorded, scale, "°C"),
        (grid[3], recorded - read, apart, "K"),
    ):
        for axes, shown in zip(row, values, strict=True):
            draw_readings(axes, rig.plate, channels, shown, colors)
            title_aside(axes, range_text(shown, unit))
    labels = ("twin: the plate", "twin: as read", "recorded", "recorded − twin")
    for axes, label in zip(grid[:, 0], labels, strict=True):
        axes.set_ylabel(label, color=palette().ink)
    color_bar(grid[:3], scale, aspect=28, **BAR)
    color_bar(grid[3:], apart, "difference, K", shrink=0.7, aspect=9, pad=0.02)
    return figure
