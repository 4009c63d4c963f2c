"""The style of all plots, which is in effect only while a plot is drawn.

The colours are those of Okabe and Ito (https://jfly.uni-koeln.de/color), which people with any
colour vision can distinguish. `style` replaces them, and the size of letters, in a block of code.
"""

import functools
import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from typing import Any, Literal, ParamSpec, TypeVar, final, get_args

import matplotlib.style
from cycler import cycler
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import AbstractPathEffect, withStroke

from .._arguments import finite_number
from ..errors import ParameterError

StyleName = Literal["paper", "grey", "dark"]

# The width of a column of a two-column journal, inches.
COLUMN = 3.5

# The scale of text and lines in a column: 8 points in place of the 10 on a screen.
PAPER_SCALE = 0.8

INK, PALE = "#1f2933", "white"
"""The colours of letters on maps and matrices, whose background does not change with the style."""

# The gid of a figure in which texts have fixed places, so that no style makes it narrower.
OF_FIXED_SIZE = "of fixed size"

Dashes = tuple[float, tuple[float, ...]]


@final
@dataclass(frozen=True)
class Palette:
    """The colours of a style.

    - `ground`: the background. `ink`: text. `muted`: axes, notes and recorded data. `faint`: grid
      lines and empty bars.
    - The other colours are named as they look in the usual style.
    - `dashes`: the dashes of solid lines in a colour that is not distinct enough by itself.
    """

    ground: str = "#ffffff"
    ink: str = INK
    muted: str = "#66727f"
    faint: str = "#dfe4e8"
    blue: str = "#0072b2"
    vermilion: str = "#d55e00"
    green: str = "#009e73"
    purple: str = "#cc79a7"
    orange: str = "#e69f00"
    sky: str = "#56b4e9"
    dashes: Mapping[str, Dashes] = field(default_factory=dict)

    @property
    def cycle(self) -> tuple[str, ...]:
        """The colours of several lines of one kind."""
        return (self.blue, self.vermilion, self.green, self.purple, self.orange, self.sky)


GREY = Palette(
    ink="#000000",
    muted="#7d7d7d",
    faint="#e2e2e2",
    blue="#5c5c5c",
    vermilion="#000000",
    green="#8f8f8f",
    purple="#5b5b5b",
    orange="#010101",
    sky="#bababa",
    dashes={
        "#8f8f8f": (0.0, (5.0, 1.5)),
        "#5b5b5b": (0.0, (5.0, 1.5, 1.0, 1.5)),
        "#010101": (0.0, (1.0, 1.2)),
        "#bababa": (0.0, (9.0, 2.0)),
    },
)

DARK = Palette(
    ground="#16191d",
    ink="#e8ebee",
    muted="#9aa5b1",
    faint="#343b43",
    blue="#4a9fdc",
    vermilion="#ff8547",
    green="#2fc598",
    purple="#e59cc6",
    orange="#f0b33a",
    sky="#8fcdf3",
)


@final
@dataclass(frozen=True)
class _Look:
    """A style: its colours, the size of its letters, and the widest figure, inches."""

    palette: Palette = Palette()
    scale: float = 1.0
    width: float | None = None


_look: ContextVar[_Look] = ContextVar("look", default=_Look())  # noqa: B039 (it is frozen)

Arguments = ParamSpec("Arguments")
Drawn = TypeVar("Drawn", bound=Figure | Axes)


@contextmanager
def style(name: StyleName, *, width: float | int | None = None) -> Iterator[None]:
    """Draws all pictures of a block in another style, matplotlib's own included.

    ```python
    with plots.style("paper"):
        fit.plot()
    ```

    Styles can be nested: `with plots.style("paper"), plots.style("grey"):`.

    **Arguments:**

    - `name`: `"paper"` for a journal, with letters of 8 points in figures no wider than a column;
      `"grey"` for print without colours: solid and dashed lines (maps and densities keep their
      colours, whose brightness grows with the value); `"dark"` for a dark notebook.
    - `width`: the width of the widest figure of `"paper"`, inches: 3.5 by default, a column.
      Figures of several panels need two columns, about 7.2. A thermal network, and a figure into
      whose axes you draw, keep their size.

    **Raises:** `ParameterError` for another name, or a width with a style other than "paper".
    """
    if name not in get_args(StyleName):
        raise ParameterError(f"style: expected paper, grey or dark, got {name!r}")
    if width is not None and name != "paper":
        raise ParameterError(f"style: width: expected None beside {name!r}, got {width!r}")
    look = _look.get()
    if name == "paper":
        widest = (
            COLUMN
            if width is None
            else finite_number("style: width", width, ParameterError, least=1.0, unit="inches")
        )
        look = replace(look, scale=PAPER_SCALE, width=widest)
    else:
        look = replace(look, palette=GREY if name == "grey" else DARK)
    before = _look.set(look)
    try:
        with matplotlib.style.context(_settings(look)):
            yield
    finally:
        _look.reset(before)


def palette() -> Palette:
    """The colours of the present style."""
    return _look.get().palette


def color_of(number: int) -> str:
    """The colour of a line among several of one kind."""
    return palette().cycle[number % len(palette().cycle)]


def line_of(number: int) -> str | Dashes:
    """The dashes of a line among several that may cover each other: solid, then shorter ones, so
    that what is below shows in the gaps."""
    return ("-", (0.0, (5.0, 3.0)), (0.0, (2.0, 2.0)), (0.0, (7.0, 2.0, 1.5, 2.0)))[number % 4]


def rim(color: str | None = None, width: float | int = 3) -> list[AbstractPathEffect]:
    """A rim around text or a line, so that it is seen on what it crosses; of the background unless
    another colour is given."""
    return [withStroke(linewidth=width, foreground=color or palette().ground)]


def points(size: float | int) -> float:
    """Converts a size of letters on a screen to that of the present style."""
    return size * _look.get().scale


def _settings(look: _Look) -> dict[str, Any]:
    """matplotlib's settings."""
    colors = look.palette
    return {
        "axes.axisbelow": True,
        "axes.edgecolor": colors.muted,
        "axes.facecolor": colors.ground,
        "axes.grid": True,
        "axes.labelcolor": colors.ink,
        "axes.prop_cycle": cycler(color=colors.cycle),
        "axes.spines.right": False,
        "axes.spines.top": False,
        "axes.titlecolor": colors.ink,
        "axes.titlelocation": "left",
        "axes.titlesize": 11 * look.scale,
        "axes.titleweight": "bold",
        "figure.constrained_layout.wspace": 0.05,  # between the last tick of a panel and the next
        "figure.facecolor": colors.ground,
        "figure.titlesize": 13 * look.scale,
        "figure.titleweight": "bold",
        "font.size": 10 * look.scale,
        "grid.color": colors.faint,
        "legend.fontsize": 9 * look.scale,
        "legend.frameon": False,
        "lines.linewidth": 1.6 * look.scale,
        "text.color": colors.ink,
        "xtick.color": colors.muted,
        "xtick.labelcolor": colors.ink,
        "xtick.labelsize": 9 * look.scale,
        "ytick.color": colors.muted,
        "ytick.labelcolor": colors.ink,
        "ytick.labelsize": 9 * look.scale,
    }


def styled(plot: Callable[Arguments, Drawn]) -> Callable[Arguments, Drawn]:
    """Makes a function draw in jaxtwin's style, without a change of matplotlib's settings.

    **Arguments:**

    - `plot`: a function that draws something and returns its figure or axes.

    **Returns:** the function that draws in jaxtwin's style.
    """

    @functools.wraps(plot)
    def in_style(*args: Arguments.args, **options: Arguments.kwargs) -> Drawn:
        look = _look.get()
        before = pyplot.get_fignums()
        with matplotlib.style.context(["default", _settings(look)]):
            drawn = plot(*args, **options)
            # Ticks are made when they are first drawn, with the settings at that time.
            figure = drawn if isinstance(drawn, Figure) else drawn.get_figure(root=True)
            if figure is not None:
                # A figure that pyplot does not manage has no number.
                number = getattr(figure, "number", None)
                if number is not None and number not in before:
                    _narrow(figure, look)
                _dash(figure, look.palette.dashes)
                figure.draw_without_rendering()
        return drawn

    return in_style


def _narrow(figure: Figure, look: _Look) -> None:
    """Makes a figure no wider than the style allows, and reduces its height as far as the letters
    allow."""
    width, height = figure.get_size_inches()
    is_free = figure.get_gid() != OF_FIXED_SIZE
    if look.width is not None and width > look.width and is_free:
        figure.set_size_inches(look.width, height * max(look.width / width, look.scale))


def _dash(figure: Figure, dashes: Mapping[str, Dashes]) -> None:
    """Dashes the solid lines of some colours, also in legends."""
    if not dashes:
        return
    for line in figure.findobj(Line2D):
        assert isinstance(line, Line2D)
        dash = dashes.get(to_hex(line.get_color()))  # pyright: ignore[reportArgumentType]
        if dash is not None and line.get_linestyle() == "-":
            line.set_linestyle(dash)


def symbol(name: str) -> str:
    """A parameter's name as in an equation: `R_E` with the index E, `alpha` as the Greek letter."""
    base, _, below = name.partition("_")
    letter = rf"\{base}" if base in {"alpha", "beta", "gamma", "epsilon", "sigma", "tau"} else base
    if not below:
        return name if letter == base else f"${letter}$"
    below = below.replace("_", r"\ ")
    return rf"${letter}_\mathrm{{{below}}}$"


def to_png(drawn: Figure | Axes, dpi: int = 150) -> bytes:
    """A picture as the content of a .png file. Its figure is closed.

    **Arguments:**

    - `drawn`: a figure or axes that a plot function returned.
    - `dpi`: the resolution in pixels per inch.

    **Returns:** the bytes of the file.
    """
    figure = drawn if isinstance(drawn, Figure) else drawn.get_figure(root=True)
    assert figure is not None  # axes that a plot function returns belong to a figure
    if not figure.stale:  # its parts are still as the plot function has arranged them
        figure.set_layout_engine(None)
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi, facecolor="auto")
    pyplot.close(figure)
    return content.getvalue()


# What a unit of a rig file or a dataset has, and what is shown for it.
SIGNS = {"degC": "°C", "ohm": "Ω", "^2": "²", "K2": "K²"}


def with_unit(words: str, unit: str) -> str:
    """Words for an axis or a title, and the unit behind a comma if there is one."""
    return f"{words}, {unit_text(unit)}" if unit else words


def unit_text(unit: str) -> str:
    """A unit with the usual signs: `Ω`, `°C`, `K²`, `W/(m² K)`."""
    for written, sign in SIGNS.items():
        unit = unit.replace(written, sign)
    return unit
