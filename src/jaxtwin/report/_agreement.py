"""Recorded beside simulated temperatures, and tests of their difference."""

from dataclasses import replace

import numpy as np

from .._goodness_of_fit import fit_text
from .._number_text import short_number
from ..matching import Fit
from ..plots import (
    plot_camera_error,
    plot_comparison,
    plot_residual_tests,
    plot_residuals,
    to_png,
)
from ..simulation import Run
from ..validation import whiteness_of_channels
from ._blocks import Block, ReportPicture, ReportTable, Section, Text
from ._recordings import recorded

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
