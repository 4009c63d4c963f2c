"""The error that all channels share: the camera's sawtooth, and the remainder without it."""

import numpy as np
from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..matching import Fit
from ._samples import masked_key, mean_of_samples, shade_masked, weights_of_samples
from ._style import palette, points, styled


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
    weights = {name: weights_of_samples(run, fit.weights[name]) for name, run in fit.runs.items()}
    figure = pyplot.figure(figsize=(0.9 + 3.9 * columns, 4.6), layout="constrained")
    grid = figure.subplots(2, columns, sharex="col", sharey=True, squeeze=False)
    for (above, below), (name, run) in zip(grid.T, fit.runs.items(), strict=True):
        assert run.experiment.temperatures is not None
        camera = fit.camera[name]
        shared = mean_of_samples(run.experiment.temperatures - run.temperatures, axis=1)
        above.plot(run.time, shared, color=palette().muted, lw=1.0)
        above.plot(run.time, camera.offset, color=palette().vermilion, lw=1.6)
        below.plot(run.time, shared - camera.offset, color=palette().ink, lw=1.0)
        for axes, series, title in ((above, shared, name), (below, shared - camera.offset, "")):
            shade_masked(axes, run.time, weights[name])
            axes.axhline(0.0, color=palette().muted, lw=0.8, zorder=0.5)
            rms = float(np.sqrt(np.nanmean(series**2)))
            axes.set_title(title)
            axes.set_title(f"{rms:.2f} K rms", loc="right", fontsize=points(9), fontweight="normal")
        if camera.events:
            # The ticks are at the upper edge: lines through the whole panel would hide the jumps.
            edge = above.get_xaxis_transform()
            above.plot(
                camera.events, np.full(len(camera.events), 0.97), "v", color=palette().orange, ms=5,
                transform=edge, clip_on=False,
            )  # fmt: skip
        below.set(xlabel="time, s", xlim=(run.time[0], run.time[-1]))
    grid[0, 0].set_ylabel("recorded − twin, K")
    grid[1, 0].set_ylabel("without camera, K")
    corrections = Line2D([], [], color=palette().orange, marker="v", ls="", label="its corrections")
    figure.legend(
        handles=[
            Line2D([], [], color=palette().muted, lw=1.2, label="mean of the channels"),
            Line2D([], [], color=palette().vermilion, lw=1.6, label="given to the camera"),
            *([corrections] if any(camera.events for camera in fit.camera.values()) else []),
            Line2D([], [], color=palette().ink, lw=1.2, label="left for the plate"),
            *masked_key(weights.values()),
        ],
        loc="outside lower center",
        ncols=5,
    )
    return figure
