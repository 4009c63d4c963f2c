"""Step 4 of the paper: behavioural matching, and the sensitivity analysis, with few draws and with
many.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib import pyplot
from matplotlib.figure import Figure

from .._number_text import interval_text
from .._progress import Progress
from .._statistics import mean_fit_percent
from ..data import synthetic_truth
from ..matching import Fit, FittedParameter, Iteration, match
from ..physics import Twin
from ..plots import (
    plot_comparison,
    plot_history,
    plot_parameters,
    plot_residuals,
    plot_tornado,
    styled,
    to_png,
)
from ..rig import Rig, read_parameters
from ..sensitivity_analysis import Sensitivity
from ..simulation import Run
from ._demo_simulate import Source, synthetic_source
from ._page import KeyNumbers, ReportPicture, ReportTable, Section, Text
from ._parameters import (
    draw,
    drawing_numbers,
    fit_numbers,
    grouped,
    matrix_picture,
    named,
    parameter_table,
    strongest_table,
)
from ._recordings import recorded, shows_sawtooth

STARTS = 3
AMBIENT, START = "T_amb", "T_start"

# The links from the edges of the plate to the air. In the synthetic truth their heat loss is 6 % of
# that of the faces and partly in parallel with it, so that noise of 0.1 K hides them.
EDGES = ("R_Tey", "R_Tex1", "R_Tey1", "R_Tey2", "R_Tey3")


def match_fixed(
    rig: Rig, source: Source, published: list[Run], progress: Progress
) -> tuple[Section, Fit]:
    """Matches under the conditions of the paper: its sixteen parameters and bounds, and the ambient
    temperature fixed at 15 degC.

    **Returns:** the section and the fit.
    """
    progress.step(f"matching 16 parameters, ambient 15 °C, {STARTS} starts")
    fit = match(
        Twin(rig, rig.parameter_sets["initial"]),
        source.experiments,
        starts=STARTS,
        on_progress=_news(progress, STARTS),
    )
    before = _mean_fit(published)
    section = Section(
        "4 Match: parameters from recordings",
        (
            Text(
                "The sixteen parameters of Table 4 that the circuit holds, inside its bounds (the "
                "two rows whose values lie outside their own bounds reach to 2000 K/W), ambient "
                f"and start held at 15 °C: the paper's own terms. {STARTS} starts, the first at "
                "the table's initial values, by Levenberg-Marquardt with exact derivatives."
            ),
            fit_numbers(fit, f"mean fit (published values: {before:.1f} %)"),
            ReportPicture(
                "history",
                to_png(plot_history(fit)),
                "The best start: RMSE and parameters over the iterations (the paper's Fig. 14). "
                "Dotted: bounds. Coloured names end on a bound: the data would rather have them "
                "beyond, a sign that the circuit lacks something.",
            ),
            ReportPicture(
                "parameters",
                to_png(plot_parameters(fit)),
                "Between their bounds, on logarithmic scales: initial, published and matched, with "
                "the 95 % interval as far as the bounds reach. None has a prior: the paper gives "
                "bounds alone.",
            ),
            parameter_table(fit, "The paper's Table 4 beside the matched values."),
            ReportTable(
                "Where each start ended.",
                ("start", "RMSE, K", "iterations", "why it stopped"),
                [
                    (str(end.start + 1), f"{end.rmse:.4f}", str(end.iterations), end.status)
                    for end in fit.optima
                ],
            ),
        ),
    )
    return section, fit


def match_ambient_per_recording(
    rig: Rig, source: Source, published: list[Run], fixed: Fit, progress: Progress
) -> tuple[Section, Fit]:
    """Matches with an ambient temperature for each recording; the start is still at 15 degC.

    **Returns:** the section and the fit.
    """
    progress.step("matching with one ambient per recording")
    fit = match(
        Twin(rig, rig.parameter_sets["initial"]),
        source.experiments,
        free=[row.name for row in fixed.parameters.values() if row.free] + [AMBIENT],
        on_progress=_news(progress),
    )
    runs = list(fit.runs.values())
    section = Section(
        "One ambient for each recording",
        (
            Text(
                (
                    "The recordings were made on different days. "
                    if source.real
                    else "Each synthetic recording has its own ambient temperature. "
                )
                + "With an ambient temperature matched for each of them, the same sixteen "
                "parameters fit better:"
            ),
            fit_numbers(fit, f"mean fit (ambient 15 °C: {fixed.mean_fit_percent:.1f} %)"),
            ReportPicture(
                "response",
                to_png(plot_comparison(runs)),
                "Matched twin against recording (the paper's Fig. 15).",
            ),
            _fit_table(published, fixed, fit),
            ReportPicture(
                "residuals",
                to_png(plot_residuals(runs)),
                _what_is_left(source, runs),
            ),
            ReportTable(
                "Ambient temperatures of this match, °C. They are what the circuit needs to fit, "
                "not what a thermometer read.",
                ("recording", "matched ambient", "recorded at the start"),
                [
                    (name, f"{fit.recording_values[name][AMBIENT]:.2f}", f"{_start(run):.2f}")
                    for name, run in fit.runs.items()
                ],
            ),
            parameter_table(fit, "The shared parameters of this match."),
        ),
        level=3,
    )
    return section, fit


def recover_truth(rig: Rig, progress: Progress) -> tuple[Section, dict[str, Any]]:
    """Matches the synthetic recordings, of which the true parameters are known.

    **Returns:** the section, and its numbers.
    """
    progress.step("matching synthetic recordings with known truth")
    truth = read_parameters(synthetic_truth(), rig)
    source = synthetic_source()
    start = {**rig.parameter_sets["initial"], **{name: truth[name] for name in EDGES}}
    fit = match(
        Twin(rig, start),
        source.experiments,
        free=[name for name, row in rig.parameters.items() if row.free and name not in EDGES]
        + [AMBIENT, START],
        on_progress=_news(progress),
    )
    rows = [row for row in fit.parameters.values() if row.free and row.scope != "recording"]
    deviations = [_deviation(row, truth[row.name]) for row in rows]
    inside = sum(abs(deviation) <= 2 for deviation in deviations)
    worst = max(abs(row.value / truth[row.name] - 1) for row in rows)
    section = Section(
        "A truth to compare with",
        (
            Text(
                "The synthetic recordings were made by a twin with known parameters and camera "
                "noise of 0.1 K. A match that starts at Table 4's initial values finds them again. "
                "Held at their true values are the five resistances of the plate's edges: they "
                "carry 6 % of what the faces lose, and such noise hides them."
            ),
            KeyNumbers(
                (
                    (f"{inside} of {len(rows)}", "within two standard errors of the truth"),
                    (f"{100 * worst:.1f} %", "largest error of a parameter"),
                    (f"{fit.rmse:.3f} K", "RMSE (noise put in: 0.1 K)"),
                    (f"{fit.wall_time:.1f} s", f"for {fit.history[-1].number} iterations"),
                )
            ),
            ReportTable(
                "Truth and match; the ratio is that of the error to the standard error, both of "
                "the logarithm, by which positive parameters are matched.",
                (
                    "parameter",
                    "unit",
                    "truth",
                    "matched",
                    "95 % interval",
                    "error",
                    "error / std. error",
                ),
                [
                    (
                        row.name,
                        row.unit,
                        f"{truth[row.name]:g}",
                        f"{row.value:.4g}",
                        interval_text(row.interval),
                        f"{100 * (row.value / truth[row.name] - 1):+.2f} %",
                        f"{deviation:+.2f}",
                    )
                    for row, deviation in zip(rows, deviations, strict=True)
                ],
            ),
        ),
        level=3,
    )
    numbers = {
        "within_two_standard_errors": inside,
        "parameters": len(rows),
        "largest_relative_error": worst,
        **fit.to_dict(),
    }
    return section, numbers


def _deviation(row: FittedParameter, truth: float) -> float:
    """The error of a value in standard errors, on the scale of the match."""
    if row.is_logarithmic:
        return math.log(row.value / truth) / row.relative_standard_error
    return (row.value - truth) / row.standard_error


def _what_is_left(source: Source, runs: list[Run]) -> str:
    shared = "What all channels of a recording share (black)"
    if shows_sawtooth(runs):
        return (
            f"What is left. {shared} jumps within a second, which a plate cannot do: the camera "
            "recalibrates itself."
        )
    if source.real:
        return f"What is left. {shared} is what the circuit or the surroundings lack."
    return (
        "What is left: the noise that was put in, and the start temperatures, which differ between "
        "the recordings and are held at 15 °C here."
    )


def _fit_table(published: list[Run], fixed: Fit, own: Fit) -> ReportTable:
    rows = []
    for run in published:
        name = run.experiment.name
        for channel, before in run.fit_percent.items():
            after = (fit.fit_percent[name, channel] for fit in (fixed, own))
            rows.append((name, channel, *(f"{value:.1f}" for value in (before, *after))))
    means = (_mean_fit(published), fixed.mean_fit_percent, own.mean_fit_percent)
    rows.append(("mean", "", *(f"!{value:.1f}" for value in means)))
    head = ("recording", "channel", "published", "ambient 15 °C", "ambient per recording")
    return ReportTable("NRMSE fit of each channel, %.", head, rows)


def _mean_fit(runs: Iterable[Run]) -> float:
    return mean_fit_percent(fit for run in runs for fit in run.fit_percent.values())


def _start(run: Run) -> float:
    """Mean of all channels over the first five samples, degC."""
    return float(np.mean(recorded(run.experiment)[:5]))


def _news(progress: Progress, starts: int = 1) -> Callable[[Iteration], None]:
    def show(iteration: Iteration) -> None:
        where = f"start {iteration.start + 1} of {starts}, " if starts > 1 else ""
        progress.update(f"{where}iteration {iteration.number}, RMSE {iteration.rmse:.3f} K")

    return show


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
