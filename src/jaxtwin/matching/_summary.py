"""A fit as a table in plain text, Markdown or LaTeX, and as a labelled dataset."""

import math
from textwrap import wrap
from typing import TYPE_CHECKING, Literal

import numpy as np

from .._display import aligned
from .._number_text import interval_text, short_number
from .._result import dataset
from .._statistics import fit_text
from ._start import replaced_by_recorded_room, room_parameters

if TYPE_CHECKING:
    import xarray

    from ._fit import Fit
    from ._fitted_parameters import FittedParameter

Style = Literal["text", "markdown", "latex"]

COLUMNS = (
    "parameter",
    "initial",
    "published",
    "matched",
    "95 % interval",
    "prior",
    "min",
    "max",
    "unit",
    "",
)
# The width of plain text, in characters.
WIDTH = 100

# The columns that are aligned to the right.
NUMBERS = slice(1, 8)

# Below this spread of a logarithm a prior is shown with its per cent: its factor is about 1.
SMALL_SPREAD = 0.05

# A larger `Fit.solver_gap` is mentioned, K: a tenth of the RMSE of a good match.
LARGE_GAP = 0.01


def summary_table(fit: "Fit", style: Style = "text") -> str:
    """Table 4 of the paper with the matched values, 95 % intervals, priors and warnings.

    The plain text also contains the fit of each channel and the undetermined directions.
    """
    rows = [_row(row) for row in fit.parameters.values() if row.free]
    if style == "markdown":
        return _markdown(rows)
    if style == "latex":
        return _latex(rows)
    return _text(fit, rows)


def fit_dataset(fit: "Fit") -> "xarray.Dataset":
    """Implements `Fit.to_xarray`."""
    table, recordings = tuple(fit.parameters.values()), fit.recording_values.values()
    own = list(next(iter(recordings)))
    own_values = [[values[name] for name in own] for values in recordings]
    channels = list(dict.fromkeys(channel for names in fit.channels for channel in names))
    fits = [
        [fit.fit_percent.get((name, channel), math.nan) for channel in channels]
        for name in fit.recordings
    ]
    numbers = {
        name: ("parameter", [getattr(row, name) for row in table])
        for name in ("value", "initial", "standard_error", "lower", "upper", "free", "unit")
    }
    labels, by_recording = fit.uncertainty.labels, "recording own_parameter"
    return dataset(
        {
            **numbers,
            "interval": ("parameter bound", [row.interval for row in table]),
            "recording_value": (by_recording, np.reshape(own_values, (len(recordings), len(own)))),
            "fit_percent": ("recording channel", fits, "%"),
            "covariance": ("entry other_entry", fit.uncertainty.covariance),
            "correlation": ("entry other_entry", fit.uncertainty.correlation, "1"),
            "rmse": ("iteration", [step.rmse for step in fit.history], "K"),
        },
        {"rig": fit.twin.rig.name, "status": fit.status, "date": fit.date},
        parameter=[row.name for row in table],
        bound=["lower", "upper"],
        recording=fit.recordings,
        own_parameter=own,
        channel=channels,
        entry=labels,
        other_entry=labels,
        iteration=[step.number for step in fit.history],
    ).set_coords("unit")


def _text(fit: "Fit", rows: list[tuple[str, ...]]) -> str:
    lines = [
        f"{fit.twin.rig.name} matched to {', '.join(fit.recordings)}",
        (
            f"mean fit {fit.mean_fit_percent:.2f} %   RMSE {fit.rmse:.4f} K   "
            f"{fit.history[-1].number} iterations in {fit.wall_time:.1f} s"
        ),
        f"status: {fit.status}",
        "",
    ]
    if fit.solver_gap > LARGE_GAP:
        lines[3:3] = [f"steps of the match too long for these values: {fit.solver_gap:.2g} K off"]
    for note in fit.notes:
        lines[-1:-1] = wrap(note, WIDTH, subsequent_indent="  ")
    lines.append(aligned([COLUMNS, *rows], right=NUMBERS))
    held = [row for row in fit.parameters.values() if not row.free]
    replaced = frozenset[str]()
    if all(sample.ambient is not None for sample in fit.first_samples):
        replaced = replaced_by_recorded_room(fit.twin.rig)
        without_effect = [row.name for row in held if row.name in replaced]
        held = [row for row in held if row.name not in replaced]
        if without_effect:
            text = f"replaced by the recorded ambient temperature: {', '.join(without_effect)}"
            lines += ["", *wrap(text, WIDTH, subsequent_indent="  ")]
    if held:
        values = ", ".join(f"{row.name} = {row.value:.4g} {row.unit}".rstrip() for row in held)
        lines += ["", *wrap(f"fixed: {values}", WIDTH, subsequent_indent="  ")]
    of_groups = {name for values in fit.group_values.values() for name in values}
    of_recordings = {
        name: {key: value for key, value in values.items() if key not in of_groups}
        for name, values in fit.recording_values.items()
    }
    of_groups = fit.group_values if len(fit.group_values) > 1 else {}
    for name, values in [*of_groups.items(), *of_recordings.items()]:
        if not values:
            continue
        text = ", ".join(f"{key} = {value:.4g}" for key, value in values.items())
        lines.append(f"{name}: {text}")
    for name, events in fit.events.items():
        if events:
            times = ", ".join(f"{event:g}" for event in events)
            lines.append(f"{name}: corrections of the camera at {times} s")
    lines += ["", "fit of each channel, 100 (1 - |y - yhat| / |y - mean y|), %:"]
    for name in fit.recordings:
        channels = [
            f"{channel} {fit_text(value)}"
            for (recording, channel), value in fit.fit_percent.items()
            if recording == name
        ]
        lines.append(f"{name}: {', '.join(channels)}")
    lines += ["", "identifiability:", fit.uncertainty.report(replaced), *_room_beside_losses(fit)]
    return "\n".join(lines)


def _markdown(rows: list[tuple[str, ...]]) -> str:
    rule = ["---"] + ["---:"] * (NUMBERS.stop - NUMBERS.start) + ["---", "---"]
    return "\n".join(f"| {' | '.join(row)} |" for row in (COLUMNS, rule, *rows))


def _latex(rows: list[tuple[str, ...]]) -> str:
    """A `tabular` for the package booktabs."""
    lines = [r"\begin{tabular}{l" + "r" * (NUMBERS.stop - NUMBERS.start) + "ll}", r"\toprule"]
    for number, row in enumerate((COLUMNS, *rows)):
        cells = " & ".join(_escaped(cell) for cell in row)
        lines.append(cells + r" \\")
        lines += [r"\midrule"] * (number == 0)
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"])


def _escaped(text: str) -> str:
    for sign in "&%$#_{}":
        text = text.replace(sign, f"\\{sign}")
    return text.replace("^", r"\textasciicircum{}")


def _row(row: "FittedParameter") -> tuple[str, ...]:
    published = "-" if row.published is None else short_number(row.published)
    return (
        row.name,
        short_number(row.initial),
        published,
        short_number(row.value),
        interval_text(row.interval),
        prior_text(row),
        short_number(row.lower, 3),
        short_number(row.upper, 3),
        row.unit or "1",
        ", ".join(row.warnings),
    )


def prior_text(row: "FittedParameter") -> str:
    """A prior for tables: its centre, and its standard deviation, part of it, or factor."""
    if row.prior_spread is None or row.prior_value is None:
        return "-"
    if row.is_logarithmic and row.prior_spread < SMALL_SPREAD:
        return f"{row.prior_value:.4g} (+- {100 * row.prior_spread:.2g} %)"
    if row.is_logarithmic:
        return f"{row.prior_value:.4g} (factor {math.exp(row.prior_spread):.3g})"
    return f"{row.prior_value:.4g} (+- {row.prior_spread:.3g})"


def _room_beside_losses(fit: "Fit") -> list[str]:
    """What to do if a room that was not recorded and a loss to it stand for each other: the usual
    trap of a rig without a thermometer in the room. No line if there is no such pair."""
    rooms = room_parameters(fit.twin.rig)
    names = {name for pair in fit.uncertainty.collinear for name in pair[:2]}
    if not any(label.split("[")[0] in rooms for label in names):
        return []
    advice = (
        "the room was not recorded: a warmer room and a smaller loss fit as well; its temperature "
        "in the recording (ambient), or a recording that starts cold and at rest, tells them apart"
    )
    return [advice]
