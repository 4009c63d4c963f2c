"""The recordings of a report."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..errors import RecordingError
from ..io import Experiment
from ..plots import plot_recordings, to_png
from ._blocks import Block, ReportPicture, ReportTable

# A drive with more levels of duty than these is described by its range.
MANY_LEVELS = 6


def recordings_blocks(
    experiments: Sequence[Experiment],
    caption: str = "Recorded temperatures and the duty cycles of the cells.",
) -> tuple[Block, ...]:
    """The recordings as a picture and as a table.

    **Arguments:**

    - `experiments`: the recordings.
    - `caption`: the caption of the picture.
    """
    return (
        ReportPicture("recordings", to_png(plot_recordings(experiments)), caption),
        ReportTable(
            "The recordings. Start and end are the lowest and highest channel, averaged over the "
            "first 5 and the last 50 samples.",
            ("recording", "samples", "duration, s", "duty, %", "start, °C", "end, °C"),
            [_row(experiment) for experiment in experiments],
        ),
    )


def recorded(experiment: Experiment) -> Float[np.ndarray, "times channels"]:
    """The temperatures of a recording, degC.

    **Raises:** `RecordingError` if it has none.
    """
    if experiment.temperatures is None:
        raise RecordingError(
            f"{experiment.name or 'experiment'}: expected recorded temperatures, got none"
        )
    return experiment.temperatures


def _row(experiment: Experiment) -> tuple[str, ...]:
    temperatures = recorded(experiment)
    return (
        experiment.name,
        str(len(experiment.time)),
        f"{experiment.duration:g}",
        _levels(experiment),
        _range(temperatures[:5]),
        _range(temperatures[-50:]),
    )


def _levels(experiment: Experiment) -> str:
    duty = np.unique(np.round(100 * experiment.duty, 1))
    if len(duty) > MANY_LEVELS:
        return f"{duty[0]:g} to {duty[-1]:g}"
    return ", ".join(f"{level:g}" for level in duty)


def _range(temperatures: Float[np.ndarray, "times channels"]) -> str:
    """The lowest and the highest mean of a channel; `-` if all samples are missing."""
    there = ~np.isnan(temperatures).all(axis=0)
    if not there.any():
        return "-"
    means = np.nanmean(temperatures[:, there], axis=0)
    return f"{means.min():.1f} ... {means.max():.1f}"
