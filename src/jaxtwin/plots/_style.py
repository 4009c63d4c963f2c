"""The look of all pictures, valid while a picture is drawn and not a moment longer.

The colours are those of Okabe and Ito (https://jfly.uni-koeln.de/color), which people with any
colour vision can tell apart.
"""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import matplotlib.style
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK = "#1f2933"  # text
MUTED = "#66727f"  # what stands back: axes, notes, what was recorded
FAINT = "#dfe4e8"  # grid lines, empty bars

BLUE, VERMILION, GREEN = "#0072b2", "#d55e00", "#009e73"
PURPLE, ORANGE, SKY = "#cc79a7", "#e69f00", "#56b4e9"
CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)

STYLE: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": MUTED,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.prop_cycle": cycler(color=CYCLE),
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "figure.constrained_layout.wspace": 0.05,  # between the last tick of a panel and the next
    "figure.titlesize": 13,
    "figure.titleweight": "bold",
    "font.size": 10,
    "grid.color": FAINT,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "text.color": INK,
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "xtick.labelsize": 9,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
    "ytick.labelsize": 9,
}

Arguments = ParamSpec("Arguments")
Drawn = TypeVar("Drawn", Figure, Axes)


def styled(plot: Callable[Arguments, Drawn]) -> Callable[Arguments, Drawn]:
    """Draws in our style, and leaves matplotlib's settings as they were.

    **Arguments:**

    - `plot`: a function that draws something and returns its figure or axes.

    **Returns:** the function, in our style.
    """

    @functools.wraps(plot)
    def in_style(*args: Arguments.args, **options: Arguments.kwargs) -> Drawn:
        with matplotlib.style.context(["default", STYLE]):
            drawn = plot(*args, **options)
            # Ticks are made when they are first drawn, in the style of that moment.
            figure = drawn if isinstance(drawn, Figure) else drawn.get_figure(root=True)
            if figure is not None:
                figure.draw_without_rendering()
        return drawn

    return in_style


def symbol(name: str) -> str:
    """A parameter's name as it stands in an equation: `R_E` with E below, `alpha` as the letter."""
    base, _, below = name.partition("_")
    letter = rf"\{base}" if base in {"alpha", "beta", "gamma", "epsilon", "sigma", "tau"} else base
    if not below:
        return name if letter == base else f"${letter}$"
    below = below.replace("_", r"\ ")
    return rf"${letter}_\mathrm{{{below}}}$"
