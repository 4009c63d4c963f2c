"""Recordings that were watched: findings of a monitor, the probabilities of a diagnosis, which
faults can be told apart, and the health of a rig over sessions.
"""

import numpy as np
from jaxtyping import Float
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .._number_text import short_number
from ..diagnosis import Diagnosis, Isolability
from ..diagnosis._diagnosis import HEALTHY, NONE_OF_THESE
from ..monitoring import Monitored
from ..monitoring._finding_log import events
from ..observers import Observed
from ..prognostics import Health, ParameterHealth
from ._bars import draw_estimates, draw_matrix, logarithmic_values
from ._panels import color_bar, legend_beside, legend_of_all, panels, panels_in_rows, title_aside
from ._series import joined_samples
from ._style import color_of, palette, points, styled, symbol, with_unit
from ._time_axis import time_axis

# The largest number of channels with a line of their own, of rows of findings, and of faults with a
# colour of their own.
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
    if monitored.findings:
        (first, *others), *later = events(monitored.findings)
        more = len(others) + sum(map(len, later))
        title_aside(grid[0], f"{first.detail}{f'; {more} more findings' if more else ''}")
    _timeline(grid[1], monitored, rows)
    _scores(grid[2], monitored)
    grid[2].set_xlim(monitored.time[0], monitored.time[-1])
    time_axis(grid[2], monitored.time, monitored.observed.experiment.start)
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
    legend_beside(axes)


def _largest(scores: Float[np.ndarray, "times members"]) -> Float[np.ndarray, " times"] | None:
    """The largest score at each time; None for a test that has nothing to test."""
    return scores.max(axis=1) if scores.shape[1] else None


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
    figure = pyplot.figure(figsize=(9.6, 5.4), layout="constrained")
    grid = figure.subplots(2, 1, sharex=True, height_ratios=(1.4, 1.0))
    draw_readings(grid[0], diagnosis.observed)
    _probabilities(grid[1], diagnosis)
    for axes in grid:
        for cause in diagnosis.causes:
            axes.axvline(cause.onset, color=palette().ink, lw=0.8, ls=(0, (4, 3)))
    grid[1].set_xlim(diagnosis.time[0], diagnosis.time[-1])
    time_axis(grid[1], diagnosis.time, diagnosis.experiment.start)
    return figure


def _probabilities(axes: Axes, diagnosis: Diagnosis) -> None:
    table = diagnosis.probabilities
    names = list(diagnosis.names)
    largest = table.max(axis=0)
    order = np.argsort(-largest)
    shown = [
        int(n) for n in order if names[n] not in (HEALTHY, NONE_OF_THESE) and largest[n] >= SEEN
    ]
    shown = sorted(shown[:MAX_CHANNELS], key=lambda n: int(table[:, n].argmax()))
    rest = [
        n for n, name in enumerate(names) if n not in shown and name not in (HEALTHY, NONE_OF_THESE)
    ]
    layers = [(HEALTHY, table[:, names.index(HEALTHY)], palette().faint)]
    layers += [(names[n], table[:, n], color_of(place)) for place, n in enumerate(shown)]
    layers += [
        ("other suspects", table[:, rest].sum(axis=1), palette().muted),
        (NONE_OF_THESE, table[:, names.index(NONE_OF_THESE)], palette().ink),
    ]
    kept = [layer for layer in layers if layer[1].max() >= SEEN]
    axes.stackplot(
        diagnosis.time,
        [row[1] for row in kept],
        colors=[row[2] for row in kept],
        labels=[row[0] for row in kept],
        linewidth=0,
    )
    axes.set(ylabel="probability", ylim=(0, 1))
    legend_beside(axes, reverse=True)


def draw_readings(axes: Axes, observed: Observed) -> None:
    """Draws the readings of the first channels as dots and what was expected as lines."""
    readings = np.asarray(observed.experiment.temperatures)
    for number, channel in enumerate(observed.channels[:MAX_CHANNELS]):
        color = color_of(number)
        axes.plot(*joined_samples(observed.time, readings[:, number]), ".", ms=1.5, color=color)
        expected = observed.expected.mean[:, number]
        axes.plot(observed.time, expected, color=color, lw=0.8, label=channel)
    axes.set(ylabel="channel, °C")
    axes.set_title(observed.experiment.name or "recording")
    legend_beside(axes)


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
        "cmap": pyplot.get_cmap("viridis_r").with_extremes(bad=palette().faint),
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


HEALTH_COLUMNS = 3

# The largest number of parameters; those with limits are first, then those that changed most.
MAX_PARAMETERS = 9


@styled
def plot_health(health: Health) -> Figure:
    """Plots parameters over sessions, a panel for each.

    A dot is what a session says by itself, with its 95 % interval. The line is the trend, with the
    95 % interval of the trend (dark) and of the value of a session (light); it goes on as far as
    limits are looked at. A dashed line is a limit.

    **Arguments:**

    - `health`: the result of `jaxtwin.health`.

    **Returns:** the figure.
    """
    rows = sorted(health.parameters.values(), key=lambda row: row.limit is None)[:MAX_PARAMETERS]
    figure, grid = panels_in_rows(len(rows), HEALTH_COLUMNS, (3.6, 2.3), (0.0, 1.0))
    for axes, row in zip(grid, rows, strict=True):
        _draw(axes, health, row)
    for axes in grid[-HEALTH_COLUMNS:]:
        axes.set_xlabel("session" if health.time_unit == "session" else "days")
    legend_of_all(figure, "outside upper right")
    return figure


def _draw(axes: Axes, health: Health, row: ParameterHealth) -> None:
    first, last = row.span
    ahead = health.within if health.probabilities else 0.0
    margin = 0.04 * (last - first + ahead)
    times = np.linspace(first - margin, last + ahead + margin, 200)
    value, lower, upper = row.at(times)
    _, low, high = row.sessions_at(times)
    ends = row.interval_of_sessions()
    draw_estimates(axes, health.times, row.values, ends, label="session, 95 %")
    axes.plot(times, value, color=palette().blue, label="trend")
    light = {"color": palette().sky, "alpha": 0.25, "label": "a session's value, 95 %"}
    axes.fill_between(times, low, high, lw=0, **light)
    dark = {"color": palette().blue, "alpha": 0.35, "label": "trend, 95 %"}
    axes.fill_between(times, lower, upper, lw=0, **dark)
    _choose_range(axes, row, ends)
    axes.set_title(with_unit(symbol(row.name), row.unit))
    note = f"{100 * row.change:+.2g} %" if row.is_logarithmic else f"{row.change:+.2g}"
    if ahead > 0:
        axes.axvline(last, color=palette().muted, lw=0.8)
    if row.limit is not None:
        axes.axhline(row.limit, color=palette().ink, ls="--", lw=1.2, gid="limit", label="limit")
        chance = 100 * row.probability_of_passing(health.within)
        unit = health.time_unit if health.within == 1 else f"{health.time_unit}s"
        note += f"; passes in {short_number(health.within, 3)} {unit}: {chance:.2g} %"
    title_aside(axes, note)
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))


def _choose_range(axes: Axes, row: ParameterHealth, ends: tuple[np.ndarray, np.ndarray]) -> None:
    """A range of values that the sessions fill: a session that knows little may reach out of it."""
    usual = row.errors <= 2 * np.nanmedian(row.errors)
    known = np.concatenate([row.values[np.isfinite(row.values)], *(end[usual] for end in ends)])
    if row.limit is not None:
        known = np.append(known, row.limit)
    if not row.is_logarithmic:
        room = 0.12 * np.ptp(known)
        axes.set_ylim(known.min() - room, known.max() + room)
        return
    room = np.exp(0.12 * np.log(known.max() / known.min()))
    axes.set_ylim(known.min() / room, known.max() * room)
    logarithmic_values(axes)
