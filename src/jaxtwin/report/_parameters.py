"""The matched parameters of a report: values, intervals, priors, correlations, and the sensitivity
of the cost to them.
"""

import re
from collections.abc import Mapping

from .._number_text import interval_text, short_number
from .._progress import Progress
from ..matching import Fit, FittedParameter, prior_text
from ..plots import (
    plot_correlation,
    plot_history,
    plot_parameters,
    plot_sensitivity_matrix,
    plot_tornado,
    to_png,
)
from ..sensitivity_analysis import Sensitivity, sensitivity
from ._page import Block, KeyNumbers, ReportPicture, ReportTable, Section, Text

# The meanings of the warnings of a match.
MEANINGS = {
    "at bound": "the optimum is at a bound",
    "near bound": "the optimum is near a bound",
    "sd from prior": "the recordings contradict the prior",
    "prior only": "the recordings say less than the prior",
    "not determined": "the recordings hardly constrain the parameter, and it has no prior",
    "no effect": "no sample of the recordings depends on the parameter",
    "replaced by the recording": "the recordings hold a measured value instead",
    "correlated": "another parameter can replace it",
}


def parameters_section(fit: Fit, title: str) -> Section:
    """The parameters with intervals and priors, and how they depend on each other."""
    blocks: list[Block] = [
        parameter_table(fit, "The free parameters that all recordings share."),
        ReportPicture(
            "parameters",
            to_png(plot_parameters(fit)),
            "Matched values between their bounds, with the 95 % interval as far as the bounds "
            "reach; the darker part of a bar holds 95 % of the prior.",
        ),
    ]
    if (own := own_values_table(fit)) is not None:
        blocks.append(own)
    blocks += [
        ReportPicture(
            "history", to_png(plot_history(fit)), "RMSE and parameters over the iterations."
        ),
        *_correlation(fit),
    ]
    return Section(title, tuple(blocks))


def fit_numbers(fit: Fit, label: str = "mean fit") -> KeyNumbers:
    """The most important numbers of a match."""
    free = [row for row in fit.parameters.values() if row.free]
    steps = sum(end.iterations for end in fit.optima)
    return KeyNumbers(
        (
            (f"{fit.mean_fit_percent:.1f} %", label),
            (f"{fit.rmse:.2f} K" if fit.rmse >= 0.1 else f"{fit.rmse:.3f} K", "RMSE"),
            (f"{sum(row.at_bound for row in free)} of {len(free)}", "parameters on a bound"),
            (f"{fit.wall_time:.1f} s", f"wall time, {steps} iterations, with compilation"),
        )
    )


def parameter_table(fit: Fit, caption: str) -> ReportTable:
    """The parameters that all recordings share, with published values and priors if there are any.

    **Arguments:**

    - `fit`: the match.
    - `caption`: a sentence before the meanings of the warnings.
    """
    rows = [row for row in fit.parameters.values() if row.free and row.scope != "recording"]
    has_published = any(row.published is not None for row in rows)
    has_prior = any(row.prior_spread is not None for row in rows)
    head = ("parameter", "", "initial", *["published"] * has_published, "matched")
    head += ("95 % interval", *["prior"] * has_prior, "min", "max", "unit", "")
    cells = [_cells(row, has_published, has_prior) for row in rows]
    return ReportTable(" ".join([caption, *_meanings(rows)]), head, cells)


def own_values_table(fit: Fit) -> ReportTable | None:
    """The values that belong to single recordings, with their standard errors; None without any."""
    rows = [row for row in fit.parameters.values() if row.free and row.scope == "recording"]
    if not rows:
        return None
    errors = fit.uncertainty.standard_errors
    head = ("recording", *(f"{row.name}, {row.unit or '1'}" for row in rows))
    return ReportTable(
        "The values that belong to single recordings, ± their standard errors.",
        head,
        [
            (
                name,
                *(f"{values[row.name]:.4g} ± {errors[f'{row.name}[{name}]']:.2g}" for row in rows),
            )
            for name, values in fit.recording_values.items()
        ],
    )


def _cells(row: FittedParameter, has_published: bool, has_prior: bool) -> tuple[str, ...]:
    mark = "!" if row.warnings else ""
    published = "-" if row.published is None else short_number(row.published)
    return (
        row.name,
        row.description,
        short_number(row.initial),
        *[published] * has_published,
        mark + short_number(row.value),
        interval_text(row.interval),
        *[prior_text(row)] * has_prior,
        short_number(row.lower),
        short_number(row.upper),
        row.unit,
        mark + ", ".join(row.warnings),
    )


def _meanings(rows: list[FittedParameter]) -> list[str]:
    """A sentence for each kind of warning that occurs."""
    warnings = {re.sub(r"^[-+.\d]+ ", "", warning) for row in rows for warning in row.warnings}
    return [
        f"{kind[0].upper()}{kind[1:]}: {meaning}."
        for kind, meaning in MEANINGS.items()
        if kind in warnings
    ]


def _correlation(fit: Fit) -> list[Block]:
    known = fit.uncertainty
    if len(known.labels) < 2:
        return []
    count = len(known.unidentifiable)
    words = (
        f"Of {len(known.singular_values)} independent combinations of the parameters, the "
        f"recordings determine {len(known.singular_values) - count} better than what was known "
        "before them."
    )
    blocks: list[Block] = [
        Text(words),
        ReportPicture(
            "correlation",
            to_png(plot_correlation(fit)),
            "Correlation of the errors of the matched values. Two values with a correlation near "
            "1 or −1 cannot be distinguished by these recordings.",
        ),
    ]
    if known.unidentifiable:
        blocks.append(
            ReportTable(
                "Combinations that the recordings determine less than the prior does. The ratio "
                "is the prior's standard deviation over the one that the recordings alone would "
                "give.",
                ("combination", "ratio"),
                [
                    (
                        " ".join(f"{w:+.2f} {label}" for label, w in direction.weights.items()),
                        f"{direction.prior_to_data_ratio:.2g}",
                    )
                    for direction in known.unidentifiable
                ],
            )
        )
    return blocks


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
