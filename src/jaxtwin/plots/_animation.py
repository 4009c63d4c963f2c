"""The plate's temperatures as a film."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Float
from matplotlib import pyplot, rcParams
from matplotlib.animation import AbstractMovieWriter, FuncAnimation, writers
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._arguments import finite_number, whole_number
from ..errors import ParameterError
from ..rig import Rig
from ..simulation import Run
from ._layers import draw_duty
from ._panels import color_bar, legend_beside, time_axis, title_aside
from ._plate_map import draw_map, heat_scale, paint, range_text, runs_of_plate
from ._style import color_of, line_of, palette, points, styled

if TYPE_CHECKING:
    from ..control import ClosedLoopRun

# The default number of frames, which makes a GIF of some hundred kilobytes.
FRAMES = 100

# Files that matplotlib writes with Pillow; for others it starts another program.
PILLOW = (".gif", ".webp")


def animate_plate(
    rig: Rig,
    run: "Run | ClosedLoopRun | Mapping[str, Run | ClosedLoopRun]",
    *,
    frames: int = FRAMES,
    seconds: float | int = 8.0,
) -> FuncAnimation:
    """Animates the plate map over time, above the duty cycles of the cells; of several runs, such
    as the loops of several controllers, the maps side by side, above the range of each plate.

    `.save("plate.gif")` writes the animation with Pillow, `.save("plate.mp4")` writes it with
    ffmpeg, and raises `ParameterError` if that is not installed; `.to_jshtml()` is for a web page
    or a notebook.

    **Arguments:**

    - `rig`: the rig, whose plate and cells are drawn.
    - `run`: a run of a twin of this rig (`Twin.simulate`), or of a closed loop; or name -> run,
      of which the shortest one determines the duration.
    - `frames`: the number of pictures, evenly over the run; a run of fewer samples has a picture
      for each sample.
    - `seconds`: the duration of the film, s.

    **Returns:** matplotlib's animation, which must be kept until it is saved or shown.

    **Raises:** `ParameterError` for a run of another rig, or numbers out of range.
    """
    runs = runs_of_plate("animate_plate", rig, run if isinstance(run, Mapping) else {"": run})
    frames = whole_number("animate_plate: frames", frames, 2, ParameterError)
    seconds = finite_number("animate_plate: seconds", seconds, ParameterError, above=0)
    shortest = min(runs.values(), key=lambda run: run.time[-1])
    times = np.linspace(shortest.time[0], shortest.time[-1], min(frames, len(shortest.time)))
    film = _Film(rig, runs, times)
    figure = film.draw()
    return _Animation(
        figure, film.show, frames=len(times), interval=1000 * seconds / len(times), blit=False
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

    def __init__(self, rig: Rig, runs: Mapping[str, Run], times: Float[np.ndarray, " frames"]):
        self._rig, self._runs, self._times = rig, runs, times
        elements = len(rig.plate.element_names)
        self._plates: list[Float[np.ndarray, "frames elements"]] = [
            run.states[np.searchsorted(run.time, times - 1e-9), :elements] for run in runs.values()
        ]
        self._scale = heat_scale(*self._plates)

    @styled
    def draw(self) -> Figure:
        """The first picture."""
        plate, count = self._rig.plate, len(self._runs)
        width = 6.0 if count == 1 else 3.6 * count + 1.2
        height = (width - 1.2) / count * plate.height / plate.width + 1.9
        figure = pyplot.figure(figsize=(width, height), layout="constrained")
        ratios = (height - 1.3, 1.0 if count == 1 else 1.3)
        grid = figure.add_gridspec(2, count, height_ratios=ratios)
        maps = [figure.add_subplot(grid[0, number]) for number in range(count)]
        self._patches = [
            draw_map(axes, self._rig, name, states[0], self._scale)
            for axes, name, states in zip(maps, self._runs, self._plates, strict=True)
        ]
        self._notes = [title_aside(axes, "") for axes in maps]
        below = figure.add_subplot(grid[1, :])
        if count == 1:
            self._title = maps[0].set_title("", fontsize=points(11))
            (run,) = self._runs.values()
            draw_duty(below, run.time, run.experiment.duty, self._rig.driven)
            time_axis(below, run.time, run.experiment.start)
        else:
            self._title = figure.suptitle("", fontsize=points(11))
            self._draw_ranges(below)
        legend_beside(below)
        color_bar(np.array(maps), self._scale, "temperature, °C", shrink=0.9, pad=0.02)
        self._now = below.axvline(self._times[0], color=palette().muted, lw=1.0)
        self.show(0)
        return figure

    def _draw_ranges(self, axes: Axes) -> None:
        elements = len(self._rig.plate.element_names)
        for number, (name, run) in enumerate(self._runs.items()):
            spread = np.ptp(run.states[:, :elements], axis=1)
            look = {"color": color_of(number), "ls": line_of(number), "lw": 1.5}
            axes.plot(run.time, spread, label=name, **look)
        axes.set_ylabel("range, K")
        time_axis(axes, self._times)
        axes.set_ylim(bottom=0)

    def show(self, number: int) -> list[Artist]:
        """Sets the picture of this number."""
        for elements, note, plates in zip(self._patches, self._notes, self._plates, strict=True):
            values = plates[number]
            paint(elements, values, self._scale)
            is_alone = len(self._plates) == 1
            note.set_text(range_text(values) if is_alone else f"range {np.ptp(values):.1f} K")
        time = self._times[number]
        self._title.set_text(f"{time:.0f} s")
        self._now.set_xdata([time, time])
        return [*(patch for each in self._patches for patch in each), self._title, self._now]
