"""Tests whether residuals are noise: over time, their autocorrelation, and their distribution."""

from collections.abc import Sequence

import numpy as np
from matplotlib import pyplot
from matplotlib.figure import Figure

from .._normal_distribution import QUANTILE_975, normal_quantiles
from .._residual_statistics import autocorrelation, ljung_box
from ..errors import SimulationError
from ..simulation import Run
from ._labels import label_ends
from ._samples import means_of_last_samples
from ._style import palette, points, styled

# The largest lag of the autocorrelation that is shown, samples.
MAX_LAG = 300

# The smallest number of samples of a channel for a test of whiteness.
MIN_SAMPLES = 10


@styled
def plot_residual_tests(runs: Sequence[Run]) -> Figure:
    """Plots the residuals of each recording over time, their autocorrelation, and their quantiles.

    Missing samples are gaps over time and left out of the tests.

    In the middle panel the grey band contains 95 % of the autocorrelations of white noise. In the
    right panel normal residuals lie on the line. The p-value is that of Ljung and Box's test, the
    smallest of all channels.

    **Arguments:**

    - `runs`: runs of experiments that have recorded temperatures, one row each; those of a
      validation are `list(validation.runs.values())`.

    **Returns:** the figure.

    **Raises:** `SimulationError` if a run has nothing recorded to compare with, or fewer than
    ten samples in a channel.
    """
    figure = pyplot.figure(figsize=(12.6, 0.4 + 2.6 * len(runs)), layout="constrained")
    grid = figure.subplots(len(runs), 3, squeeze=False, width_ratios=(1.7, 1.15, 1))
    for row, run in zip(grid, runs, strict=True):
        if run.experiment.temperatures is None:
            label = run.experiment.name or "the experiment"
            raise SimulationError(
                f"{label}: expected recorded temperatures to compare with, got none"
            )
        counts = np.count_nonzero(run.experiment.sampled, axis=0)
        if counts.min() < MIN_SAMPLES:
            label = run.experiment.name or "the experiment"
            raise SimulationError(
                f"{label}: channel {run.channels[int(counts.argmin())]}: expected at least "
                f"{MIN_SAMPLES} samples for a test, got {counts.min()}"
            )
        residuals = run.experiment.temperatures - run.temperatures
        for number, (channel, series) in enumerate(zip(run.channels, residuals.T, strict=True)):
            _draw(row, run, channel, series, palette().cycle[number % len(palette().cycle)])
        _finish(row, run, residuals)
    grid[0, 1].legend(loc="lower right")
    for axes, text in zip(grid[-1], ("time, s", "lag, s", "standard normal quantile"), strict=True):
        axes.set_xlabel(text)
    return figure


def _draw(row: np.ndarray, run: Run, channel: str, series: np.ndarray, color: str) -> None:
    over_time, against_itself, against_normal = row
    over_time.plot(run.time, series, color=color, lw=0.9)
    sample = float(np.median(np.diff(run.time)))
    lags = min(MAX_LAG, len(series) // 2)
    against_itself.plot(
        sample * np.arange(lags + 1), autocorrelation(series, lags), color=color, lw=1.2
    )
    there = series[~np.isnan(series)]
    standard_deviation = there.std() or 1.0
    against_normal.plot(
        normal_quantiles(len(there)), np.sort(there - there.mean()) / standard_deviation,
        color=color, lw=1.4, label=channel,
    )  # fmt: skip


def _finish(row: np.ndarray, run: Run, residuals: np.ndarray) -> None:
    over_time, against_itself, against_normal = row
    over_time.axhline(0.0, color=palette().muted, lw=0.8, zorder=0.5)
    over_time.set(ylabel="recorded − twin, K", xlim=(run.time[0], run.time[-1]))
    over_time.set_title(run.experiment.name or "recording")
    over_time.set_title(
        f"RMSE {run.rmse:.2f} K", loc="right", fontsize=points(9), fontweight="normal"
    )
    tail = means_of_last_samples(residuals, len(run.time) // 20)
    label_ends(
        over_time, list(zip(tail.tolist(), run.channels, palette().cycle * len(tail), strict=False))
    )
    band = QUANTILE_975 / np.sqrt(np.count_nonzero(run.experiment.sampled, axis=0).max())
    against_itself.axhspan(
        -band, band, color=palette().faint, zorder=0.4, label="95 % of white noise"
    )
    against_itself.axhline(0.0, color=palette().muted, lw=0.8, zorder=0.5)
    against_itself.set(ylabel="autocorrelation", ylim=(-1.05, 1.05))
    p = min(ljung_box(series).p_value for series in residuals.T)
    text = f"p = {p:.2g}" if p > 1e-99 else "p below 1e-99"
    against_itself.set_title(text, loc="right", fontsize=points(9), fontweight="normal")
    line = np.array([-3.3, 3.3])
    against_normal.plot(line, line, color=palette().ink, lw=0.8, ls=(0, (4, 3)), zorder=0.6)
    against_normal.set(ylabel="standardised residual")
