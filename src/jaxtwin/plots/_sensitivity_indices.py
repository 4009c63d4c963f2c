"""The indices of a global sensitivity analysis, as its method shows them: bars, Morris's plane,
indices over the time of a run, and how they converge with the number of draws.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int, Shaped
from matplotlib.axes import Axes
from numpy import ndarray

from .._name_suggestions import did_you_mean
from ..errors import ParameterError
from ..sensitivity_analysis import GlobalSensitivity, Morris, OneAtATime, indices_of
from ._panels import axes_or_new, legend_beside, title_aside
from ._style import palette, points, rim, styled, symbol, unit_text
from ._time_axis import time_axis


def plot_sensitivity_indices(
    sensitivity: GlobalSensitivity, output: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plots Sobol's indices by `plot_sobol_bars`, Morris's by `plot_morris_plane`, any others by
    `plot_index_bars`.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.global_sensitivity`.
    - `output`: one of `sensitivity.labels`; None for the mean cost, or the first.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.

    **Raises:** `ParameterError` if there is no such output.
    """
    if isinstance(sensitivity.method, Morris):
        return plot_morris_plane(sensitivity, output, ax=ax)
    if "S1" in sensitivity.indices:
        return plot_sobol_bars(sensitivity, output, ax=ax)
    return plot_index_bars(sensitivity, output, ax=ax)


@styled
def plot_index_bars(
    sensitivity: GlobalSensitivity, output: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plots the main index of each parameter, the largest on top, with 95 % intervals if the method
    has them.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.global_sensitivity` by any method.
    - `output`: one of `sensitivity.labels`; None for the mean cost, or the first.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.

    **Raises:** `ParameterError` if there is no such output.
    """
    row, main = sensitivity.row(output), sensitivity.method.main
    names = sensitivity.ranking(output)
    order = [sensitivity.names.index(name) for name in names]
    index = sensitivity[main][row, order]
    places = np.arange(len(names), dtype=float)[::-1]
    ax = axes_or_new(ax, 5.6, 1.2 + 0.29 * len(names))
    colors = [palette().blue if value < 0 else palette().vermilion for value in index]
    ax.barh(places, index, color=colors, height=0.66, alpha=0.9)
    known = sensitivity.indices
    if f"{main}_conf" in known:
        half = known[f"{main}_conf"][row, order]
        ax.hlines(places, index - half, index + half, color=palette().ink, lw=1.3)
    elif f"{main}_low" in known:
        low, high = known[f"{main}_low"][row, order], known[f"{main}_high"][row, order]
        ax.hlines(places, low, high, color=palette().ink, lw=1.3)
    label_rows(ax, names, places)
    ax.set(xlabel=INDEX_WORDS[main])
    unit = unit_text(sensitivity.outputs[row].unit)
    if main == "swing" and unit:
        ax.set_xlabel(f"{INDEX_WORDS[main]}, {unit}")
    title_output(ax, sensitivity, row)
    return ax


@styled
def plot_sobol_bars(
    sensitivity: GlobalSensitivity, output: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plots total (light) and first order (dark) indices, the largest on top; their difference is
    the part of interactions. Lines are 95 % intervals, if the method has them.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.global_sensitivity` by "sobol" or "pce".
    - `output`: one of `sensitivity.labels`; None for the mean cost, or the first.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.

    **Raises:** `ParameterError` if there is no such output.
    """
    row = sensitivity.row(output)
    names = sensitivity.ranking(output)
    order = [sensitivity.names.index(name) for name in names]
    places = np.arange(len(names), dtype=float)[::-1]
    ax = axes_or_new(ax, 5.6, 1.3 + 0.34 * len(names))
    widest = 0.0
    for name, words, shift, color in (
        ("ST", "ST, with interactions", 0.19, palette().sky),
        ("S1", "S1, alone", -0.19, palette().blue),
    ):
        index = sensitivity[name][row, order]
        ax.barh(places + shift, index, height=0.36, color=color, label=words)
        half = np.zeros(len(order))
        if f"{name}_conf" in sensitivity.indices:
            half = sensitivity[f"{name}_conf"][row, order]
            ax.hlines(places + shift, index - half, index + half, color=palette().ink, lw=1.2)
        widest = max(widest, float(np.nanmax(index + half, initial=0.0)))
    label_rows(ax, names, places)
    ax.set_xlim(right=1.05 * max(widest, 0.05))
    ax.set(xlabel="part of the output's variance")
    ax.legend(loc="lower right")
    title_output(ax, sensitivity, row)
    return ax


# The part of the largest effect from which on a parameter has its name beside its point.
NAMED_FRACTION = 0.05

NAME_HEIGHT, NAME_WIDTH = 0.055, 0.1
"""The height and the width of a name, as parts of the axes."""


@styled
def plot_morris_plane(
    sensitivity: GlobalSensitivity, output: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plots the standard deviation of each parameter's elementary effects over their mean absolute
    value with its 95 % interval. Parameters on the right have large effects, and those far up have
    nonlinear effects or interactions.

    **Arguments:**

    - `sensitivity`: the result of `jaxtwin.global_sensitivity` by "morris".
    - `output`: one of `sensitivity.labels`; None for the mean cost, or the first.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.

    **Raises:** `ParameterError` if there is no such output.
    """
    row = sensitivity.row(output)
    mu_star, sigma = sensitivity["mu_star"][row], sensitivity["sigma"][row]
    ax = axes_or_new(ax, 5.6, 4.2)
    half = sensitivity["mu_star_conf"][row]
    ax.errorbar(
        mu_star,
        sigma,
        xerr=half,
        fmt="o",
        color=palette().blue,
        ecolor=palette().muted,
        elinewidth=1.0,
        ms=5,
    )
    limit = 1.15 * float(np.nanmax(mu_star + half, initial=1e-300))
    top = 1.15 * float(np.nanmax([sigma.max(initial=0.0), 0.2 * limit]))
    diagonal = min(limit, top)
    ax.plot([0, diagonal], [0, diagonal], color=palette().muted, lw=0.9, ls=(0, (4, 3)))
    ax.annotate(
        "sigma = mu_star", (0.97 * diagonal, 0.97 * diagonal), xytext=(-4, 0),
        textcoords="offset points", ha="right", va="center", fontsize=points(8),
        color=palette().muted, path_effects=rim(),
    )  # fmt: skip
    unit = unit_text(sensitivity.outputs[row].unit)
    ends = f", {unit}" if unit else ""
    ax.set(xlim=(0, limit), ylim=(-0.02 * top, top))
    written: list[tuple[float, float]] = []
    for column in np.argsort(sigma, kind="stable"):
        if mu_star[column] >= NAMED_FRACTION * mu_star.max():
            x, y = mu_star[column] / limit, sigma[column] / top
            # A name is placed above that of a neighbour if the two would touch.
            above = max(
                [y, *(other + NAME_HEIGHT for at, other in written if abs(at - x) < NAME_WIDTH)]
            )
            written.append((x, above))
            ax.annotate(
                symbol(sensitivity.names[column]), (x * limit, above * top), xytext=(5, 5),
                textcoords="offset points", color=palette().ink, path_effects=rim(),
            )  # fmt: skip
    ax.set(xlabel=f"mu_star, mean size of the effects{ends}", ylabel=f"sigma{ends}")
    title_output(ax, sensitivity, row)
    return ax


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
    ax = axes_or_new(ax, 6.4, 3.8)
    half = sensitivity.indices.get(f"{name}_conf")
    half = np.full_like(values, np.nan) if half is None else half[rows]
    height = np.abs(np.nan_to_num(values)).max(axis=0)
    order = np.argsort(-height, kind="stable")
    _draw_lines(ax, sensitivity, order, times, (values, values - half, values + half))
    output = sensitivity.outputs[rows[0]]
    title = f"{name} of {output.quantity} {output.channel}"
    ax.set(title=title, ylabel=INDEX_WORDS.get(name, name))
    ax.set_xlim(min(0.0, times[0]), times[-1])
    time_axis(ax, times)
    if len(sensitivity.names) > MAX_NAMED_LINES:
        title_aside(ax, f"{len(sensitivity.names) - MAX_NAMED_LINES} weaker parameters in grey")
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
    row, name = sensitivity.row(output), index or sensitivity.method.main
    if sensitivity[name].ndim != 2:
        raise ParameterError(f"index: expected one of single parameters, got {name!r}")
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
    values, low, high = index
    for place, column in reversed(list(enumerate(order))):
        is_named = place < MAX_NAMED_LINES
        color = palette().cycle[place] if is_named else palette().muted
        ax.plot(
            places, values[:, column], color=color, lw=1.7 if is_named else 0.7,
            marker=marker if is_named else "", ms=3.5, zorder=3 - place / 100,
            label=symbol(sensitivity.names[column]) if is_named else None,
        )  # fmt: skip
        if is_named:
            ax.fill_between(places, low[:, column], high[:, column], color=color, alpha=0.18, lw=0)
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
    value = result.get(name, nothing)
    if f"{name}_low" in result:
        ends = [result[f"{name}_low"], result[f"{name}_high"]]
    else:
        half = result.get(f"{name}_conf", nothing)
        ends = [value - half, value + half]
    return np.stack([value[0], ends[0][0], ends[1][0]])


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


def label_rows(axes: Axes, names: Sequence[str], places: Float[ndarray, " parameters"]) -> None:
    """Writes the parameters beside their bars, which begin at a line at 0."""
    axes.axvline(0.0, color=palette().muted, lw=0.8)
    axes.set_yticks(places, [symbol(name) for name in names], fontsize=points(10))
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)


def title_output(axes: Axes, sensitivity: GlobalSensitivity, row: int) -> None:
    """Writes the name of the output and the number of runs."""
    axes.set_title(sensitivity.labels[row])
    runs = f"{len(sensitivity.failed):,} runs".replace(",", " ")
    title_aside(axes, runs)
