"""A designed experiment: its schedule, and the expected standard errors."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..experiment_design import ExperimentDesign
from ._style import palette, styled, symbol

MARKERS = "os^vDP"


@styled
def plot_design(design: ExperimentDesign) -> Figure:
    """Plots the designed duty cycles over time, and the standard errors that are predicted for the
    design and for the reference schedules, relative to those of today.

    **Arguments:**

    - `design`: the result of `jaxtwin.design_experiment`.

    **Returns:** the figure.
    """
    height = max(3.2, 1.2 + 0.28 * len(design.names))
    figure = pyplot.figure(figsize=(10.0, height), layout="constrained")
    schedule, errors = figure.subplots(1, 2)
    _draw_schedule(schedule, design)
    _draw_errors(errors, design)
    return figure


def _draw_schedule(axes: Axes, design: ExperimentDesign) -> None:
    planned = design.schedule
    for cell in range(planned.n_cells):
        axes.step(
            planned.time,
            planned.duty[:, cell],
            where="post",
            color=palette().cycle[cell % len(palette().cycle)],
            ls="-" if cell == 0 else "--",
            label=f"P{cell + 1}",
        )
    axes.axhline(0, color=palette().muted, lw=0.8)
    axes.set(xlabel="time, s", ylabel="duty cycle", title="designed schedule")
    if planned.n_cells > 1:
        axes.legend(loc="best")


def _draw_errors(axes: Axes, design: ExperimentDesign) -> None:
    rows = np.arange(len(design.names))
    today = np.array([design.standard_errors[name] for name in design.names])
    known = np.isfinite(today)
    schedules = [design.best, *design.references.values()]
    for number, planned in enumerate(schedules):
        errors = np.array([planned.standard_errors[name] for name in design.names])
        relative = np.full(len(rows), np.nan)
        relative[known] = 100 * errors[known] / today[known]
        label = planned.name + ("" if planned.is_allowed else " (too hot)")
        axes.plot(
            relative,
            rows,
            MARKERS[number % len(MARKERS)],
            color=palette().vermilion
            if number == 0
            else palette().cycle[(number + 1) % len(palette().cycle)],
            mfc=None if number == 0 else "none",
            label=label,
            zorder=3 if number == 0 else 2,
        )
    axes.axvline(100, color=palette().muted, lw=0.8)
    axes.set_xlim(0, None)
    names = [
        symbol(name) if there else f"{symbol(name)} (unknown today)"
        for name, there in zip(design.names, known, strict=True)
    ]
    axes.set_yticks(rows, names)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set(xlabel="standard error, % of today's", title="what is gained")
    axes.legend(loc="best")
