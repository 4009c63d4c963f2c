"""The plate's temperatures as a film."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Float, Int
from matplotlib import pyplot, rcParams
from matplotlib.animation import AbstractMovieWriter, FuncAnimation, writers
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from .._arguments import finite_number, whole_number
from .._errors import ParameterError
from ..rig import Rig
from ..rig._plate_needed import check_has_plate
from ..simulation import Run
from ._plate_map import HEAT, draw_cells, frame, rectangle
from ._style import palette, points, styled

if TYPE_CHECKING:
    from ..control import ClosedLoopRun

FRAMES = 100
"""The default number of frames, which makes a GIF of some hundred kilobytes."""

PILLOW = (".gif", ".webp")
"""Files that matplotlib writes with Pillow; for others it starts another program."""


def animate_plate(
    rig: Rig,
    run: "Run | ClosedLoopRun",
    *,
    frames: int = FRAMES,
    seconds: float | int = 8.0,
) -> FuncAnimation:
    """Animates the plate map over time, above the duty cycles of the cells.

    `.save("plate.gif")` writes the animation with Pillow, `.save("plate.mp4")` writes it with
    ffmpeg, and raises `ParameterError` if that is not installed; `.to_jshtml()` is for a web page
    or a notebook.

    **Arguments:**

    - `rig`: the rig, whose plate and cells are drawn.
    - `run`: a run of a twin of this rig (`Twin.simulate`), or of a closed loop.
    - `frames`: the number of pictures, evenly over the run; a run of fewer samples has a picture
      for each sample.
    - `seconds`: the duration of the film, s.

    **Returns:** matplotlib's animation, which must be kept until it is saved or shown.

    **Raises:** `ParameterError` for a run of another rig, or numbers out of range.
    """
    simulated = run if isinstance(run, Run) else run.run
    check_has_plate("animate_plate", rig, ParameterError)
    elements = rig.plate.element_names
    if tuple(simulated.nodes[: len(elements)]) != tuple(elements):
        raise ParameterError(
            f"animate_plate: expected a run of {rig.name}, got one of {simulated.rig} with other "
            "plate elements"
        )
    frames = whole_number("animate_plate: frames", frames, 2, ParameterError)
    seconds = finite_number("animate_plate: seconds", seconds, ParameterError)
    if seconds <= 0:
        raise ParameterError(f"animate_plate: seconds: expected more than 0, got {seconds:g}")
    times = np.linspace(simulated.time[0], simulated.time[-1], min(frames, len(simulated.time)))
    chosen = np.searchsorted(simulated.time, times - 1e-9)
    film = _Film(rig, simulated, chosen)
    figure = film.draw()
    return _Animation(
        figure, film.show, frames=len(chosen), interval=1000 * seconds / len(chosen), blit=False
    )


@final
class _Animation(FuncAnimation):
    """Matplotlib's animation with another `save`. Without ffmpeg matplotlib would pass every file
    to Pillow, also files that Pillow cannot write."""

    def save(
        self,
        filename: str | Path,
        writer: AbstractMovieWriter | str | None = None,
        *args: Any,
        **options: Any,
    ) -> None:
        super().save(filename, writer or _writer_of(filename), *args, **options)


def _writer_of(filename: str | Path) -> str:
    """Pillow, or the program that matplotlib's settings name: ffmpeg unless they are changed."""
    name = "pillow" if Path(filename).suffix.lower() in PILLOW else rcParams["animation.writer"]
    if not writers.is_available(name):
        raise ParameterError(
            f"{filename}: expected {name}, which writes videos, to be installed; install it, or "
            "save a .gif"
        )
    return name


class _Film:
    """The figure of the animation and its parts that change between frames."""

    def __init__(self, rig: Rig, run: Run, chosen: Int[np.ndarray, " frames"]):
        self._rig, self._run, self._chosen = rig, run, chosen
        self._plate: Float[np.ndarray, "frames elements"] = run.states[
            chosen, : len(rig.plate.element_names)
        ]
        self._scale = ScalarMappable(
            Normalize(float(self._plate.min()), float(self._plate.max())), HEAT
        )

    @styled
    def draw(self) -> Figure:
        """The first picture."""
        plate = self._rig.plate
        width = 6.0
        height = (width - 1.2) * plate.height / plate.width + 1.9
        figure = pyplot.figure(figsize=(width, height), layout="constrained")
        above, below = figure.subplots(2, 1, height_ratios=(height - 1.3, 1.0))
        above.set_axis_off()
        frame(above, plate)
        self._patches = [
            above.add_patch(rectangle(plate.extent(element))) for element in plate.element_names
        ]
        draw_cells(above, self._rig)
        self._title = above.set_title("", fontsize=points(11))
        self._extremes = above.set_title(
            "", loc="right", fontsize=points(9), fontweight="normal", color=palette().muted
        )
        bar = figure.colorbar(self._scale, ax=above, shrink=0.9, aspect=20, pad=0.02)
        bar.set_label("temperature, °C")
        bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
        self._draw_duty(below)
        self.show(0)
        return figure

    def _draw_duty(self, axes: Axes) -> None:
        time, duty = self._run.time, 100 * self._run.experiment.duty
        for number, (name, each) in enumerate(zip(self._rig.driven, duty.T, strict=True)):
            line = "-" if number == 0 else "--"  # cells are often driven alike
            axes.step(time, each, line, where="post", lw=1.5, label=name)
        axes.set(xlabel="time, s", ylabel="duty, %", xlim=(time[0], time[-1]))
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        self._now = axes.axvline(time[0], color=palette().muted, lw=1.0)

    def show(self, number: int) -> list[Artist]:
        """Sets the picture of this number."""
        temperatures, time = self._plate[number], self._run.time[self._chosen[number]]
        for patch, color in zip(self._patches, self._scale.to_rgba(temperatures), strict=True):
            patch.set(facecolor=color, edgecolor=color, linewidth=0.3)
        self._title.set_text(f"{time:.0f} s")
        self._extremes.set_text(f"{temperatures.min():.1f} … {temperatures.max():.1f} °C")
        self._now.set_xdata([time, time])
        return [*self._patches, self._title, self._extremes, self._now]
