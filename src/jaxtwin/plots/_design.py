"""A designed experiment: its schedule, and the expected standard errors."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..diagnosis import TIE
from ..experiment_design import DiagnosisDesign, ExperimentDesign
from ._layers import draw_duty
from ._panels import legend_below, panels, time_axis
from ._style import color_of, line_of, palette, styled, symbol

MARKERS = "os^vDP"


@styled
def plot_design(design: ExperimentDesign | DiagnosisDesign) -> Figure:
    """Plots the designed duty cycles over time, and beside them what they gain, for the design and
    the reference schedules: the standard errors that are predicted, relative to those of today; or
    for a diagnosis the odds between the two faults that are the hardest to tell apart, over time,
    and the odds of 20 at which they are told apart.

    **Arguments:**

    - `design`: the result of `jaxtwin.design_experiment`.

    **Returns:** the figure.
    """
    count = len(design.names) if isinstance(design, ExperimentDesign) else 0
    figure, ((schedule, gained),) = panels(1, 2, 10.0, max(3.2, 1.2 + 0.28 * count))
    _draw_schedule(schedule, design)
    if isinstance(design, ExperimentDesign):
        _draw_errors(gained, design)
    else:
        _draw_odds(gained, design)
    return figure


def _draw_odds(axes: Axes, design: DiagnosisDesign) -> None:
    for number, (planned, color, label) in enumerate(_schedules(design)):
        odds = np.maximum(planned.odds, 0.0)
        axes.plot(planned.time, odds, color=color, ls=line_of(number), label=label)
        if np.isfinite(planned.separation):
            at = int(np.searchsorted(planned.time, planned.separation))
            axes.plot(planned.time[at], odds[at], "o", color=color, ms=6)
    axes.axhline(np.log(TIE), color=palette().ink, lw=0.8, ls=(0, (4, 3)))
    axes.set_ylim(0, 3 * np.log(TIE))
    first, second = design.best.hardest
    axes.set(ylabel="logarithm of the odds", title=f"{first} or {second}?")
    time_axis(axes, design.schedule.time)
    legend_below(axes)


def _schedules(design: ExperimentDesign | DiagnosisDesign) -> list[tuple[Any, str, str]]:
    """The design and its references, each with its colour and its label."""
    planned = [design.best, *design.references.values()]
    colors = [palette().vermilion, *(color_of(number + 1) for number in range(1, len(planned)))]
    labels = [each.name + ("" if each.is_allowed else " (too hot)") for each in planned]
    return list(zip(planned, colors, labels, strict=True))


def _draw_schedule(axes: Axes, design: ExperimentDesign | DiagnosisDesign) -> None:
    planned = design.schedule
    draw_duty(axes, planned.time, planned.duty, planned.cell_names)
    axes.axhline(0, color=palette().muted, lw=0.8)
    axes.set_title("designed schedule")
    time_axis(axes, planned.time)
    if planned.n_cells > 1:
        legend_below(axes)


def _draw_errors(axes: Axes, design: ExperimentDesign) -> None:
    rows = np.arange(len(design.names))
    today = np.array([design.standard_errors[name] for name in design.names])
    known = np.isfinite(today)
    for number, (planned, color, label) in enumerate(_schedules(design)):
        errors = np.array([planned.standard_errors[name] for name in design.names])
        relative = np.full(len(rows), np.nan)
        relative[known] = 100 * errors[known] / today[known]
        look = {"color": color, "label": label, "zorder": 2 if number else 3}
        face = {"mfc": "none"} if number else {}
        axes.plot(relative, rows, MARKERS[number % len(MARKERS)], **face, **look)
    axes.axvline(100, color=palette().muted, lw=0.8)
    axes.set_xlim(0, None)
    names = [
        symbol(name) if there else f"{symbol(name)} (unknown today)"
        for name, there in zip(design.names, known, strict=True)
    ]
    axes.set_yticks(rows, names)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set(xlabel="standard error, % of today's", title="what is gained")
    legend_below(axes)
