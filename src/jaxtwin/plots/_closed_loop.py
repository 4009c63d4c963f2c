"""Closed loops: a run, the course of the tuning of a controller, the trial of a retuned one, and
the trade between two aims.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ..control import MEASURES, ClosedLoopRun, Frontier, OperatingPoint, Tuning
from ..errors import ControlError
from ..retuning import Retuned
from ._panels import ABOVE_RIGHT, panels, title_aside, write
from ._style import color_of, line_of, palette, points, rim, styled, unit_text
from ._time_axis import time_axis

# The largest number of channels of an output that are named one by one.
MAX_NAMED = 3


@styled
def plot_closed_loop(run: ClosedLoopRun) -> Figure:
    """Plots the outputs beside their references, the plate's range, the duty of the cells and their
    power.

    **Arguments:**

    - `run`: the result of `simulate_closed_loop`.

    **Returns:** the figure.
    """
    figure = pyplot.figure(figsize=(7.2, 6.4), layout="constrained")
    above, duty, power = figure.subplots(3, 1, sharex=True, height_ratios=(4, 1.4, 1.4))
    time, plate = run.time, np.asarray(run.loop.plate)
    if run.loop.elements:
        above.fill_between(
            time,
            plate.min(axis=1),
            plate.max(axis=1),
            color=palette().faint,
            lw=0,
            label="plate, all elements",
        )
    references = np.unique(run.reference, axis=1).T
    for number, reference in enumerate(references):
        label = "reference" if number == 0 else None
        above.step(
            time, reference, where="post", color=palette().muted, ls="--", lw=1.2, label=label
        )
    for number, (name, output) in enumerate(zip(run.outputs, run.output.T, strict=True)):
        above.plot(time, output, color=color_of(number), label=_short(name))
    above.set_ylabel("temperature, °C")
    # Legends are above the axes, because curves would cross them inside.
    above_right = {"loc": "lower right", "bbox_to_anchor": (1, 1), "borderaxespad": 0.1}
    is_long = any(len(_short(name)) > 20 for name in run.outputs)
    above.legend(ncols=2 if is_long else 4, **above_right)
    names = run.run.experiment.cell_names
    for number, (part, watts) in enumerate(zip(run.duty.T, run.power.T, strict=True)):
        color = color_of(number)
        look = {"color": color, "lw": 1.4, "ls": line_of(number)}
        duty.step(time, 100 * part, where="post", label=names[number], **look)
        power.plot(time, watts, **look)
    duty.legend(ncols=len(run.duty.T), **above_right)
    duty.set_ylabel("duty, %")
    if len(run.power.T) > 1:
        power.plot(time, run.power.sum(axis=1), color=palette().ink, lw=1.2, label="all cells")
        power.legend(**above_right)
    power.set_ylabel("power, W")
    time_axis(power, time)
    power.set_xlim(time[0], time[-1])
    return figure


def _short(output: str) -> str:
    """The name of an output that is a mean of many channels, for a legend."""
    names = output.split()
    if len(names) <= MAX_NAMED:
        return output
    return f"mean of {names[0]}, {names[1]} and {len(names) - 2} more"


@styled
def plot_plate_range(
    runs: Mapping[str, ClosedLoopRun], best: OperatingPoint | None = None
) -> Figure:
    """Plots the mean of the channels and the range of the plate, the difference between its hottest
    and its coldest element, over time.

    **Arguments:**

    - `runs`: name -> closed loop of a rig with a plate.
    - `best`: the most even steady state (`most_even_point`), whose range is a line.

    **Returns:** the figure.

    **Raises:** `ControlError` if there is no run, or one is of a rig without a plate.
    """
    if not runs:
        raise ControlError("plot_plate_range: runs: expected at least one closed loop, got none")
    figure, ((above,), (below,)) = panels(2, 1, 7.2, 4.8, sharex=True, height_ratios=(1, 1.3))
    for number, (name, run) in enumerate(runs.items()):
        look = {"color": color_of(number), "ls": line_of(number), "lw": 1.6}
        above.plot(run.time, run.run.temperatures.mean(axis=1), label=name, **look)
        below.plot(run.time, run.range, **look)
    last = max(float(run.time[-1]) for run in runs.values())
    if best is not None:
        elements = next(iter(runs.values())).loop.elements
        least = float(np.ptp(np.asarray(best.nodes)[:elements]))
        below.axhline(least, color=palette().muted, ls=":", lw=1.2)
        text = f"most even at rest, {least:.1f} K"
        write(below, text, (last, least), (-2, -3), size=10, va="top", ha="right")
    above.legend(ncols=3, **ABOVE_RIGHT)
    above.set_ylabel("mean of the\nchannels, °C")
    below.set_ylabel("range of the plate, K")
    time_axis(below, np.array([0.0, last]))
    below.set_ylim(bottom=0)
    return figure


@styled
def plot_tuning(tuning: Tuning) -> Figure:
    """Plots the objective over the rounds, the sensitivity over frequency, and the measures.

    In the first panel each line is a descent; controllers that were evaluated and rejected are open
    dots. The band in the second panel contains all draws of the plant. The third panel shows the
    measures relative to their median before the tuning: a dot is the median over the draws, a bar
    extends from 5 to 95 % of them, and bold names have a weight in the objective.

    **Arguments:**

    - `tuning`: the result of `jaxtwin.tune`.

    **Returns:** the figure.
    """
    panels = 2 if tuning.sensitivity_limit is None else 3
    figure = pyplot.figure(figsize=(1.5 + 3.9 * panels, 4.2), layout="constrained")
    rounds, *middle, measures = figure.subplots(1, panels)
    _draw_rounds(rounds, tuning)
    if middle:
        _draw_sensitivity(middle[0], tuning)
    _draw_measures(measures, tuning)
    return figure


def _draw_rounds(axes: Axes, tuning: Tuning) -> None:
    limit = tuning.sensitivity_limit
    shown = []
    for start in sorted({step.start for step in tuning.history}):
        steps = [s for s in tuning.history if s.start == start and np.isfinite(s.objective)]
        if not steps:
            continue
        color = color_of(start)
        taken = [step for step in steps if step.accepted]
        label = "given controller" if start == 0 else f"random start {start}"
        values = [step.objective for step in taken]
        axes.plot(
            [step.round for step in taken], values, color=color, label=label, marker="o", ms=3
        )
        shown += values
        refused = [step for step in steps if not step.accepted]
        axes.plot(
            [step.round for step in refused], [step.objective for step in refused], "o", mfc="none",
            mec=color, ms=4, alpha=0.6,
        )  # fmt: skip
    best = tuning.after.objective
    axes.axhline(best, color=palette().muted, lw=0.8, ls="--")
    if shown:
        top = max(np.quantile(shown, 0.9), tuning.before.objective)
        room = 0.08 * (top - best) or 0.05 * abs(best)
        if np.isfinite(top):
            axes.set_ylim(min(best, min(shown)) - room, top + room)
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes.set(xlabel="round", ylabel="objective", title="descents")
    axes.legend(loc="upper right")
    if limit is not None:
        title_aside(axes, f"$M_s$ at most {limit:g}")


def _draw_sensitivity(axes: Axes, tuning: Tuning) -> None:
    for loop, color, label in (
        (tuning.before, palette().blue, "before"),
        (tuning.after, palette().vermilion, "after"),
    ):
        low, high = loop.sensitivity.min(axis=0), loop.sensitivity.max(axis=0)
        axes.fill_between(tuning.omega, low, high, color=color, alpha=0.2, lw=0)
        axes.loglog(tuning.omega, np.median(loop.sensitivity, axis=0), color=color, label=label)
    limit = tuning.sensitivity_limit
    assert limit is not None
    axes.axhline(limit, color=palette().muted, lw=1.0, ls="--", label="limit")
    highest = max(loop.sensitivity.max() for loop in (tuning.before, tuning.after))
    axes.set_ylim(0.01, max(3.0, 1.5 * highest))
    axes.set_xlim(tuning.omega[0], tuning.omega[-1])
    axes.set(xlabel="frequency, rad/s", ylabel="sensitivity", title="linearised loop")
    axes.legend(loc="lower right")


def _draw_measures(axes: Axes, tuning: Tuning) -> None:
    names, largest = [], 1.0
    for number, name in enumerate(tuning.measures):
        before, after = (loop.measures[:, number] for loop in (tuning.before, tuning.after))
        middle = float(np.median(before))
        if not (np.isfinite(before).all() and np.isfinite(after).all()) or abs(middle) < 1e-9:
            continue
        row = len(names)
        names.append((name, tuning.weights[number] != 0))
        for values, color, shift in (
            (before, palette().blue, -0.13),
            (after, palette().vermilion, 0.13),
        ):
            low, median, high = np.quantile(values / middle, [0.05, 0.5, 0.95])
            largest = max(largest, high)
            axes.plot([low, high], [row + shift] * 2, color=color, lw=2, alpha=0.6)
            axes.plot([median], [row + shift], "o", color=color, ms=4)
    axes.axvline(1, color=palette().muted, lw=0.8)
    if largest > 10:  # of an overshoot that was nearly nothing, say
        axes.set_xscale("log")
    axes.set_yticks(range(len(names)), [name.replace("_", " ") for name, _ in names])
    for label, (_, counts) in zip(axes.get_yticklabels(), names, strict=True):
        label.set_fontweight("bold" if counts else "normal")
    axes.invert_yaxis()
    axes.set(xlabel="relative to the median before", title="measures")


# The part of the range of a panel within which dots cover each other.
OVERLAP_FRACTION = 0.02


@styled
def plot_frontier(frontier: Frontier, measure: str, beside: Sequence[str]) -> Figure:
    """Plots a measure over other measures, with a panel for each.

    A dot is the median over the draws of the plant, and its bars extend from 5 to 95 % of the
    draws. The numbers are the weights; dots that cover each other share a text. A thin line joins
    the dots in their order. A hollow dot is not on the frontier of its panel: another
    controller is better in both measures. A controller with a median that is not finite, such as
    the settling time of a loop that never settles, is left out.

    **Arguments:**

    - `frontier`: the result of `jaxtwin.control.frontier`.
    - `measure`: the measure on the vertical axis.
    - `beside`: the measures on the horizontal axes.

    **Returns:** the figure.

    **Raises:** `ControlError` for an unknown measure.
    """
    figure = pyplot.figure(figsize=(1 + 4.4 * len(beside), 4.2), layout="constrained")
    panels = figure.subplots(1, len(beside), sharey=True, squeeze=False)[0]
    y = _quantiles(frontier, measure)
    for axes, name in zip(panels, beside, strict=True):
        x = _quantiles(frontier, name)
        is_shown = np.isfinite(x[1]) & np.isfinite(y[1])
        order = np.flatnonzero(is_shown)[np.argsort(x[1][is_shown])]
        best = [
            point
            for point in order
            if not np.any((x[1][order] < x[1][point]) & (y[1][order] < y[1][point]))
        ]
        axes.plot(x[1][is_shown], y[1][is_shown], color=palette().faint, lw=1.2)
        axes.plot(x[1][best], y[1][best], color=palette().blue, lw=1.2)
        for point in order:
            axes.plot(x[[0, 2], point], [y[1, point]] * 2, color=palette().blue, lw=1, alpha=0.5)
            axes.plot([x[1, point]] * 2, y[[0, 2], point], color=palette().blue, lw=1, alpha=0.5)
            fill = palette().blue if point in best else "none"
            axes.plot(x[1, point], y[1, point], "o", mfc=fill, mec=palette().blue, ms=5)
        for together in _neighbours(x[1], y[1], order):
            axes.annotate(
                ", ".join(f"{weight:g}" for weight in sorted(frontier.weights[together])),
                (x[1, together[0]], y[1, together[0]]), (5, 5),
                textcoords="offset points", fontsize=points(8), color=palette().muted,
                path_effects=rim(),
            )  # fmt: skip
        axes.margins(x=0.1)
        axes.set_xlabel(_label(name))
    panels[0].set_ylabel(_label(measure))
    unit = unit_text(MEASURES[frontier.against][1])
    unit = f"({unit})" if " " in unit else unit
    panels[0].set_title(
        f"weight of {frontier.against.replace('_', ' ')}" + (f", 1/{unit}" if unit else "")
    )
    return figure


def _quantiles(frontier: Frontier, name: str) -> Float[np.ndarray, "3 points"]:
    """The 5, 50 and 95 % quantiles over the draws; NaN between infinite values."""
    with np.errstate(invalid="ignore"):
        return np.quantile(frontier.measure(name), [0.05, 0.5, 0.95], axis=1)


def _neighbours(
    x: Float[np.ndarray, " points"], y: Float[np.ndarray, " points"], order: Int[np.ndarray, " n"]
) -> list[list[int]]:
    """Groups of points whose dots cover each other, so that their numbers share a text."""
    near = [OVERLAP_FRACTION * np.ptp(values[order]) if len(order) else 0.0 for values in (x, y)]
    groups: list[list[int]] = []
    for point in order:
        for group in groups:
            first = group[0]
            if abs(x[point] - x[first]) <= near[0] and abs(y[point] - y[first]) <= near[1]:
                group.append(int(point))
                break
        else:
            groups.append([int(point)])
    return groups


def _label(name: str) -> str:
    unit = unit_text(MEASURES[name][1])
    return name.replace("_", " ") + (f", {unit}" if unit else "")


@styled
def plot_retuned(retuned: Retuned) -> Figure:
    """Plots the cost of the candidate in each scenario, beside that of the present controller.

    Scenarios in which the candidate failed have open dots and bold names.

    **Arguments:**

    - `retuned`: the result of `jaxtwin.retune`.

    **Returns:** the figure.
    """
    tried = [trial for trial in retuned.trials if np.isfinite(trial.present.cost)]
    figure = pyplot.figure(figsize=(6.0, 1.4 + 0.26 * len(tried)), layout="constrained")
    axes = figure.subplots()
    for row, trial in enumerate(tried):
        costs = trial.present.cost, trial.candidate.cost
        color = palette().vermilion
        face = color if trial.passed else "none"
        axes.plot(costs, [row, row], color=palette().muted, lw=1.0)
        axes.plot(costs[:1], [row], "o", color=palette().blue, ms=5)
        axes.plot(costs[1:], [row], "o", mfc=face, mec=color, ms=5)
    axes.plot([], [], "o", color=palette().blue, label="present controller")
    axes.plot([], [], "o", color=palette().vermilion, label="candidate")
    axes.set_yticks(range(len(tried)), [trial.scenario.name for trial in tried])
    for label, trial in zip(axes.get_yticklabels(), tried, strict=True):
        label.set_fontweight("normal" if trial.passed else "bold")
    axes.invert_yaxis()
    axes.set(xlabel="cost", title=f"trial: {retuned.decision}")
    axes.legend(loc="best")
    return figure
