"""The Bode diagram of many draws of a linear model."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex, Float
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from ..control import LinearModel
from ..errors import ControlError
from ._bode import bode_frequencies
from ._style import palette, styled

# The quantiles of the draws between which a band lies.
SHARES = (0.05, 0.95)


@styled
def plot_bode_band(
    model: LinearModel, draws: Sequence[LinearModel], omega: Sequence[float] | None = None
) -> Figure:
    """Plots gain and phase from the duty of each cell to the mean of all channels, with bands.

    The line is the model, and the bands contain 90 % of the draws at each frequency. The lowest
    panels show the gains of the draws relative to that of the model.

    **Arguments:**

    - `model`: the nominal model.
    - `draws`: models of draws of the parameters, such as those of `posterior_draws`.
    - `omega`: the frequencies, rad/s; by default those of `plot_bode`.

    **Returns:** the figure.

    **Raises:** `ControlError` if there are no draws, or they have other inputs than the model.
    """
    if not draws or any(draw.input_names != model.input_names for draw in draws):
        inputs = sorted({", ".join(draw.input_names) for draw in draws})
        raise ControlError(
            "plot_bode_band: draws: expected models with the inputs of the nominal model "
            f"({', '.join(model.input_names)}), got {' and '.join(inputs) or 'none'}"
        )
    frequencies = bode_frequencies(model) if omega is None else np.asarray(omega, float)
    columns = len(model.input_names)
    figure = pyplot.figure(figsize=(1.2 + 4.2 * columns, 6.4), layout="constrained")
    grid = figure.subplots(
        3, columns, sharex=True, sharey="row", squeeze=False, height_ratios=(3, 3, 2)
    )
    nominal = _of_mean(model, frequencies)
    many = np.stack([_of_mean(draw, frequencies) for draw in draws])
    for column, (gain, phase, ratio) in enumerate(grid.T):
        own, drawn = nominal[:, column], many[:, :, column]
        _draw(gain, frequencies, np.abs(own), np.abs(drawn))
        _draw(phase, frequencies, _degrees(own), _degrees(drawn))
        _draw(ratio, frequencies, np.ones(len(own)), np.abs(drawn) / np.abs(own))
        gain.set(xscale="log", yscale="log", title=f"duty of {model.input_names[column]}")
        phase.yaxis.set_major_locator(MultipleLocator(90))
        ratio.set(xlabel="frequency, rad/s", xlim=(frequencies[0], frequencies[-1]))
    grid[0, 0].set_ylabel("gain, K per unit of duty")
    grid[1, 0].set_ylabel("phase, degrees")
    grid[2, 0].set_ylabel("relative gain")
    grid[0, 0].legend(loc="lower left")
    return figure


def _of_mean(
    model: LinearModel, omega: Float[np.ndarray, " frequency"]
) -> Complex[np.ndarray, "frequency inputs"]:
    return np.asarray(model.frequency_response(omega)).mean(axis=1)


def _degrees(
    response: Complex[np.ndarray, "*draws frequency"],
) -> Float[np.ndarray, "*draws frequency"]:
    return np.degrees(np.unwrap(np.angle(response), axis=-1))


def _draw(
    axes: Axes,
    omega: Float[np.ndarray, " frequency"],
    nominal: Float[np.ndarray, " frequency"],
    draws: Float[np.ndarray, "draws frequency"],
) -> None:
    low, high = np.quantile(draws, SHARES, axis=0)
    axes.fill_between(
        omega, low, high, color=palette().blue, alpha=0.25, lw=0, label="90 % of the draws"
    )
    axes.plot(omega, nominal, color=palette().vermilion, lw=1.2, label="model")
