"""Step 4 of the paper, its second half: which parameters matter."""

from collections.abc import Mapping, Sequence

from matplotlib import pyplot
from matplotlib.figure import Figure

from .._progress import Progress
from ..matching import Fit
from ..plots import plot_sensitivity_matrix, plot_tornado, styled, to_png
from ..sensitivity_analysis import Sensitivity, sensitivity
from ._blocks import Numbers, Picture, Section, Table, Text

FEW = 50
"""Draws in the paper."""


def analyse(fit: Fit, draws: int, progress: Progress) -> tuple[Section, Sensitivity, Sensitivity]:
    """Draws around the matched values: as many as in the paper, and many.

    **Returns:** the section, the small analysis and the large one.
    """
    few, many = (_draw(fit, count, progress) for count in (FEW, draws))
    rate = draws * len(fit.experiments) / many.wall_time
    section = Section(
        "Sensitivity: which parameters matter",
        (
            Text(
                "Every parameter is drawn from a normal distribution around its matched value, "
                "with a standard deviation of 25 % and kept positive, and each draw is simulated "
                "through all recordings. The index is the Pearson correlation of a parameter with "
                "a channel's mean squared error, as in the paper; lines are its 95 % interval. "
                + told_text(few, many)
            ),
            Numbers(
                (
                    (", ".join(many.ranking()[:3]), "strongest on the mean of all channels"),
                    (f"{many.wall_time:.1f} s", f"{_grouped(draws)} draws, with compilation"),
                    (_grouped(round(rate)), "simulations of 1000 s in a second"),
                    (str(int(many.failed.sum())), "failed draws"),
                )
            ),
            Picture(
                "tornado",
                to_png(_side_by_side((few, many))),
                f"{FEW} draws as in the paper (its Fig. 16), and {_grouped(draws)}.",
            ),
            Picture(
                "sensitivity-matrix",
                to_png(plot_sensitivity_matrix(many)),
                f"All channels, {_grouped(draws)} draws. A number stands where the 95 % interval "
                "leaves 0 out.",
            ),
            Table(
                "The strongest three parameters of each channel, with their correlation.",
                ("channel", "first", "second", "third"),
                [
                    (channel, *(_index(many, channel, name) for name in many.ranking(channel)[:3]))
                    for channel in many.channels
                ],
            ),
        ),
        level=3,
    )
    return section, few, many


def told_text(few: Sensitivity, many: Sensitivity) -> str:
    """Which parameters' correlations with the mean cost can be told from chance, by name and sign,
    with few draws and with many, and where the two disagree."""
    early, late = few.significant(), many.significant()
    changed = [name for name in early if name not in late or late[name] != early[name]]
    first = (
        "Parameters whose correlation with the mean of all channels can be told from chance, with "
        f"its sign: of {_grouped(len(few.samples))} draws, {_named(early)}; of "
        f"{_grouped(len(many.samples))} draws, {_named(late)}."
    )
    sentences = [first]
    if changed:
        sentences.append(f"The many draws do not confirm {', '.join(changed)}.")
    sentences.append(
        "Costs have heavy tails, on which Pearson's correlation rests. By Spearman's rank "
        f"correlation, for which every draw counts alike, of {_grouped(len(many.samples))} draws: "
        f"{_named(many.significant(ranks=True))}."
    )
    return " ".join(sentences)


def _named(signs: Mapping[str, int]) -> str:
    words = [f"{name} ({'+' if sign > 0 else '−'})" for name, sign in signs.items()]
    return ", ".join(words) or "none"


def _draw(fit: Fit, draws: int, progress: Progress) -> Sensitivity:
    progress.step(f"sensitivity, {_grouped(draws)} draws")
    done, total = 0, draws * len(fit.experiments)

    def show(finished: int) -> None:
        nonlocal done
        done += finished
        progress.update(f"{_grouped(done)} of {_grouped(total)} simulations")

    return sensitivity(fit, draws=draws, on_progress=show)


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


def _index(analysis: Sensitivity, channel: str, name: str) -> str:
    row, column = analysis.channels.index(channel), analysis.names.index(name)
    return f"{name} {analysis.correlation[row, column]:+.2f}"


def _grouped(number: int) -> str:
    return f"{number:,}".replace(",", " ")
