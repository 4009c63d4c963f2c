"""A profile likelihood, with the interval that it gives."""

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes

from ..matching import Profile
from ._style import palette, points, styled, symbol

# 95 % quantile of chi-squared with one degree of freedom.
CHI2_95 = 3.841


@styled
def plot_profile(profile: Profile, *, ax: Axes | None = None) -> Axes:
    """Plots the increase of the cost with a parameter held at other values.

    Values below the dashed line at 3.84 are inside the 95 % interval, which is shaded as far as the
    profile reaches.

    **Arguments:**

    - `profile`: the result of `jaxtwin.profile`.
    - `ax`: axes to draw into, or None for a new figure.

    **Returns:** the axes.
    """
    if ax is None:
        ax = pyplot.figure(figsize=(5.6, 3.6), layout="constrained").subplots()
    low, high = np.clip(profile.interval, profile.values[0], profile.values[-1])
    ax.axvspan(low, high, color=palette().sky, alpha=0.35, lw=0, label="95 % interval")
    ax.plot(profile.values, profile.excess, "o-", color=palette().vermilion, ms=5)
    ax.axhline(CHI2_95, color=palette().muted, lw=1.0, ls=(0, (4, 3)))
    ax.annotate(
        f"{CHI2_95:.2f}", (1, CHI2_95), xycoords=("axes fraction", "data"), xytext=(3, 0),
        textcoords="offset points", va="center", color=palette().ink, fontsize=points(9),
    )  # fmt: skip
    ax.set_ylim(bottom=min(0.0, float(profile.excess.min())))
    unit = f", {profile.unit}" if profile.unit else ""
    ax.set(
        title="Profile likelihood",
        xlabel=f"{symbol(profile.name)}{unit}",
        ylabel="excess of twice the cost",
    )
    ax.legend(loc="upper center")
    return ax
