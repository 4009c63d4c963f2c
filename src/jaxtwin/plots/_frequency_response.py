"""The frequency response of linear models: Bode diagrams, also of many draws, and the Nyquist plot
of a loop with the disk that it keeps away from.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Complex, Float
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MultipleLocator

from ..control import LoopMargins, StateSpace
from ..errors import ControlError
from ._layers import draw_band
from ._panels import legend_of_all, panels
from ._style import color_of, line_of, palette, styled

# The least gain, as a part of the largest, that is drawn by default.
MIN_GAIN = 1e-3


@styled
def plot_bode(
    models: StateSpace | Mapping[str, StateSpace], omega: Sequence[float] | None = None
) -> Figure:
    """Plots gain and phase over frequency, a column for each cell.

    A line is the mean of all channels. The band about its gain extends from the channel with the
    smallest gain to the one with the largest. A dashed line marks the frequency at which the
    driver's lag alone would halve the power.

    **Arguments:**

    - `models`: a model, or several by their label, such as a model and its reduction by `reduce`.
    - `omega`: the frequencies, rad/s; by default from a tenth of the slowest pole to ten times the
      lag's or, without a lag, a hundred times the slowest pole, but only as far as the gain is at
      least a thousandth of the largest. Beyond, the response is below any noise, and a delay turns
      the phase without end. Discrete models are drawn to half their sample rate.

    **Returns:** the figure.

    **Raises:** `ControlError` if there is no model, or the models have different inputs.
    """
    named = {"": models} if isinstance(models, StateSpace) else dict(models)
    if not named or len({model.input_names for model in named.values()}) != 1:
        inputs = sorted({", ".join(model.input_names) for model in named.values()})
        raise ControlError(
            "plot_bode: models: expected one model or several with the same inputs, got "
            f"{' and '.join(inputs) or 'none'}"
        )
    first = next(iter(named.values()))
    frequencies = bode_frequencies(first) if omega is None else np.asarray(omega, float)
    figure, grid = _bode_panels(first.input_names, frequencies, 5.4, (1, 1))
    for number, (label, model) in enumerate(named.items()):
        response = _response(model, frequencies)
        for column, (gain, phase) in enumerate(grid.T):
            channels, mean = np.abs(response[:, :, column]), response[:, :, column].mean(axis=1)
            band = (np.abs(mean), channels.min(axis=1), channels.max(axis=1))
            look = {"ls": line_of(number), "label": label}
            draw_band(gain, frequencies, band, color_of(number), alpha=0.15, **look)
            phase.plot(frequencies, _degrees(mean), color=color_of(number), **look)
    if first.is_lagged:
        for axes in grid.flat:
            axes.axvline(1 / float(first.lag_s), color=palette().muted, lw=0.8, ls="--")
    means = np.stack([_of_mean(model, frequencies) for model in named.values()])
    gains, phases = np.abs(means), _degrees(np.moveaxis(means, 1, -1))
    least = max(float(np.nanmin(gains)), float(np.nanmax(gains)) * MIN_GAIN)
    grid[0, 0].set_ylim(least / 2, float(np.nanmax(gains)) * 5)
    low, high = np.floor(np.nanmin(phases) / 90) * 90, np.ceil(np.nanmax(phases) / 90) * 90
    grid[1, 0].set_ylim(low - 10, high + 10)
    if len(named) > 1:
        grid[0, 0].legend(loc="lower left")
    return figure


def bode_frequencies(model: StateSpace) -> np.ndarray:
    """The frequencies from a tenth of the slowest pole to ten times the lag, rad/s, or to where the
    gain of all inputs has fallen to `MIN_GAIN`; of a discrete model to half the sample rate."""
    slowest = 1 / float(model.time_constants_s[0])
    slowest = slowest if slowest > 0 else 1e-3
    top = 10 / float(model.lag_s) if model.is_lagged else 100 * slowest
    omega = np.geomspace(slowest / 10, max(top, 10 * slowest), 400)
    omega = omega[omega < model.nyquist_frequency]
    mean = np.abs(np.asarray(model.frequency_response(omega)).mean(axis=1)).max(axis=1)
    (seen,) = np.nonzero(mean >= MIN_GAIN * mean.max())
    return np.geomspace(omega[0], max(omega[seen[-1]], min(10 * slowest, omega[-1])), 400)


# The quantiles of the draws between which a band lies.
SHARES = (0.05, 0.95)


@styled
def plot_bode_band(
    model: StateSpace, draws: Sequence[StateSpace], omega: Sequence[float] | None = None
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
    figure, grid = _bode_panels(model.input_names, frequencies, 6.4, (3, 3, 2))
    nominal = _of_mean(model, frequencies)
    many = np.stack([_of_mean(draw, frequencies) for draw in draws])
    band = {"color": palette().blue, "alpha": 0.25, "lw": 0, "label": "90 % of the draws"}
    line = {"color": palette().vermilion, "lw": 1.2, "label": "model"}
    for column, (gain, phase, ratio) in enumerate(grid.T):
        own, drawn = nominal[:, column], many[:, :, column]
        for axes, middle, values in (
            (gain, np.abs(own), np.abs(drawn)),
            (phase, _degrees(own), _degrees(drawn)),
            (ratio, np.ones(len(own)), np.abs(drawn) / np.abs(own)),
        ):
            axes.fill_between(frequencies, *np.quantile(values, SHARES, axis=0), **band)
            axes.plot(frequencies, middle, **line)
    grid[2, 0].set_ylabel("relative gain")
    grid[0, 0].legend(loc="lower left")
    return figure


def _bode_panels(
    inputs: Sequence[str],
    omega: Float[np.ndarray, " frequency"],
    height: float,
    height_ratios: Sequence[int],
) -> tuple[Figure, np.ndarray]:
    """Panels of gain, phase and further values over frequency, a column for each input."""
    columns, shared = len(inputs), {"sharex": True, "sharey": "row"}
    size = (1.2 + 4.2 * columns, height)
    figure, grid = panels(len(height_ratios), columns, *size, height_ratios=height_ratios, **shared)
    for column, name in zip(grid.T, inputs, strict=True):
        column[0].set(xscale="log", yscale="log", title=f"duty of {name}")
        column[1].yaxis.set_major_locator(MultipleLocator(90))
        column[-1].set(xlabel="frequency, rad/s", xlim=(omega[0], omega[-1]))
    grid[0, 0].set_ylabel("gain, K per unit of duty")
    grid[1, 0].set_ylabel("phase, degrees")
    return figure, grid


def _of_mean(
    model: StateSpace, omega: Float[np.ndarray, " frequency"]
) -> Complex[np.ndarray, "frequency inputs"]:
    return _response(model, omega).mean(axis=1)


def _response(
    model: StateSpace, omega: Float[np.ndarray, " frequency"]
) -> Complex[np.ndarray, "frequency outputs inputs"]:
    """The response of a model; NaN above half the sample rate of a discrete one."""
    response = np.array(model.frequency_response(omega))
    response[omega > model.nyquist_frequency] = np.nan
    return response


def _degrees(
    response: Complex[np.ndarray, "*draws frequency"],
) -> Float[np.ndarray, "*draws frequency"]:
    return np.degrees(np.unwrap(np.angle(response), axis=-1))


# The part of the plane to the left of the origin that is shown, so that the disk is in it.
MIN_SHOWN, MAX_SHOWN = 1.8, 6.0


@styled
def plot_nyquist(margins: LoopMargins) -> Figure:
    r"""Plots the response of a loop in the complex plane, up to half the sample rate.

    The disk around -1 is that of the disk margin: gains between $\gamma_{min}$ and $\gamma_{max}$
    take its ends $-1 / \gamma_{min}$ and $-1 / \gamma_{max}$ to -1. A loop with a single output
    touches it at the frequency of the dot. Of several outputs the curves are the eigenvalues of the
    loop, which stay outside; the disk is that of changes in all outputs, also different ones, and
    no curve need touch it.

    **Arguments:**

    - `margins`: the result of `jaxtwin.control.loop_margins`.

    **Returns:** the figure.
    """
    figure, ((axes,),) = panels(1, 1, 5.4, 4.6)
    low, high = margins.disk.gain
    shown = MIN_SHOWN
    if low > 0 and np.isfinite(high):
        left, right = -1 / low, -1 / high
        shown = float(np.clip(-1.1 * left, MIN_SHOWN, MAX_SHOWN))
        color, label = palette().vermilion, f"disk margin {margins.disk.margin:.2f}"
        look = {"fc": color, "ec": color, "alpha": 0.25, "lw": 1, "label": label}
        axes.add_patch(Circle(((left + right) / 2, 0), (right - left) / 2, **look))
    curves = _curves(margins.response)
    at = int(np.abs(np.log(margins.omega / margins.disk.omega)).argmin())
    for number, curve in enumerate(curves.T):
        look = {"color": color_of(number), "ls": line_of(number)}
        name = "loop" if curves.shape[1] == 1 else f"eigenvalue {number + 1}"
        axes.plot(curve.real, curve.imag, label=name, **look)
        axes.plot(curve.real, -curve.imag, lw=0.8, alpha=0.5, **look)
        axes.plot(curve[at].real, curve[at].imag, "o", ms=4, color=color_of(number))
    axes.plot(-1, 0, "+", ms=9, mew=1.6, color=palette().ink)
    axes.set(xlabel="real part", ylabel="imaginary part", aspect="equal")
    axes.set(xlim=(-shown, shown / 3), ylim=(-0.6 * shown, 0.6 * shown))
    axes.set_title(f"nearest to instability at {margins.disk.omega:.2g} rad/s")
    legend_of_all(figure)
    return figure


def _curves(response: np.ndarray) -> np.ndarray:
    """The eigenvalues of the loop, (frequency, outputs), each along one curve."""
    eigenvalues = np.linalg.eigvals(response)
    for number in range(1, len(eigenvalues)):
        left = list(range(eigenvalues.shape[1]))
        row = []
        for value in eigenvalues[number - 1]:
            near = min(left, key=lambda k: abs(eigenvalues[number, k] - value))
            left.remove(near)
            row.append(near)
        eigenvalues[number] = eigenvalues[number, row]
    return eigenvalues
