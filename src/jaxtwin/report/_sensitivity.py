"""Sensitivity of the cost to the parameters, for a report."""

from collections.abc import Mapping

from .._progress import Progress
from ..matching import Fit
from ..plots import plot_sensitivity_matrix, plot_tornado, to_png
from ..sensitivity_analysis import Sensitivity, sensitivity
from ._blocks import KeyNumbers, ReportPicture, ReportTable, Section, Text


def sensitivity_section(fit: Fit, draws: int, progress: Progress) -> tuple[Section, Sensitivity]:
    """The section on draws of the parameters around their matched values.

    **Returns:** the section, and the analysis.
    """
    analysis = draw(fit, draws, progress)
    figure = plot_tornado(analysis).get_figure(root=True)
    assert figure is not None
    signs = named(analysis.significant())
    section = Section(
        "Sensitivity",
        (
            Text(
                "Each free parameter was drawn from a normal distribution around its matched "
                "value, with a standard deviation of 25 %, and each draw was simulated for all "
                "recordings. The index is the correlation of a parameter with the mean squared "
                "error of a channel. Parameters whose correlation with the mean of all channels "
                f"differs from 0 at 95 %, with its sign: {signs}."
            ),
            drawing_numbers(analysis, fit),
            ReportPicture(
                "tornado",
                to_png(figure),
                f"{grouped(draws)} draws, mean of all channels. Lines are 95 % intervals.",
            ),
            matrix_picture(analysis),
            strongest_table(analysis),
        ),
    )
    return section, analysis


def draw(fit: Fit, draws: int, progress: Progress) -> Sensitivity:
    """A sensitivity analysis that shows its progress."""
    progress.step(f"sensitivity, {grouped(draws)} draws")
    done, total = 0, draws * len(fit.experiments)

    def show(finished: int) -> None:
        nonlocal done
        done += finished
        progress.update(f"{grouped(done)} of {grouped(total)} simulations")

    return sensitivity(fit, draws=draws, on_progress=show)


def drawing_numbers(analysis: Sensitivity, fit: Fit) -> KeyNumbers:
    """The strongest parameters, and the computing time of the draws."""
    draws = len(analysis.samples)
    rate = draws * len(fit.experiments) / analysis.wall_time
    return KeyNumbers(
        (
            (", ".join(analysis.ranking()[:3]), "strongest on the mean of all channels"),
            (f"{analysis.wall_time:.1f} s", f"{grouped(draws)} draws, with compilation"),
            (grouped(round(rate)), "simulations per second"),
            (str(int(analysis.failed.sum())), "failed draws"),
        )
    )


def matrix_picture(analysis: Sensitivity) -> ReportPicture:
    """The matrix of the correlations of all channels with all parameters."""
    return ReportPicture(
        "sensitivity-matrix",
        to_png(plot_sensitivity_matrix(analysis)),
        f"All channels, {grouped(len(analysis.samples))} draws. A number is shown if the 95 % "
        "interval does not contain 0.",
    )


def strongest_table(analysis: Sensitivity) -> ReportTable:
    """The parameters on which each channel depends most."""
    return ReportTable(
        "The strongest three parameters of each channel, with their correlation.",
        ("channel", "first", "second", "third"),
        [
            (
                channel,
                *([_index(analysis, channel, name) for name in strongest] + ["-"] * 3)[:3],
            )
            for channel in analysis.channels
            for strongest in [analysis.ranking(channel)[:3]]
        ],
    )


def named(signs: Mapping[str, int]) -> str:
    """Parameters with the signs of their correlations, or `none`."""
    words = [f"{name} ({'+' if sign > 0 else '−'})" for name, sign in signs.items()]
    return ", ".join(words) or "none"


def grouped(number: int) -> str:
    """A count with its digits in groups of three."""
    return f"{number:,}".replace(",", " ")


def _index(analysis: Sensitivity, channel: str, name: str) -> str:
    row, column = analysis.channels.index(channel), analysis.names.index(name)
    return f"{name} {analysis.correlation[row, column]:+.2f}"
