"""The recordings of a report, the simulated temperatures beside them, tests of the difference, and
the uniformity of the plate, which a multizone rig is built to control.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from .._number_text import short_number
from .._statistics import fit_text
from ..errors import RecordingError
from ..io import Experiment
from ..matching import Fit, detect_events
from ..plots import (
    plot_camera_error,
    plot_comparison,
    plot_plate_beside,
    plot_recordings,
    plot_residual_tests,
    plot_residuals,
    plot_uniformity,
    to_png,
)
from ..simulation import Run
from ..validation import whiteness_of_channels
from ._page import Block, ReportPicture, ReportTable, Section, Text

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


# The smallest number of samples of a channel for a test of its residuals.
MIN_SAMPLES = 10


def agreement_section(fit: Fit, title: str) -> Section:
    """The section that compares the matched twin with its recordings."""
    return Section(
        title,
        (
            ReportPicture(
                "response",
                to_png(plot_comparison(list(fit.runs.values()))),
                "Matched twin against recording. The fit of a channel is "
                "100 (1 - |y - ŷ| / |y - mean y|) %.",
            ),
            _fit_table(fit),
        ),
    )


def residuals_section(fit: Fit, title: str) -> Section:
    """Residuals over time, the camera's share in them, and tests of the remaining residuals."""
    runs = list(fit.runs.values())
    blocks: list[Block] = [
        ReportPicture(
            "residuals",
            to_png(plot_residuals(runs, weights=list(fit.weights.values()))),
            "Recorded minus simulated temperature. The black line is the mean of the channels. "
            "Shaded samples had less weight in the match.",
        )
    ]
    if fit.twin.rig.common_error is not None:
        blocks += [
            Text(
                "The camera has an error that all channels share. The match estimated it together "
                "with the parameters, and the tests below are of the residuals without it."
            ),
            ReportPicture(
                "camera-error",
                to_png(plot_camera_error(fit)),
                "The mean residual of the channels with the camera's error (top) and without it "
                "(bottom).",
            ),
        ]
    read = [_as_read(fit, name) for name in fit.runs]
    tested = [run for run in read if _can_be_tested(run)]
    if tested:
        blocks += [
            ReportPicture(
                "residual-tests",
                to_png(plot_residual_tests(tested)),
                "Residuals over time, their autocorrelation, and their quantiles beside those of "
                "a normal distribution.",
            ),
            _whiteness_table(tested),
        ]
    return Section(title, tuple(blocks))


def _fit_table(fit: Fit) -> ReportTable:
    has_camera = fit.camera_error > 0
    plant = fit.plant_fit_percent
    rows = []
    for (recording, channel), percent in fit.fit_percent.items():
        run = fit.runs[recording]
        column = run.channels.index(channel)
        residual = recorded(run.experiment)[:, column] - run.temperatures[:, column]
        rows.append(
            (
                recording,
                channel,
                fit_text(percent),
                *[fit_text(plant[recording, channel])] * has_camera,
                f"{np.sqrt(np.nanmean(residual**2)):.3f}",
            )
        )
    camera = (
        " The first fit includes the estimated error of the camera; the second fit and the RMSE "
        "are of the twin of the plate alone."
    )
    return ReportTable(
        f"NRMSE fit of each channel, %, and RMSE, K.{camera * has_camera}",
        ("recording", "channel", "fit", *["fit without camera"] * has_camera, "RMSE"),
        rows,
    )


def _as_read(fit: Fit, name: str) -> Run:
    """A run with the camera's estimated error in its readings."""
    run = fit.runs[name]
    return replace(run, temperatures=run.temperatures + fit.camera[name].offset[:, None])


def _can_be_tested(run: Run) -> bool:
    return int(np.count_nonzero(run.experiment.sampled, axis=0).min()) >= MIN_SAMPLES


def _whiteness_table(runs: list[Run]) -> ReportTable:
    rows = []
    for run in runs:
        step = float(np.median(np.diff(run.time)))
        residuals = recorded(run.experiment) - run.temperatures
        tests = whiteness_of_channels(residuals)
        for channel, series, test in zip(run.channels, residuals.T, tests, strict=True):
            rows.append(
                (
                    run.experiment.name,
                    channel,
                    f"{np.nanstd(series):.3f}",
                    f"{np.nanmean(series):+.3f}",
                    short_number(test.autocorrelation_time * step, 3),
                    short_number(test.p_value, 2),
                )
            )
    return ReportTable(
        "Tests of the residuals. Samples within the autocorrelation time count as one. A p-value "
        "of Ljung and Box's test below 0.01, adjusted for the number of channels (Holm), means "
        "that the residuals are not white noise.",
        ("recording", "channel", "std. dev., K", "mean, K", "autocorrelation time, s", "p"),
        rows,
    )


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


# The smallest number of corrections that make a sawtooth; a single jump may have another cause.
MIN_SAWTOOTH_JUMPS = 3


def shows_sawtooth(runs: Iterable[Run]) -> bool:
    """Whether in one of the recordings all channels jump together repeatedly. A plate cannot do so,
    but an infrared camera that corrects itself does.

    **Arguments:**

    - `runs`: the runs of recordings by a twin with small residuals.
    """
    return any(len(_corrections(run)) >= MIN_SAWTOOTH_JUMPS for run in runs)


def _corrections(run: Run) -> tuple[float, ...]:
    difference = recorded(run.experiment) - run.temperatures
    complete = np.asarray(np.isfinite(difference).all(axis=1))
    common = np.where(complete, difference.mean(axis=1), 0.0)
    return detect_events(run.time, common, complete)
