"""The uniformity of the plate, which a multizone rig is built to control."""

import numpy as np

from ..matching import Fit
from ..plots import plot_plate_beside, plot_uniformity, to_png
from ..simulation import Run
from ._blocks import ReportPicture, ReportTable, Section, Text
from ._corrections import shows_sawtooth

# The times of the maps, as parts of a recording.
MAP_PARTS = (0.1, 0.5, 1.0)


def uniformity_section(fit: Fit, *, level: int = 2) -> tuple[Section, dict[str, dict[str, float]]]:
    """Range and standard deviation over the channels and the plate, recorded beside simulated.

    **Arguments:**

    - `fit`: a fit of a rig with two channels or more.
    - `level`: the level of the section.

    **Returns:** the section, and its numbers for each recording.
    """
    runs = list(fit.runs.values())
    numbers = {name: _numbers(run) for name, run in fit.runs.items()}
    words = (
        "The range over the channels (highest minus lowest temperature) and their standard "
        "deviation measure how far the plate is from being evenly warm."
    )
    if fit.twin.rig.camera is not None:
        words += " What all channels share does not change them"
        words += ", so the camera's sawtooth drops out." if shows_sawtooth(runs) else "."
    together = _seen_together(runs)
    section = Section(
        "Uniformity",
        (
            Text(words),
            ReportTable(
                "Means over time, K. The range of the plate is that of all its elements, of which "
                "the channels see a part.",
                (
                    "recording",
                    "mean range",
                    "twin",
                    "mean standard deviation",
                    "twin",
                    "plate, mean",
                ),
                [
                    (name, *(f"{value:.2f}" for value in row.values()))
                    for name, row in numbers.items()
                ],
            ),
            ReportPicture(
                "uniformity",
                to_png(plot_uniformity(runs)),
                "Range and standard deviation over the channels, recorded and simulated.",
            ),
            ReportPicture(
                "plate-beside",
                to_png(plot_plate_beside(fit.twin.rig, together, _map_times(together))),
                "From top to bottom: the simulated plate between its nodes, its simulated "
                "readings, the recorded ones, and their difference. Recordings: "
                f"{', '.join(run.experiment.name for run in together)}.",
            ),
        ),
        level=level,
    )
    return section, numbers


def _seen_together(runs: list[Run]) -> list[Run]:
    """The first run, and those with the same drive that show other places of the plate."""
    first, *others = runs
    chosen, covered = [first], set(first.channels)
    for run in others:
        same = np.array_equal(run.experiment.duty, first.experiment.duty)
        if same and not covered & set(run.channels):
            chosen.append(run)
            covered |= set(run.channels)
    return chosen


def _map_times(runs: list[Run]) -> list[float]:
    """Sampled times of the first run that all runs reach, s."""
    start = max(float(run.time[0]) for run in runs)
    end = min(float(run.time[-1]) for run in runs)
    return [start + round(part * (end - start), 1) for part in MAP_PARTS]


def _numbers(run: Run) -> dict[str, float]:
    recorded, twin = run.recorded_uniformity, run.uniformity
    return {
        "recorded_mean_range_K": recorded.mean_range,
        "twin_mean_range_K": twin.mean_range,
        "recorded_mean_std_K": recorded.mean_std,
        "twin_mean_std_K": twin.mean_std,
        "plate_mean_range_K": run.plate_uniformity.mean_range,
    }
