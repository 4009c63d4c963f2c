"""A fit as text: the table that people paste."""

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ._fit import Fit, FittedParameter

COLUMNS = ("parameter", "initial", "published", "ours", "std. error", "min", "max", "unit", "")


def summary_table(fit: "Fit") -> str:
    """Table 4 of the paper with our column, then the fit of each channel."""
    rows = [COLUMNS, *(_row(row) for row in fit.parameters if row.free)]
    held = [row for row in fit.parameters if not row.free]
    widths = [max(len(row[column]) for row in rows) for column in range(len(COLUMNS))]
    lines = [
        f"{fit.twin.rig.name} matched to {', '.join(fit.recordings)}",
        f"mean fit {fit.mean_fit_percent:.2f} %   RMSE {fit.rmse:.4f} K",
        f"{len(fit.history) - 1} iterations in {fit.wall_time:.1f} s",
        f"status: {fit.status}",
        "",
    ]
    for row in rows:
        cells = [row[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(row[1:7], widths[1:7], strict=True)]
        cells += [cell.ljust(width) for cell, width in zip(row[7:], widths[7:], strict=True)]
        lines.append("  ".join(cells).rstrip())
    if held:
        values = ", ".join(f"{row.name} = {row.value:.4g} {row.unit}".rstrip() for row in held)
        lines += ["", f"held: {values}"]
    own = {name: values for name, values in fit.recording_values.items() if values}
    for name, values in own.items():
        text = ", ".join(f"{key} = {value:.4g}" for key, value in values.items())
        lines.append(f"{name}: {text}")
    lines += ["", "fit of each channel, 100 (1 - |y - yhat| / |y - mean y|), %:"]
    for name in fit.recordings:
        channels = [
            f"{channel} {value:.1f}"
            for (recording, channel), value in fit.fit_percent.items()
            if recording == name
        ]
        lines.append(f"{name}: {', '.join(channels)}")
    return "\n".join(lines)


def _row(row: "FittedParameter") -> tuple[str, ...]:
    error = row.standard_error
    spread = "-" if math.isnan(error) else "unknown" if math.isinf(error) else f"{error:.2g}"
    published = "-" if row.published is None else f"{row.published:.4g}"
    return (
        row.name,
        f"{row.initial:.4g}",
        published,
        f"{row.value:.4g}",
        spread,
        f"{row.lower:.3g}",
        f"{row.upper:.3g}",
        row.unit or "1",
        "at bound" if row.at_bound else "",
    )
