"""The plate in several runs side by side."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import pyplot
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ..errors import ParameterError
from ..rig import Rig
from ..rig._plate_needed import check_has_plate
from ..simulation import Run
from ._plate_map import HEAT, draw_map, draw_scale
from ._style import palette, points, styled

if TYPE_CHECKING:
    from ..control import ClosedLoopRun

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
