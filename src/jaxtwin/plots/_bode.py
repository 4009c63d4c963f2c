"""The Bode diagram of linear models."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from ..control import LinearModel
from ..errors import ControlError
from ._style import line_of, palette, styled

# The least gain, as a part of the largest, that is drawn by default.
MIN_GAIN = 1e-3


@styled
def plot_bode(
    models: LinearModel | Mapping[str, LinearModel], omega: Sequence[float] | None = None
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
      the phase without end.

    **Returns:** the figure.

    **Raises:** `ControlError` if there is no model, or the models have different inputs.
    """
    named = {"": models} if isinstance(models, LinearModel) else dict(models)
    if not named or len({model.input_names for model in named.values()}) != 1:
        inputs = sorted({", ".join(model.input_names) for model in named.values()})
        raise ControlError(
            "plot_bode: models: expected one model or several with the same inputs, got "
            f"{' and '.join(inputs) or 'none'}"
        )
    first = next(iter(named.values()))
    frequencies = bode_frequencies(first) if omega is None else np.asarray(omega, float)
    columns = len(first.input_names)
    figure = pyplot.figure(figsize=(1.2 + 4.2 * columns, 5.4), layout="constrained")
    grid = figure.subplots(2, columns, sharex=True, sharey="row", squeeze=False)
    for number, (label, model) in enumerate(named.items()):
        color = palette().cycle[number % len(palette().cycle)]
        response = np.asarray(model.frequency_response(frequencies))
        for column, (gain, phase) in enumerate(grid.T):
            channels = np.abs(response[:, :, column])
            mean = response[:, :, column].mean(axis=1)
            gain.fill_between(
                frequencies, channels.min(axis=1), channels.max(axis=1), color=color, alpha=0.15,
                lw=0,
            )  # fmt: skip
            look = {"color": color, "ls": line_of(number)}
            gain.loglog(frequencies, np.abs(mean), label=label, **look)
            phase.semilogx(frequencies, np.degrees(np.unwrap(np.angle(mean))), **look)
    for column, (gain, phase) in enumerate(grid.T):
        gain.set_title(f"duty of {first.input_names[column]}")
        phase.set(xlabel="frequency, rad/s", xlim=(frequencies[0], frequencies[-1]))
        phase.yaxis.set_major_locator(MultipleLocator(90))
        if first.is_lagged:
            for axes in (gain, phase):
                axes.axvline(1 / float(first.lag_s), color=palette().muted, lw=0.8, ls="--")
    gains, phases = (
        np.concatenate([line.get_ydata() for axes in row for line in axes.lines[: len(named)]])
        for row in grid
    )
    largest = float(gains.max())
    least = max(float(gains.min()), largest * MIN_GAIN)
    grid[0, 0].set(ylabel="gain, K per unit of duty", ylim=(least / 2, largest * 5))
    low, high = np.floor(phases.min() / 90) * 90, np.ceil(phases.max() / 90) * 90
    grid[1, 0].set(ylabel="phase, degrees", ylim=(low - 10, high + 10))
    if len(named) > 1:
        grid[0, 0].legend(loc="lower left")
    return figure


def bode_frequencies(model: LinearModel) -> np.ndarray:
    """The frequencies from a tenth of the slowest pole to ten times the lag, rad/s, or to where the
    gain of all inputs has fallen to `MIN_GAIN`."""
    slowest = 1 / float(model.time_constants_s[0])
    slowest = slowest if slowest > 0 else 1e-3
    top = 10 / float(model.lag_s) if model.is_lagged else 100 * slowest
    omega = np.geomspace(slowest / 10, max(top, 10 * slowest), 400)
    mean = np.abs(np.asarray(model.frequency_response(omega)).mean(axis=1)).max(axis=1)
    (seen,) = np.nonzero(mean >= MIN_GAIN * mean.max())
    return np.geomspace(omega[0], max(omega[seen[-1]], 10 * slowest), 400)
