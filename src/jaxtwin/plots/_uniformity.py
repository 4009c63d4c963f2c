"""The uniformity of the plate: recorded beside simulated, over time and over the plate, and on the
way to a temperature in several closed loops.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import CenteredNorm, Normalize
from matplotlib.figure import Figure

from ..control import ClosedLoopRun, OperatingPoint
from ..errors import ControlError, SimulationError
from ..physics import plate_map
from ..rig import Channel, Rig
from ..rig._plate_needed import check_has_plate
from ..simulation import Run
from ._panels import title_aside
from ._plate_map import HEAT, draw_cells, frame, rectangle
from ._style import color_of, line_of, palette, styled
from ._time_axis import time_axis

MAP_WIDTH, ROOM_ABOVE = 3.6, 0.34  # width of a panel and room above it, inches


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
    columns = [_at(run, times) for run in runs]
    named = {channel.name: channel for channel in rig.channels}
    channels = [named[name] for run in runs for name in run.channels]
    elements = len(rig.plate.element_names)
    states = runs[0].states[_samples(runs[0], times), :elements]
    rows = {
        "twin: the plate": plate_map(rig, states).temperatures,
        "twin: as read": np.concatenate([read for read, _ in columns], axis=1),
        "recorded": np.concatenate([recorded for _, recorded in columns], axis=1),
    }
    everything = np.concatenate([values.ravel() for values in rows.values()])
    norm = Normalize(float(np.nanmin(everything)), float(np.nanmax(everything)))
    scale = ScalarMappable(norm, HEAT)
    difference = rows["recorded"] - rows["twin: as read"]
    rows["recorded − twin"] = difference
    widest = float(np.abs(np.nan_to_num(difference)).max()) or 1.0
    apart = ScalarMappable(CenteredNorm(0.0, widest), "RdBu_r")
    height = ROOM_ABOVE + MAP_WIDTH * rig.plate.height / rig.plate.width
    figure = pyplot.figure(figsize=(MAP_WIDTH * len(times) + 1.4, height * 4), layout="constrained")
    grid = figure.subplots(4, len(times), squeeze=False)
    # Small places are drawn last, because taps lie inside of zones.
    order = sorted(range(len(channels)), key=lambda n: -_area(channels[n], rig))
    for number, (panels, (label, values)) in enumerate(zip(grid, rows.items(), strict=True)):
        colors, rim, unit = (
            (apart, palette().muted, "K")
            if values is difference
            else (scale, palette().faint, "°C")
        )
        for axes, time, shown in zip(panels, times, values, strict=True):
            frame(axes, rig.plate)
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
            axes.grid(visible=False)
            axes.set_title(f"{time:g} s" if number == 0 else "")
            there = shown[~np.isnan(shown)]
            text = f"{there.min():.1f} … {there.max():.1f} {unit}" if there.size else "no sample"
            title_aside(axes, text.replace("-", "−"))
            if number == 0:
                _draw_field(axes, rig, shown, norm)
                draw_cells(axes, rig)
            else:
                for column in order:
                    for place in channels[column].sensor.outline(rig.plate):
                        value = np.array([shown[column]])
                        color = "none" if np.isnan(value) else colors.to_rgba(value)[0]
                        axes.add_patch(rectangle(place, fc=color, ec=rim, lw=0.8))
                outline = (0.0, rig.plate.width, 0.0, rig.plate.height)
                axes.add_patch(rectangle(outline, fc="none", ec=palette().muted, lw=0.8))
        panels[0].set_ylabel(label, color=palette().ink)
    for colors, panels, label, aspect in (
        (scale, grid[:3], "temperature, °C", 28),
        (apart, grid[3:], "difference, K", 9),
    ):
        bar = figure.colorbar(colors, ax=panels, shrink=0.7, aspect=aspect, pad=0.02)
        bar.set_label(label)
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    return figure


def _samples(run: Run, times: Sequence[float]) -> list[int]:
    """The samples nearest to given times."""
    for time in times:
        if not run.time[0] <= time <= run.time[-1]:
            raise SimulationError(
                f"times: expected {run.time[0]:.10g} to {run.time[-1]:.10g} s, got {time:.10g} s"
            )
    return [int(np.argmin(np.abs(run.time - time))) for time in times]


def _at(run: Run, times: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """The simulated and the recorded readings, each (times, channels), degC."""
    if run.experiment.temperatures is None:
        raise SimulationError(
            "experiment: expected recorded temperatures to compare with, got none"
        )
    samples = _samples(run, times)
    return run.temperatures[samples], run.experiment.temperatures[samples]


def _area(channel: Channel, rig: Rig) -> float:
    extents = channel.sensor.outline(rig.plate)
    return sum((right - left) * (bottom - top) for left, right, top, bottom in extents)


def _draw_field(axes: Axes, rig: Rig, field: np.ndarray, norm: Normalize) -> None:
    axes.imshow(
        field, norm=norm, cmap=HEAT, interpolation="bilinear", aspect="equal",
        extent=(0.0, 100 * rig.plate.width, 100 * rig.plate.height, 0.0),
    )  # fmt: skip
    frame(axes, rig.plate)


@styled
def plot_plate_range(
    runs: Mapping[str, ClosedLoopRun], best: OperatingPoint | None = None
) -> Figure:
    """Plots the mean of the channels and the range of the plate, the difference between its hottest
    and its coldest element, over time.

    **Arguments:**

    - `runs`: name -> closed loop of a rig with a plate.
    - `best`: the most even steady state (`most_even_point`), whose range is a line.

    **Returns:** the figure.

    **Raises:** `ControlError` if there is no run, or one is of a rig without a plate.
    """
    if not runs:
        raise ControlError("plot_plate_range: runs: expected at least one closed loop, got none")
    figure = pyplot.figure(figsize=(7.2, 4.8), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1, 1.3))
    for number, (name, run) in enumerate(runs.items()):
        color = color_of(number)
        look = {"color": color, "ls": line_of(number), "lw": 1.6}
        above.plot(run.time, run.run.temperatures.mean(axis=1), label=name, **look)
        below.plot(run.time, run.range, **look)
    last = max(float(run.time[-1]) for run in runs.values())
    if best is not None:
        elements = next(iter(runs.values())).loop.elements
        least = float(np.ptp(np.asarray(best.nodes)[:elements]))
        below.axhline(least, color=palette().muted, ls=":", lw=1.2)
        below.annotate(
            f"most even at rest, {least:.1f} K", (last, least), (-2, -3), va="top", ha="right",
            textcoords="offset points", color=palette().muted,
        )  # fmt: skip
    above.legend(loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.1, ncols=3)
    above.set_ylabel("mean of the\nchannels, °C")
    below.set(ylabel="range of the plate, K", xlim=(0, last))
    time_axis(below, np.array([0.0, last]))
    below.set_ylim(bottom=0)
    return figure
