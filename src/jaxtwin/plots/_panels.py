"""Panels: axes for a picture, a grid of small panels, and what is written beside a panel."""

from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ._style import palette, points


def axes_or_new(ax: Axes | None, width: float, height: float) -> Axes:
    """The given axes, or those of a new figure of this size, inches."""
    if ax is not None:
        return ax
    return pyplot.figure(figsize=(width, height), layout="constrained").subplots()


def panel_grid(
    count: int, max_columns: int, width: float, height: float, frame: float
) -> tuple[Figure, list[Axes]]:
    """A figure with a number of panels that share their x axis, row by row.

    **Arguments:**

    - `count`: the number of panels. `max_columns`: the largest number of panels in a row.
    - `width`, `height`: the size of a panel, inches.
    - `frame`: the height of the figure beside its panels, inches.

    **Returns:** the figure and its panels. The lowest panel of each column has labels below it.
    """
    columns = min(max_columns, count)
    rows = -(-count // columns)
    figure = pyplot.figure(figsize=(width * columns, frame + height * rows), layout="constrained")
    panels = list(figure.subplots(rows, columns, squeeze=False, sharex=True).flat)
    for axes in panels[max(0, count - columns) : count]:
        axes.tick_params(labelbottom=True)
    for axes in panels[count:]:
        axes.set_axis_off()
    return figure, panels[:count]


def title_aside(axes: Axes, text: str) -> None:
    """Writes a note at the right end of the line of the title."""
    axes.set_title(
        text, loc="right", fontsize=points(9), fontweight="normal", color=palette().muted
    )


def legend_beside(axes: Axes, *, reverse: bool = False) -> None:
    """Writes the legend to the right of the axes; reversed for lines that were drawn last first."""
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=points(8), reverse=reverse)


def legend_below(axes: Axes) -> None:
    """Writes the legend below the axes, where it lies on no line."""
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=4, fontsize=points(9), frameon=False
    )
