"""What is left over beside a twin: the residuals of recordings, whether they are noise, and the
error that all channels share; and the tests of an observer's innovations.
"""

from collections.abc import Callable, Sequence
from itertools import zip_longest

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._statistics import (
    QUANTILE_975,
    autocorrelation,
    ljung_box,
    normal_quantiles,
    partial_autocorrelation,
)
from ..errors import JaxtwinError, ObserverError, SimulationError
from ..matching import Fit
from ..observers import Observed
from ..simulation import Run
from ._layers import common_start, draw_lines, label_channels, recorded_temperatures, shade_masked
from ._panels import legend_of_all, panels, time_axis, title_aside
from ._style import color_of, palette, points, styled


@styled
def plot_residuals(
    runs: Sequence[Run], *, weights: Sequence[Float[np.ndarray, "_ _"]] = ()
) -> Figure:
    """Plots recorded minus simulated temperature of every channel, and their mean.

    An error that all channels share comes from the camera or the ambient; an error of a single
    channel comes from its place on the plate. Missing samples are gaps.

    **Arguments:**

    - `runs`: runs of experiments that have recorded temperatures, one column each.
    - `weights`: the weights of each run's samples in a match, `(times, channels)`, 0 to 1, such as
      `list(fit.weights.values())`: spans with a lower weight are shaded.

    **Returns:** the figure.

    **Raises:** `SimulationError` if a run has nothing recorded to compare with.
    """
    figure, (row,) = panels(1, len(runs), 0.9 + 3.7 * len(runs), 3.4, sharey=True)
    mean = {"color": palette().ink, "lw": 2.0, "label": "mean of the channels"}
    for axes, run, weight in zip_longest(row, runs, weights):
        if weight is not None:
            shade_masked(axes, run, weight)
        residuals = recorded_temperatures(run) - run.temperatures
        draw_lines(axes, run.time, residuals, lw=0.9)
        axes.plot(run.time, _mean_of_channels(residuals), **mean)
        _entitle(axes, run.experiment.name or "recording", f"RMSE {run.rmse:.2f} K")
        time_axis(axes, run.time, common_start(runs))
    row[0].set_ylabel("recorded − twin, K")
    for axes, run in zip(row, runs, strict=True):
        residuals = recorded_temperatures(run) - run.temperatures
        label_channels(axes, run.channels, residuals, part=20, spacing=0.08)
    legend_of_all(figure, "outside lower right")
    return figure


@styled
def plot_camera_error(fit: Fit) -> Figure:
    """Plots the mean residual of each recording's channels with and without the camera's error.

    The upper panel shows the mean of recorded minus simulated temperatures, and in colour the error
    that the match attributes to the camera; ticks mark its flat-field corrections. The lower panel
    shows the difference of the two, which remains for the plate. Shaded spans had a lower weight in
    the match.

    **Arguments:**

    - `fit`: the result of `jaxtwin.match`.

    **Returns:** the figure.
    """
    columns = len(fit.runs)
    figure, grid = panels(2, columns, 0.9 + 3.9 * columns, 4.6, sharex="col", sharey=True)
    for (above, below), (name, run) in zip(grid.T, fit.runs.items(), strict=True):
        camera = fit.camera[name]
        shared = _mean_of_channels(recorded_temperatures(run) - run.temperatures)
        left = shared - camera.offset
        above.plot(run.time, shared, color=palette().muted, lw=1.0, label="mean of the channels")
        offset = {"color": palette().vermilion, "lw": 1.6, "label": "given to the camera"}
        above.plot(run.time, camera.offset, **offset)
        below.plot(run.time, left, color=palette().ink, lw=1.0, label="left for the plate")
        for axes, series, title in ((above, shared, name), (below, left, "")):
            shade_masked(axes, run, fit.weights[name])
            _entitle(axes, title, f"{float(np.sqrt(np.nanmean(series**2))):.2f} K rms")
        if camera.events:
            # The ticks are at the upper edge: lines through the whole panel would hide the jumps.
            above.plot(
                camera.events, np.full(len(camera.events), 0.97), "v", color=palette().orange, ms=5,
                transform=above.get_xaxis_transform(), clip_on=False, label="its corrections",
            )  # fmt: skip
        time_axis(below, run.time, run.experiment.start)
    grid[0, 0].set_ylabel("recorded − twin, K")
    grid[1, 0].set_ylabel("without camera, K")
    legend_of_all(figure)
    return figure


# The largest lag of the autocorrelation of residuals that is shown, samples.
MAX_LAG = 300

# The smallest number of samples of a channel for a test of its residuals.
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
    size = (12.6, 0.4 + 2.6 * len(runs))
    figure, grid = panels(len(runs), 3, *size, width_ratios=(1.7, 1.15, 1))
    for (over_time, against_itself, against_normal), run in zip(grid, runs, strict=True):
        residuals = recorded_temperatures(run) - run.temperatures
        label = run.experiment.name or "the experiment"
        _check_counts(label, run.channels, residuals, MIN_SAMPLES, "samples", SimulationError)
        draw_lines(over_time, run.time, residuals, lw=0.9)
        sample = float(np.median(np.diff(run.time)))
        lags = np.arange(min(MAX_LAG, len(run.time) // 2) + 1)
        _draw_correlations(against_itself, residuals, lags, autocorrelation, sample)
        _draw_quantiles(against_normal, run.channels, [_standardised(s) for s in residuals.T])
        _entitle(over_time, run.experiment.name or "recording", f"RMSE {run.rmse:.2f} K")
        over_time.set_ylabel("recorded − twin, K")
        time_axis(over_time, run.time, run.experiment.start)
        label_channels(over_time, run.channels, residuals, part=20)
        against_itself.set(ylabel="autocorrelation", ylim=(-1.05, 1.05))
        p = min(ljung_box(series).p_value for series in residuals.T)
        title_aside(against_itself, f"p = {p:.2g}" if p > 1e-99 else "p below 1e-99")
        against_normal.set(ylabel="standardised residual")
    grid[0, 1].legend(loc="lower right")
    grid[-1, 1].set_xlabel("lag, s")
    grid[-1, 2].set_xlabel("normal quantile")
    return figure


# The largest lag of the autocorrelations of innovations, samples.
INNOVATION_LAGS = 40

# The smallest number of readings of a channel for a test of its innovations.
MIN_READINGS = 50

# The times ahead at which forecasts are judged, samples.
LEADS = (1, 2, 5, 10, 20, 50, 100, 200, 500)


@styled
def plot_innovations(observed: Observed) -> Figure:
    """Plots the tests of an observer's innovations.

    Standardised innovations of a right model are independent and normal: their quantiles lie on the
    line, and 95 % of their autocorrelations and partial autocorrelations in the grey band. The last
    panel has the root mean square error of forecasts over the time ahead beside the one that the
    observer expects; it matters most, since innovations can be white while forecasts are bad.

    **Arguments:**

    - `observed`: the result of `jaxtwin.observe`.

    **Returns:** the figure.

    **Raises:** `ObserverError` if a channel has fewer than 50 readings.
    """
    series, label = observed.standardised, observed.experiment.name or "experiment"
    _check_counts(label, observed.channels, series, MIN_READINGS, "readings", ObserverError)
    figure, ((quantiles, itself), (partial, ahead)) = panels(2, 2, 11.0, 6.4)
    _draw_quantiles(quantiles, observed.channels, [s[np.isfinite(s)] for s in series.T])
    quantiles.set(xlabel="normal quantile", ylabel="standardised innovation")
    title_aside(quantiles, f"mean square {np.nanmean(observed.nis):.2f}")
    if len(observed.channels) > 1:
        quantiles.legend(loc="upper left", fontsize=points(8))
    for axes, of, words in (
        (itself, autocorrelation, "autocorrelation"),
        (partial, partial_autocorrelation, "partial autocorrelation"),
    ):
        _draw_correlations(axes, series, np.arange(1, INNOVATION_LAGS + 1), of)
        axes.set(xlabel="lag, samples", ylabel=words, ylim=(-0.5, 1.0))
    _draw_forecast_errors(ahead, observed)
    figure.suptitle(observed.experiment.name or "recording")
    return figure


def _draw_forecast_errors(axes: Axes, observed: Observed) -> None:
    """Draws the errors of forecasts, found and expected, over the time ahead."""
    step = float(np.median(np.diff(observed.time)))
    leads = [step * count for count in LEADS if step * count < observed.experiment.duration / 2]
    forecasts = [observed.ahead(lead) for lead in leads]
    found = [forecast.rmse for forecast in forecasts]
    expected = [float(np.sqrt(np.mean(forecast.spread**2))) for forecast in forecasts]
    axes.plot(leads, found, "o-", color=palette().vermilion, label="found")
    axes.plot(leads, expected, "o--", color=palette().muted, label="expected", mfc="none")
    axes.set(xscale="log", xlabel="time ahead, s", ylabel="error of forecasts, K", ylim=(0, None))
    axes.legend(loc="upper left")


def _check_counts(
    where: str,
    channels: Sequence[str],
    columns: Float[np.ndarray, "times channels"],
    least: int,
    what: str,
    error: type[JaxtwinError],
) -> None:
    counts = np.isfinite(columns).sum(axis=0)
    if counts.min() < least:
        raise error(
            f"{where}: channel {channels[int(counts.argmin())]}: expected at least {least} {what} "
            f"for a test, got {counts.min()}"
        )


def _entitle(axes: Axes, title: str, note: str) -> None:
    """Writes the title of a panel of residuals and a note, and draws the line at 0."""
    axes.axhline(0.0, color=palette().muted, lw=0.8, zorder=0.5)
    axes.set_title(title)
    title_aside(axes, note)


def _standardised(series: Float[np.ndarray, " times"]) -> Float[np.ndarray, " kept"]:
    there = series[~np.isnan(series)]
    return (there - there.mean()) / (there.std() or 1.0)


def _draw_quantiles(axes: Axes, names: Sequence[str], columns: Sequence[np.ndarray]) -> None:
    """Draws standardised series over the quantiles of the normal distribution."""
    for number, (name, series) in enumerate(zip(names, columns, strict=True)):
        places = normal_quantiles(len(series))
        axes.plot(places, np.sort(series), color=color_of(number), lw=1.4, label=name)
    line = np.array([-3.3, 3.3])
    axes.plot(line, line, color=palette().ink, lw=0.8, ls=(0, (4, 3)), zorder=0.6)


def _draw_correlations(
    axes: Axes,
    columns: Float[np.ndarray, "times channels"],
    lags: Int[np.ndarray, " lags"],
    of: Callable[..., np.ndarray],
    sample: float = 1.0,
) -> None:
    """Draws the correlation of each column with itself at some lags, above the band that contains
    95 % of those of white noise.

    **Arguments:**

    - `of`: the correlation, full or partial. `sample`: the time between two samples.
    """
    for number, series in enumerate(columns.T):
        values = of(series, int(lags[-1]))[lags]
        axes.plot(sample * lags, values, color=color_of(number), lw=1.2)
    band = QUANTILE_975 / np.sqrt(np.isfinite(columns).sum(axis=0).max())
    axes.axhspan(-band, band, color=palette().faint, zorder=0.4, label="95 % of white noise")
    axes.axhline(0.0, color=palette().muted, lw=0.8, zorder=0.5)


def _mean_of_channels(values: Float[np.ndarray, "times channels"]) -> Float[np.ndarray, " times"]:
    """The mean of the samples that exist at each time; NaN if there are none."""
    counts = np.isfinite(values).sum(axis=1)
    sums = np.nansum(values, axis=1)
    return np.divide(sums, counts, out=np.full(counts.shape, np.nan), where=counts > 0)
