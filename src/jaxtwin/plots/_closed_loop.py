"""Closed loops: a run, the evenness of the plate, the course of the tuning of a controller, the
trial of a retuned one, and the trade between two aims.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ..control import MEASURES, ClosedLoopRun, Frontier, OperatingPoint, Tuning
from ..errors import ControlError
from ..retuning import Retuned
from ._layers import draw_band, draw_duty, draw_lines, name_rows
from ._panels import ABOVE_RIGHT, panels, time_axis, title_aside, write
from ._style import color_of, line_of, palette, rim, styled, unit_text, with_unit

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
    figure, grid = panels(3, 1, 7.2, 6.4, sharex=True, height_ratios=(4, 1.4, 1.4))
    above, duty, power = grid[:, 0]
    if run.loop.elements:
        plate = np.asarray(run.loop.plate)
        look = {"color": palette().faint, "lw": 0, "label": "plate, all elements"}
        above.fill_between(run.time, plate.min(axis=1), plate.max(axis=1), **look)
    look = {"where": "post", "color": palette().muted, "ls": "--", "lw": 1.2}
    for number, reference in enumerate(np.unique(run.reference, axis=1).T):
        above.step(run.time, reference, label=None if number else "reference", **look)
    names = [_short(name) for name in run.outputs]
    draw_lines(above, run.time, run.output, names)
    above.set_ylabel("temperature, °C")
    above.legend(ncols=2 if any(len(name) > 20 for name in names) else 4, **ABOVE_RIGHT)
    draw_duty(duty, run.time, run.duty, run.run.experiment.cell_names)
    duty.legend(ncols=len(run.duty.T), **ABOVE_RIGHT)
    for number, watts in enumerate(run.power.T):
        power.plot(run.time, watts, color=color_of(number), lw=1.4, ls=line_of(number))
    if len(run.power.T) > 1:
        look = {"color": palette().ink, "lw": 1.2, "label": "all cells"}
        power.plot(run.time, run.power.sum(axis=1), **look)
        power.legend(**ABOVE_RIGHT)
    power.set_ylabel("power, W")
    time_axis(power, run.time)
    return figure


def _short(output: str) -> str:
    """The name of an output that is a mean of many channels, for a legend."""
    names = output.split()
    if len(names) <= MAX_NAMED:
        return output
    return f"mean of {names[0]}, {names[1]} and {len(names) - 2} more"


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
    count = 2 if tuning.sensitivity_limit is None else 3
    figure, ((rounds, *middle, measures),) = panels(1, count, 1.5 + 3.9 * count, 4.2)
    _draw_rounds(rounds, tuning)
    for axes in middle:
        _draw_sensitivity(axes, tuning)
    _draw_measures(measures, tuning)
    return figure


def _draw_rounds(axes: Axes, tuning: Tuning) -> None:
    shown = []
    for start in sorted({step.start for step in tuning.history}):
        steps = [s for s in tuning.history if s.start == start and np.isfinite(s.objective)]
        taken = {step.round: step.objective for step in steps if step.accepted}
        refused = {step.round: step.objective for step in steps if not step.accepted}
        label = "given controller" if start == 0 else f"random start {start}"
        color = color_of(start)
        if steps:
            axes.plot(list(taken), list(taken.values()), "o-", ms=3, color=color, label=label)
        hollow = {"mfc": "none", "ms": 4, "alpha": 0.6}
        axes.plot(list(refused), list(refused.values()), "o", color=color, **hollow)
        shown += taken.values()
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
    if tuning.sensitivity_limit is not None:
        title_aside(axes, f"$M_s$ at most {tuning.sensitivity_limit:g}")


def _draw_sensitivity(axes: Axes, tuning: Tuning) -> None:
    for loop, color, label in (
        (tuning.before, palette().blue, "before"),
        (tuning.after, palette().vermilion, "after"),
    ):
        low, middle, high = np.quantile(loop.sensitivity, [0.0, 0.5, 1.0], axis=0)
        draw_band(axes, tuning.omega, (middle, low, high), color, label=label)
    limit = tuning.sensitivity_limit
    assert limit is not None
    axes.axhline(limit, color=palette().muted, lw=1.0, ls="--", label="limit")
    highest = max(loop.sensitivity.max() for loop in (tuning.before, tuning.after))
    axes.set(xscale="log", xlim=(tuning.omega[0], tuning.omega[-1]))
    axes.set(yscale="log", ylim=(0.01, max(3.0, 1.5 * highest)))
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
        names.append((name.replace("_", " "), bool(tuning.weights[number])))
        for values, color, place in (
            (before, palette().blue, row - 0.13),
            (after, palette().vermilion, row + 0.13),
        ):
            low, median, high = np.quantile(values / middle, [0.05, 0.5, 0.95])
            largest = max(largest, high)
            axes.plot([low, high], [place, place], color=color, lw=2, alpha=0.6)
            axes.plot([median], [place], "o", color=color, ms=4)
    axes.axvline(1, color=palette().muted, lw=0.8)
    if largest > 10:  # of an overshoot that was nearly nothing, say
        axes.set_xscale("log")
    name_rows(axes, names)
    axes.set(xlabel="relative to the median before", title="measures")


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
    figure, (row,) = panels(1, len(beside), 1 + 4.4 * len(beside), 4.2, sharey=True)
    y = _quantiles(frontier, measure)
    for axes, name in zip(row, beside, strict=True):
        _draw_trade(axes, _quantiles(frontier, name), y, frontier.weights)
        axes.set_xlabel(_label(name))
    row[0].set_ylabel(_label(measure))
    unit = unit_text(MEASURES[frontier.against][1])
    unit = f"({unit})" if " " in unit else unit
    weight = f"weight of {frontier.against.replace('_', ' ')}"
    row[0].set_title(f"{weight}, 1/{unit}" if unit else weight)
    return figure


def _draw_trade(
    axes: Axes,
    x: Float[np.ndarray, "3 points"],
    y: Float[np.ndarray, "3 points"],
    weights: Float[np.ndarray, " points"],
) -> None:
    """Draws two measures of several controllers, of which it finds those on the frontier."""
    is_shown = np.isfinite(x[1]) & np.isfinite(y[1])
    order = np.flatnonzero(is_shown)[np.argsort(x[1][is_shown])]
    best = [
        point
        for point in order
        if not np.any((x[1][order] < x[1][point]) & (y[1][order] < y[1][point]))
    ]
    color = palette().blue
    axes.plot(x[1][is_shown], y[1][is_shown], color=palette().faint, lw=1.2)
    axes.plot(x[1][best], y[1][best], color=color, lw=1.2)
    for point in order:
        axes.plot(x[[0, 2], point], y[[1, 1], point], color=color, lw=1, alpha=0.5)
        axes.plot(x[[1, 1], point], y[[0, 2], point], color=color, lw=1, alpha=0.5)
        fill = color if point in best else "none"
        axes.plot(x[1, point], y[1, point], "o", mfc=fill, mec=color, ms=5)
    for together in _neighbours(x[1], y[1], order):
        text = ", ".join(f"{weight:g}" for weight in sorted(weights[together]))
        first = (x[1, together[0]], y[1, together[0]])
        write(axes, text, first, (5, 5), size=8, path_effects=rim())
    axes.margins(x=0.1)


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
    return with_unit(name.replace("_", " "), MEASURES[name][1])


@styled
def plot_retuned(retuned: Retuned) -> Figure:
    """Plots the cost of the candidate in each scenario, beside that of the present controller.

    Scenarios in which the candidate failed have open dots and bold names.

    **Arguments:**

    - `retuned`: the result of `jaxtwin.retune`.

    **Returns:** the figure.
    """
    tried = [trial for trial in retuned.trials if np.isfinite(trial.present.cost)]
    figure, ((axes,),) = panels(1, 1, 6.0, 1.4 + 0.26 * len(tried))
    for row, trial in enumerate(tried):
        costs = trial.present.cost, trial.candidate.cost
        face = palette().vermilion if trial.passed else "none"
        axes.plot(costs, [row, row], color=palette().muted, lw=1.0)
        axes.plot(costs[:1], [row], "o", color=palette().blue, ms=5)
        axes.plot(costs[1:], [row], "o", mfc=face, mec=palette().vermilion, ms=5)
    axes.plot([], [], "o", color=palette().blue, label="present controller")
    axes.plot([], [], "o", color=palette().vermilion, label="candidate")
    name_rows(axes, [(trial.scenario.name, not trial.passed) for trial in tried])
    axes.set(xlabel="cost", title=f"trial: {retuned.decision}")
    axes.legend(loc="best")
    return figure
