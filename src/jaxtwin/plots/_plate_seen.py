"""The plate beside what the channels see of it."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from ..control import ClosedLoopRun, OperatingPoint
from ..errors import ControlError
from ..rig import Rig
from ..rig._plate_needed import check_has_plate
from ._plate_map import HEAT, draw_cells, draw_scale, frame, rectangle
from ._style import INK, PALE, palette, points, styled


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
    axes.set_title(
        f"range {np.ptp(values):.1f} K",
        loc="right", fontsize=points(9), fontweight="normal", color=palette().muted,
    )  # fmt: skip


def write_inside(axes: Axes, place: tuple[float, float, float, float], text: str) -> None:
    """Writes in the middle of a place on the plate."""
    left, right, top, bottom = place
    axes.text(
        50 * (left + right), 50 * (top + bottom), text, ha="center", va="center",
        fontsize=points(8), color=PALE, path_effects=[withStroke(linewidth=2, foreground=INK)],
    )  # fmt: skip
