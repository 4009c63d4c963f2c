"""Recordings that were watched: the estimates of an observer, the findings of a monitor, the
probabilities of a diagnosis, and which faults can be told apart.
"""

from collections.abc import Mapping

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from .._number_text import short_number
from ..diagnosis import HEALTHY, NONE_OF_THESE, Diagnosis, Isolability
from ..monitoring import Monitored, events
from ..observers import Estimate, Observed
from ._layers import draw_band, draw_lines, draw_matrix
from ._panels import color_bar, legend_beside, panels, time_axis, title_aside, write_in_the_middle
from ._style import color_of, palette, points, styled

# The largest number of channels or nodes with a line of their own, of rows of findings, and of
# faults with a colour of their own.
MAX_CHANNELS = 8


@styled
def plot_observed(observed: Observed) -> Figure:
    """Plots what was read, and what the observer says of the rig, with 95 % bands.

    The panels are the readings, the nodes that no channel sees directly (estimates, not
    measurements), the heats that the twin does not explain, and the room. Heats that are within
    their bands all the time have no panel, but a note.

    **Arguments:**

    - `observed`: the result of `jaxtwin.observe`.

    **Returns:** the figure.
    """
    estimates = observed.estimates
    heats = {cell: estimates.heat(cell) for cell in estimates.cells}
    is_seen = any(np.any((heat.lower > 0) | (heat.upper < 0)) for heat in heats.values())
    ratios = (1.4, 1.4, *((1.0,) if is_seen else ()), 1.0)
    size = (9.6, 1.75 * sum(ratios))
    figure, grid = panels(len(ratios), 1, *size, sharex=True, height_ratios=ratios)
    read, hidden, *middle, room = grid[:, 0]
    _draw_readings(read, observed)
    _draw_bands(read, observed, {name: estimates.channel(name) for name in observed.channels})
    unseen = [name for name in estimates.nodes if name not in observed.channels]
    inner = [name for name in unseen if "." in name] or unseen
    _draw_bands(hidden, observed, {name: estimates.node(name) for name in inner})
    hidden.set_ylabel("estimated, °C")
    for axes in middle:
        _draw_bands(axes, observed, heats)
        axes.set_ylabel("unexplained heat, W")
    if heats and not is_seen:
        widest = max(float(np.max(heat.upper - heat.lower)) / 2 for heat in heats.values())
        title_aside(read, f"no unexplained heat, ± {short_number(widest, 2)} W")
    band = (estimates.room.mean, estimates.room.lower, estimates.room.upper)
    draw_band(room, observed.time, band, palette().vermilion, lw=1.2, label="room")
    room.set_ylabel("room, °C")
    time_axis(room, observed.time, observed.experiment.start)
    for axes in grid[:, 0]:
        legend_beside(axes)
    return figure


def _draw_readings(axes: Axes, observed: Observed) -> None:
    """Draws the readings of the first channels as dots."""
    readings = np.asarray(observed.experiment.temperatures)[:, :MAX_CHANNELS]
    draw_lines(axes, observed.time, readings, ls="", marker=".", ms=1.5)
    axes.set(ylabel="channel, °C")
    axes.set_title(observed.experiment.name or "recording")


def _draw_bands(axes: Axes, observed: Observed, estimates: Mapping[str, Estimate]) -> None:
    """Draws the first of several estimates with their 95 % bands."""
    for number, (name, estimate) in enumerate(list(estimates.items())[:MAX_CHANNELS]):
        band = (estimate.mean, estimate.lower, estimate.upper)
        draw_band(axes, observed.time, band, color_of(number), lw=1.2, label=name)


def _draw_expected(axes: Axes, observed: Observed) -> None:
    """Draws the readings of the first channels, and what was expected of them as lines."""
    _draw_readings(axes, observed)
    expected = observed.expected.mean[:, :MAX_CHANNELS]
    draw_lines(axes, observed.time, expected, observed.channels[:MAX_CHANNELS], lw=0.8)
    legend_beside(axes)


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
    rows = list(dict.fromkeys((finding.kind, finding.channel) for finding in monitored.findings))
    rows = rows[:MAX_CHANNELS]
    height = 0.6 + 0.3 * max(len(rows), 1)
    ratios = (2.6, height, 1.6)
    figure, grid = panels(3, 1, 9.6, 4.8 + height, sharex=True, height_ratios=ratios)
    above, timeline, scores = grid[:, 0]
    _draw_expected(above, monitored.observed)
    if monitored.findings:
        (first, *others), *later = events(monitored.findings)
        more = len(others) + sum(map(len, later))
        title_aside(above, f"{first.detail}{f'; {more} more findings' if more else ''}")
    _draw_timeline(timeline, monitored, rows)
    _draw_scores(scores, monitored)
    time_axis(scores, monitored.time, monitored.observed.experiment.start)
    return figure


def _draw_timeline(axes: Axes, monitored: Monitored, rows: list[tuple[str, str]]) -> None:
    end = float(monitored.time[-1])
    for finding in monitored.findings:
        if (finding.kind, finding.channel) not in rows:
            continue
        row, since = rows.index((finding.kind, finding.channel)), float(finding.since or 0.0)
        until = end if finding.until is None else float(finding.until)
        look = {"color": color_of(KINDS.index(finding.kind)), "height": 0.55}
        axes.barh(row, until - since, left=since, alpha=1.0 if finding.is_alarm else 0.45, **look)
        axes.plot(float(finding.found or since), row, ".", ms=6, color=palette().ink, zorder=3)
    axes.set_yticks(range(len(rows)), [f"{kind} {channel or 'all'}" for kind, channel in rows])
    axes.set_ylim(max(len(rows), 1) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")
    if not rows:
        write_in_the_middle(axes, "nothing found")


def _draw_scores(axes: Axes, monitored: Monitored) -> None:
    for number, (label, tests) in enumerate(TESTS.items()):
        each = [getattr(monitored.evidences, test).score for test in tests]
        scores = np.concatenate(each, axis=1)
        if scores.shape[1]:  # else there is nothing to test
            largest = np.clip(scores.max(axis=1), 0.0, 2.0)
            axes.plot(monitored.time, largest, color=color_of(number), lw=1.0, label=label)
    axes.axhline(1.0, color=palette().ink, lw=0.8, ls=(0, (4, 3)))
    axes.set(ylabel="score", ylim=(0.0, 2.05))
    legend_beside(axes)


# A fault that is never likelier than this is among the others.
SEEN = 0.05


@styled
def plot_diagnosis(diagnosis: Diagnosis) -> Figure:
    """Plots what a diagnosis found.

    The panels are the readings with what was expected of them, and the probabilities over time,
    given the readings up to then, stacked; a dashed line is the onset of a cause.

    **Arguments:**

    - `diagnosis`: the result of `jaxtwin.diagnose`.

    **Returns:** the figure.
    """
    figure, grid = panels(2, 1, 9.6, 5.4, sharex=True, height_ratios=(1.4, 1.0))
    above, below = grid[:, 0]
    _draw_expected(above, diagnosis.observed)
    _draw_probabilities(below, diagnosis)
    for axes in (above, below):
        for cause in diagnosis.causes:
            axes.axvline(cause.onset, color=palette().ink, lw=0.8, ls=(0, (4, 3)))
    time_axis(below, diagnosis.time, diagnosis.experiment.start)
    return figure


def _draw_probabilities(axes: Axes, diagnosis: Diagnosis) -> None:
    columns = dict(zip(diagnosis.names, diagnosis.probabilities.T, strict=True))
    healthy, none = columns.pop(HEALTHY), columns.pop(NONE_OF_THESE)
    seen = [name for name in columns if columns[name].max() >= SEEN]
    likeliest = sorted(seen, key=lambda name: -columns[name].max())[:MAX_CHANNELS]
    shown = sorted(likeliest, key=lambda name: int(columns[name].argmax()))
    rest = [column for name, column in columns.items() if name not in shown]
    layers = [(HEALTHY, healthy, palette().faint)]
    layers += [(name, columns[name], color_of(place)) for place, name in enumerate(shown)]
    layers += [("other suspects", np.sum([0.0 * healthy, *rest], axis=0), palette().muted)]
    layers += [(NONE_OF_THESE, none, palette().ink)]
    labels, parts, colors = zip(*[row for row in layers if row[1].max() >= SEEN], strict=True)
    axes.stackplot(diagnosis.time, *parts, labels=labels, colors=colors, linewidth=0)
    axes.set(ylabel="probability", ylim=(0, 1))
    legend_beside(axes, reverse=True)


# The largest number of faults whose times are written into the matrix.
MAX_LABELLED_FAULTS = 24


@styled
def plot_isolability(isolability: Isolability) -> Figure:
    """Plots after what time faults are found and told apart.

    On the left is the time after which each fault of its usual size is found. A cell of the matrix
    is the time after which the fault of its row is told from that of its column, of any size. What
    stays empty does not happen within the duration.

    **Arguments:**

    - `isolability`: the result of `jaxtwin.isolability`.

    **Returns:** the figure.
    """
    names = isolability.names
    count = len(names)
    side = max(3.0, 0.34 * count if count <= MAX_LABELLED_FAULTS else 0.2 * count)
    figure, ((left, right),) = panels(
        1, 2, side + 3.6, side + 1.8, sharey=True, width_ratios=(1, max(count, 2))
    )
    scale = {
        "norm": LogNorm(1.0, max(isolability.duration, 2.0)),
        "cmap": colormaps["viridis_r"].with_extremes(bad=palette().faint),
    }
    for axes, times in ((left, isolability.detection[:, None]), (right, isolability.separation)):
        happens = np.isfinite(times)
        written = happens & (count <= MAX_LABELLED_FAULTS)
        shown = np.where(happens, np.maximum(times, 1.0), np.nan)
        image = draw_matrix(axes, shown, written, "{:.0f}".format, size=7, **scale)
    size = points(8 if count <= MAX_LABELLED_FAULTS else 6)
    left.set_yticks(range(count), names, fontsize=size)
    left.set_xticks([0], ["found"], rotation=90, fontsize=size)
    right.set_xticks(range(count), names, rotation=90, fontsize=size)
    title = f"{isolability.rig}, {len(isolability.channels)} channels"
    figure.suptitle(f"{title}: time until found, and until told apart, s")
    color_bar(right, image, fraction=0.03, pad=0.01)
    return figure
