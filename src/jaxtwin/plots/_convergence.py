"""The convergence of sensitivity indices with the number of draws."""

import numpy as np
from jaxtyping import Float
from matplotlib import pyplot
from matplotlib.axes import Axes

from ..errors import ParameterError
from ..sensitivity_analysis import GlobalSensitivity, OneAtATime, indices_of
from ._sensitivity_labels import INDEX_WORDS, title_output
from ._style import palette, points, styled, symbol

# The number of lines with a colour and a name; the others are grey.
MAX_NAMED_LINES = 6

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
    if ax is None:
        ax = pyplot.figure(figsize=(6.4, 3.8), layout="constrained").subplots()
    order = np.argsort(-np.abs(np.nan_to_num(values[-1])), kind="stable")
    for place, column in reversed(list(enumerate(order))):
        is_named = place < MAX_NAMED_LINES
        color = palette().cycle[place] if is_named else palette().muted
        ax.plot(
            numbers, values[:, column], "o-" if is_named else "-", ms=3.5, color=color,
            lw=1.6 if is_named else 0.7, zorder=3 - place / 100,
            label=symbol(sensitivity.names[column]) if is_named else None,
        )  # fmt: skip
        if is_named:
            ax.fill_between(numbers, low[:, column], high[:, column], color=color, alpha=0.18, lw=0)
    ax.axhline(0.0, color=palette().muted, lw=0.8)
    ax.set_xscale("log", base=2)
    # The last number replaces a power of two if its label would cover it.
    shown = [number for number in numbers[:-1] if number < numbers[-1] / 1.5] + numbers[-1:]
    ax.set_xticks(shown, [str(number) for number in shown], minor=False)
    ax.tick_params(axis="x", labelsize=points(8))
    ax.set_ylim(*_limits(values, *(end[:, order[:MAX_NAMED_LINES]] for end in (low, high))))
    ax.set(xlabel="draws", ylabel=INDEX_WORDS.get(name, name), xlim=(numbers[0], numbers[-1]))
    handles, labels = ax.get_legend_handles_labels()
    ax.legend(handles[::-1], labels[::-1], loc="center left", bbox_to_anchor=(1.0, 0.5))
    title_output(ax, sensitivity, row)
    return ax


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
