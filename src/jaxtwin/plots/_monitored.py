"""A recording that a monitor has watched: readings, a timeline of findings, and scores."""

import numpy as np
from jaxtyping import Float
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..monitoring import Monitored
from ._readings import draw_readings
from ._style import palette, points, styled

# The largest number of channels with a line of their own, and of rows of findings.
MAX_CHANNELS = 8

# The kinds of findings, each with its colour.
KINDS = ("sudden", "gone", "frozen", "implausible", "drift", "impossible", "changed")

# The lines of the scores -> the tests whose largest score they show.
TESTS = {
    "innovations": ("sum", "ratio", "joint", "energy"),
    "states": ("state", "error"),
    "readings": ("frozen", "gone"),
    "match": ("changed",),
}


@styled
def plot_monitored(monitored: Monitored) -> Figure:
    """Plots what a monitor found.

    The panels are the readings with what was expected of them, a timeline with a bar for each
    finding from its onset to its end (a dot where it was found; notices are pale), and the scores
    of the tests, which are findings from 1 on.

    **Arguments:**

    - `monitored`: the result of `jaxtwin.monitor`.

    **Returns:** the figure.
    """
    rows = list(dict.fromkeys((finding.kind, finding.channel) for finding in monitored.findings))[
        :MAX_CHANNELS
    ]
    height = 0.6 + 0.3 * max(len(rows), 1)
    figure = pyplot.figure(figsize=(9.6, 4.8 + height), layout="constrained")
    grid = figure.subplots(3, 1, sharex=True, height_ratios=(2.6, height, 1.6))
    draw_readings(grid[0], monitored.observed)
    _timeline(grid[1], monitored, rows)
    _scores(grid[2], monitored)
    grid[2].set(xlabel="time, s", xlim=(monitored.time[0], monitored.time[-1]))
    return figure


def _timeline(axes: Axes, monitored: Monitored, rows: list[tuple[str, str]]) -> None:
    end = float(monitored.time[-1])
    for finding in monitored.findings:
        if (finding.kind, finding.channel) not in rows:
            continue
        row, since = rows.index((finding.kind, finding.channel)), float(finding.since or 0.0)
        until = end if finding.until is None else float(finding.until)
        color, alpha = _color(finding.kind), 1.0 if finding.is_alarm else 0.45
        axes.barh(row, until - since, left=since, height=0.55, color=color, alpha=alpha)
        axes.plot(float(finding.found or since), row, ".", ms=6, color=palette().ink, zorder=3)
    axes.set_yticks(range(len(rows)), [f"{kind} {channel or 'all'}" for kind, channel in rows])
    axes.set_ylim(max(len(rows), 1) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")
    if not rows:
        axes.text(0.5, 0.5, "nothing found", transform=axes.transAxes, ha="center", va="center",
                  color=palette().muted)  # fmt: skip


def _color(kind: str) -> str:
    """The colour of a kind of findings."""
    return palette().cycle[KINDS.index(kind) % len(palette().cycle)]


def _scores(axes: Axes, monitored: Monitored) -> None:
    for number, (label, tests) in enumerate(TESTS.items()):
        scores = [getattr(monitored.evidences, test).score for test in tests]
        largest = _largest(np.concatenate(scores, axis=1))
        if largest is not None:
            color = palette().cycle[number]
            axes.plot(monitored.time, np.clip(largest, 0.0, 2.0), color=color, lw=1.0, label=label)
    axes.axhline(1.0, color=palette().ink, lw=0.8, ls=(0, (4, 3)))
    axes.set(ylabel="score", ylim=(0.0, 2.05))
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=points(8))


def _largest(scores: Float[np.ndarray, "times members"]) -> Float[np.ndarray, " times"] | None:
    """The largest score at each time; None for a test that has nothing to test."""
    return scores.max(axis=1) if scores.shape[1] else None
