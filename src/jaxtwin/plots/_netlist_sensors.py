"""Sensors with a lag in the picture of a network."""

from collections.abc import Mapping

from matplotlib.axes import Axes

from ..physics import Twin
from ..physics._sensors import sensor_name
from ._netlist_cells import outlined
from ._style import INK, palette, points

# The directions of the stubs of an element's sensors, right and down, in lengths of a stub.
DIRECTIONS = ((-1.0, 1.0), (0.0, 1.0), (-1.0, 0.0))


def draw_sensors(ax: Axes, twin: Twin, values: Mapping[str, float]) -> None:
    """Draws a stub from each element to each sensor with a lag that touches it, with the lag.

    Sensors on bodies are named there: see `draw_bodies`.

    **Arguments:**

    - `ax`: axes whose unit is 1 cm, with the plate's top left corner at 0, 0.
    - `twin`: the twin with the channels. `values`: the values of its parameters, SI.
    """
    rig = twin.rig
    lags = {sensor_name(c.name): (c.name, c.lag) for c in rig.channels if c.lag is not None}
    drawn = dict.fromkeys(rig.plate.element_names, 0)
    for link in twin.netlist.links:
        if link.b not in lags or link.a not in drawn:
            continue
        channel, lag = lags[link.b]
        left, right, top, bottom = (100 * edge for edge in rig.plate.extent(link.a))
        x, y = (left + right) / 2, (top + bottom) / 2
        # The first stub points down to the left, where neither cells nor the air are drawn; the
        # second straight down, the third to the left.
        reach = 0.22 * min(right - left, bottom - top)
        right_by, down_by = DIRECTIONS[drawn[link.a] % len(DIRECTIONS)]
        drawn[link.a] += 1
        end = x + right_by * reach, y + down_by * reach
        ax.plot([x, end[0]], [y, end[1]], color=palette().green, lw=2, zorder=3,
                path_effects=outlined(2.0))  # fmt: skip
        ax.plot(*end, "s", color=palette().green, ms=6, mec=palette().ground, mew=1.2, zorder=5)
        ax.annotate(
            f"{channel}\n{float(lag.evaluate(values)):.3g} s", end, (0, -5),
            textcoords="offset points", ha="center", va="top", color=INK, fontsize=points(7.5),
            linespacing=1.1, zorder=6,
        )  # fmt: skip
