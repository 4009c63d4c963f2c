"""The trial of a retuned controller."""

import numpy as np
from matplotlib import pyplot
from matplotlib.figure import Figure

from ..retuning import Retuned
from ._style import palette, styled


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
