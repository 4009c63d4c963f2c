"""The indices of a global sensitivity analysis as curves: over the time of a run, and over the
number of draws, as they converge.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int, Shaped
from matplotlib.axes import Axes

from .._name_suggestions import did_you_mean
from ..errors import ParameterError
from ..sensitivity_analysis import GlobalSensitivity, OneAtATime, indices_of
from ._layers import draw_band
from ._panels import axes_or_new, legend_beside, time_axis, title_aside
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
    name = _index_name(sensitivity, index)
    values = sensitivity[name][rows]
    times = np.array([sensitivity.outputs[row].time for row in rows])
    interval = [end[rows] for end in interval_of(sensitivity.indices, name)]
    ax = axes_or_new(ax, 6.4, 3.8)
    order = np.argsort(-np.abs(np.nan_to_num(values)).max(axis=0), kind="stable")
    _draw_lines(ax, sensitivity, order, times, (values, *interval))
    output = sensitivity.outputs[rows[0]]
    title = f"{name} of {output.quantity} {output.channel}"
    ax.set(title=title, ylabel=INDEX_WORDS.get(name, name))
    time_axis(ax, np.append(times, 0.0))
    if len(sensitivity.names) > MAX_NAMED_LINES:
        title_aside(ax, f"{len(sensitivity.names) - MAX_NAMED_LINES} weaker parameters in grey")
    return ax


def _index_name(sensitivity: GlobalSensitivity, index: str | None) -> str:
    """The index that is asked for, or the main one, which must be one of single parameters."""
    name = sensitivity.method.main if index is None else index
    if sensitivity[name].ndim != 2:
        raise ParameterError(f"index: expected one of single parameters, got {name!r}")
    return name


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


# The smallest number of draws for which an index is drawn.
MIN_DRAWS = 8


@styled
def plot_convergence(
    sensitivity: GlobalSensitivity,
    output: str | None = None,
    index: str | None = None,
    *,
    ax: Axes | None = None,
) -> Axes:
    """Plots an index of an output over the number of draws, a line for each parameter, with its
    95 % interval if the method has one. The points are the estimates from the first 8, 16, 32 ...
    draws of the same analysis. The six parameters with the highest values have colours. The limits
    of the axes follow the last values, so that lines and intervals of few draws may lie outside.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.global_sensitivity`.
    - `output`: one of `sensitivity.labels`; None for the mean cost, or the first.
    - `index`: the name of the index; None for the method's main index.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.

    **Raises:** `ParameterError` if there is no such output or index, or the method cannot be
    applied to a part of its draws: "oat" and "dgsm".
    """
    row, name = sensitivity.row(output), _index_name(sensitivity, index)
    blocks = sensitivity.design.blocks
    has_parts = not (sensitivity.method.needs_slopes or isinstance(sensitivity.method, OneAtATime))
    if not has_parts or blocks < 2 * MIN_DRAWS:
        raise ParameterError(
            f"sensitivity: expected a method whose first draws are an analysis by themselves, with "
            f"{2 * MIN_DRAWS} draws at least, got {sensitivity.method.name} with {blocks}"
        )
    numbers = [1 << power for power in range(MIN_DRAWS.bit_length() - 1, blocks.bit_length())]
    if numbers[-1] != blocks:
        numbers.append(blocks)
    result = [_ends(sensitivity, row, name, number) for number in numbers]
    values, low, high = np.moveaxis(np.array(result), 1, 0)
    ax = axes_or_new(ax, 6.4, 3.8)
    order = np.argsort(-np.abs(np.nan_to_num(values[-1])), kind="stable")
    _draw_lines(ax, sensitivity, order, np.array(numbers), (values, low, high), marker="o")
    ax.set_xscale("log", base=2)
    # The last number replaces a power of two if its label would cover it.
    shown = [number for number in numbers[:-1] if number < numbers[-1] / 1.5] + numbers[-1:]
    ax.set_xticks(shown, [str(number) for number in shown], minor=False)
    ax.tick_params(axis="x", labelsize=points(8))
    ax.set_ylim(*_limits(values, *(end[:, order[:MAX_NAMED_LINES]] for end in (low, high))))
    ax.set(xlabel="draws", ylabel=INDEX_WORDS.get(name, name), xlim=(numbers[0], numbers[-1]))
    title_output(ax, sensitivity, row)
    return ax


def _draw_lines(
    ax: Axes,
    sensitivity: GlobalSensitivity,
    order: Int[np.ndarray, " parameters"],
    places: Shaped[np.ndarray, " points"],
    index: tuple[Float[np.ndarray, "points parameters"], ...],
    *,
    marker: str = "",
) -> None:
    """Draws an index as a line for each parameter. The first in the order have a colour, a name and
    their interval; the others are grey and below.

    **Arguments:**

    - `places`: the points on the horizontal axis.
    - `index`: the values, and the lower and upper ends of their intervals; NaN without any.
    """
    for place, column in reversed(list(enumerate(order))):
        values, low, high = (part[:, column] for part in index)
        zorder = 3 - place / 100
        if place >= MAX_NAMED_LINES:
            ax.plot(places, values, color=palette().muted, lw=0.7, zorder=zorder)
            continue
        draw_band(
            ax, places, (values, low, high), palette().cycle[place], alpha=0.18, lw=1.7,
            marker=marker, ms=3.5, zorder=zorder, label=symbol(sensitivity.names[column]),
        )  # fmt: skip
    ax.axhline(0.0, color=palette().muted, lw=0.8)
    legend_beside(ax, reverse=True)


def _limits(
    values: Float[np.ndarray, "numbers parameters"],
    low: Float[np.ndarray, "numbers named"],
    high: Float[np.ndarray, "numbers named"],
) -> tuple[float, float]:
    """Limits that contain every line and the last intervals. They extend beyond the last values by
    at most the distance of these from 0, because an estimate of few draws can be far off."""
    last = np.nan_to_num(values[-1])
    reach = max(float(np.abs(last).max()), 0.15)
    seen = [0.0, np.nanmin(values, initial=0.0), np.nanmax(values, initial=0.0)]
    seen += [np.nanmin(low[-1], initial=0.0), np.nanmax(high[-1], initial=0.0)]
    lowest = max(min(seen), min(0.0, last.min()) - reach)
    highest = min(max(seen), max(0.0, last.max()) + reach)
    room = 0.08 * (highest - lowest)
    return lowest - room, highest + room


def _ends(
    sensitivity: GlobalSensitivity, row: int, name: str, number: int
) -> Float[np.ndarray, "3 parameters"]:
    """The index from the first draws, and the ends of its interval; NaN without one."""
    part = sensitivity.design.of_blocks(np.arange(sensitivity.design.blocks) < number)
    outputs = sensitivity.values[: len(part.unit), [row]]
    result, _ = indices_of(sensitivity.method, part, outputs, seed=sensitivity.seed)
    nothing = np.full((1, len(sensitivity.names)), np.nan)
    result = {name: nothing, **result}
    return np.stack([end[0] for end in (result[name], *interval_of(result, name))])


def interval_of(indices: Mapping[str, np.ndarray], name: str) -> tuple[np.ndarray, np.ndarray]:
    """The lower and the upper ends of the 95 % intervals of an index; NaN without any."""
    if f"{name}_low" in indices:
        return indices[f"{name}_low"], indices[f"{name}_high"]
    half = indices.get(f"{name}_conf", np.full_like(indices[name], np.nan))
    return indices[name] - half, indices[name] + half


# Name of an index -> its name on an axis.
INDEX_WORDS = {
    "pearson": "Pearson correlation",
    "spearman": "Spearman rank correlation",
    "SRC": "standardised regression coefficient",
    "PRCC": "partial rank correlation",
    "swing": "swing from the 2.5 % to the 97.5 % quantile",
    "mu_star": "mean size of elementary effects",
    "S1": "first-order index",
    "ST": "total index",
    "dgsm": "bound of the total index",
    "Sh": "Shapley effect, part of the variance",
}


def title_output(axes: Axes, sensitivity: GlobalSensitivity, row: int) -> None:
    """Writes the name of the output and the number of runs."""
    axes.set_title(sensitivity.labels[row])
    runs = f"{len(sensitivity.failed):,} runs".replace(",", " ")
    title_aside(axes, runs)
