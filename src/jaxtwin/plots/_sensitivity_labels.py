"""The labels of all plots of global sensitivity indices: the parameters' rows, and the titles."""

from collections.abc import Sequence

from jaxtyping import Float
from matplotlib.axes import Axes
from numpy import ndarray

from ..sensitivity_analysis import GlobalSensitivity
from ._style import palette, points, symbol

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
    axes.set_title(
        runs, loc="right", fontsize=points(9), fontweight="normal", color=palette().muted
    )
