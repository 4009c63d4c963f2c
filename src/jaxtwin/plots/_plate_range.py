"""How even the plate is on the way to a temperature, in several closed loops."""

from collections.abc import Mapping

import numpy as np
from matplotlib import pyplot
from matplotlib.figure import Figure

from ..control import ClosedLoopRun, OperatingPoint
from ..errors import ControlError
from ._style import line_of, palette, styled


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
        color = palette().cycle[number % len(palette().cycle)]
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
    below.set(xlabel="time, s", ylabel="range of the plate, K", xlim=(0, last))
    below.set_ylim(bottom=0)
    return figure
