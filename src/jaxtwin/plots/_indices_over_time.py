"""A sensitivity index over the time of a run."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

from .._name_suggestions import did_you_mean
from ..errors import ParameterError
from ..sensitivity_analysis import GlobalSensitivity
from ._sensitivity_labels import INDEX_WORDS
from ._style import palette, points, styled, symbol

# The number of lines with a colour and a name; the others are grey.
MAX_NAMED_LINES = 6


@styled
def plot_indices_over_time(
    sensitivity: GlobalSensitivity,
    channel: str | None = None,
    index: str | None = None,
    *,
    ax: Axes | None = None,
) -> Axes:
    """Plots an index of a channel's temperature over time, a line for each parameter, with its 95 %
    interval if the method has one. The six parameters with the highest values have colours.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.global_sensitivity`, with `"temperature"`
      among its outputs.
    - `channel`: the name of the channel; None for the first. If several recordings have it, the
      first of them is used.
    - `index`: the name of the index; None for the method's main index.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.

    **Raises:** `ParameterError` if there is no such channel with several times, or no such
    index of parameters.
    """
    rows = _rows(sensitivity, channel)
    name = sensitivity.method.main if index is None else index
    values = sensitivity[name]
    if values.ndim != 2:
        raise ParameterError(f"index: expected one of single parameters, got {name!r}")
    values = values[rows]
    times = np.array([sensitivity.outputs[row].time for row in rows])
    if ax is None:
        ax = pyplot.figure(figsize=(6.4, 3.8), layout="constrained").subplots()
    half = sensitivity.indices.get(f"{name}_conf")
    height = np.abs(np.nan_to_num(values)).max(axis=0)
    order = np.argsort(-height, kind="stable")
    for place, column in reversed(list(enumerate(order))):
        is_named = place < MAX_NAMED_LINES
        color = palette().cycle[place] if is_named else palette().muted
        ax.plot(
            times, values[:, column], color=color, lw=1.8 if is_named else 0.7,
            label=symbol(sensitivity.names[column]) if is_named else None, zorder=3 - place / 100,
        )  # fmt: skip
        if is_named and half is not None:
            edge = half[rows, column]
            ax.fill_between(
                times, values[:, column] - edge, values[:, column] + edge,
                color=color, alpha=0.18, lw=0,
            )  # fmt: skip
    ax.axhline(0.0, color=palette().muted, lw=0.8)
    output = sensitivity.outputs[rows[0]]
    title = f"{name} of {output.quantity} {output.channel}"
    ax.set(title=title, xlabel="time, s", ylabel=INDEX_WORDS.get(name, name))
    ax.set_xlim(min(0.0, times[0]), times[-1])
    handles, labels = ax.get_legend_handles_labels()
    ax.legend(handles[::-1], labels[::-1], loc="center left", bbox_to_anchor=(1.0, 0.5))
    if len(sensitivity.names) > MAX_NAMED_LINES:
        ax.set_title(
            f"{len(sensitivity.names) - MAX_NAMED_LINES} weaker parameters in grey",
            loc="right", fontsize=points(9), fontweight="normal", color=palette().muted,
        )  # fmt: skip
    return ax


def _rows(sensitivity: GlobalSensitivity, channel: str | None) -> list[int]:
    """The rows of the outputs of a channel at its times in a recording."""
    timed = [row for row, each in enumerate(sensitivity.outputs) if not np.isnan(each.time)]
    channels = dict.fromkeys(sensitivity.outputs[row].channel for row in timed)
    wanted = next(iter(channels), None) if channel is None else channel
    chosen = [row for row in timed if sensitivity.outputs[row].channel == wanted]
    chosen = [
        row
        for row in chosen
        if sensitivity.outputs[row].recording == sensitivity.outputs[chosen[0]].recording
    ]
    if len(chosen) < 2:
        raise ParameterError(
            f"channel: expected one of {', '.join(channels) or 'those'} with several times, got "
            f'{wanted!r}; ask for outputs=["temperature"]'
            f"{did_you_mean([] if wanted is None else [wanted], channels)}"
        )
    return chosen
