"""The plate of a rig before and after its design."""

import numpy as np
from matplotlib import pyplot
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ..control import PlacedCells, RigDesign
from ._plate_map import HEAT, draw_map, draw_scale
from ._plate_seen import write_inside
from ._style import palette, points, styled


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
        axes.set_title(
            f"range {placed.point.range:.1f} K, duty {duty}",
            loc="right", fontsize=points(9), fontweight="normal", color=palette().muted,
        )  # fmt: skip
    draw_scale(figure, scale, grid, 24)
    return figure


def _elements(placed: PlacedCells) -> np.ndarray:
    return np.asarray(placed.point.nodes)[: placed.point.elements]
