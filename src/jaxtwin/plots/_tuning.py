"""The course of the tuning of a controller, and its result."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ..control import Tuning
from ._style import palette, points, styled


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
        color = palette().cycle[start % len(palette().cycle)]
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
        axes.set_title(
            f"$M_s$ at most {limit:g}", loc="right", fontsize=points(9), color=palette().muted
        )


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
