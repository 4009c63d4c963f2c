"""Step 4 of the paper, second half: the sensitivity analysis, with few draws and with many."""

from collections.abc import Sequence

from matplotlib import pyplot
from matplotlib.figure import Figure

from .._progress import Progress
from ..matching import Fit
from ..plots import plot_tornado, styled, to_png
from ..sensitivity_analysis import Sensitivity
from ._blocks import ReportPicture, Section, Text
from ._sensitivity import (
    draw,
    drawing_numbers,
    grouped,
    matrix_picture,
    named,
    strongest_table,
)

# The number of draws in the paper.
PAPER_DRAWS = 50


def analyse(fit: Fit, draws: int, progress: Progress) -> tuple[Section, Sensitivity, Sensitivity]:
    """Analyses the sensitivity around the matched values, with as many draws as in the paper, and
    with many.

    **Returns:** the section, the small analysis and the large one.
    """
    few, many = (draw(fit, count, progress) for count in (PAPER_DRAWS, draws))
    section = Section(
        "Sensitivity: which parameters matter",
        (
            Text(
                "Every parameter is drawn from a normal distribution around its matched value, "
                "with a standard deviation of 25 % and kept positive, and each draw is simulated "
                "through all recordings. The index is the Pearson correlation of a parameter with "
                "a channel's mean squared error, as in the paper; lines are its 95 % interval. "
                + significance_text(few, many)
            ),
            drawing_numbers(many, fit),
            ReportPicture(
                "tornado",
                to_png(_side_by_side((few, many))),
                f"{PAPER_DRAWS} draws as in the paper (its Fig. 16), and {grouped(draws)}.",
            ),
            matrix_picture(many),
            strongest_table(many),
        ),
        level=3,
    )
    return section, few, many


def significance_text(few: Sensitivity, many: Sensitivity) -> str:
    """The parameters with a significant correlation with the mean cost, by name and sign, with few
    draws and with many, and the parameters on which the two disagree."""
    early, late = few.significant(), many.significant()
    changed = [name for name in early if name not in late or late[name] != early[name]]
    first = (
        "Parameters with a significant correlation with the mean of all channels, with its sign: "
        f"of {grouped(len(few.samples))} draws, {named(early)}; of "
        f"{grouped(len(many.samples))} draws, {named(late)}."
    )
    sentences = [first]
    if changed:
        sentences.append(f"The many draws do not confirm {', '.join(changed)}.")
    sentences.append(
        "Costs have heavy tails, on which Pearson's correlation rests. By Spearman's rank "
        f"correlation, for which every draw counts alike, of {grouped(len(many.samples))} draws: "
        f"{named(many.significant(ranks=True))}."
    )
    return " ".join(sentences)


@styled
def _side_by_side(analyses: Sequence[Sensitivity]) -> Figure:
    figure = pyplot.figure(
        figsize=(11.4, 1.4 + 0.29 * len(analyses[0].names)), layout="constrained"
    )
    panels = figure.subplots(1, len(analyses))
    for axes, analysis in zip(panels, analyses, strict=True):
        plot_tornado(analysis, ax=axes)
    widest = max(axes.get_xlim()[1] for axes in panels)
    for axes in panels:
        axes.set_xlim(-widest, widest)
    return figure
