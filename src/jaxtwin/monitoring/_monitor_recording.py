"""Monitors a recording."""

import os

from .._arguments import finite_number, of_kind
from ..errors import ObserverError
from ..io import Experiment, as_experiment
from ..matching import Fit
from ..observers import Observed, ProcessNoise, observe
from ..physics import Twin
from ._calibrate import calibration_of_recordings, usual_calibration
from ._monitor import SETTLE, Monitor, channels_of, evidences_of
from ._monitored import Monitored
from ._response import response_of
from ._thresholds import DAY, MonitorCalibration

# The shortest mean time between false alarms, s: the tails of the statistics begin there.
MIN_FALSE_ALARM_TIME = 3600.0


def monitor(
    fit: Twin | Fit,
    experiment: Experiment | str | os.PathLike[str],
    noise: ProcessNoise | None = None,
    *,
    calibration: MonitorCalibration | None = None,
    false_alarm_time: float | int = 30 * DAY,
) -> Monitored:
    """Finds what changes in a rig during a recording, and since when.

    The recording is followed as by `jaxtwin.observe`; `jaxtwin.monitoring` describes the tests.

    **Arguments:**

    - `fit`: a fit, or a twin whose values are taken as exact.
    - `experiment`: the recording, or its file.
    - `noise`: the levels of the noise, as for `jaxtwin.observe`.
    - `calibration`: what is healthy, as `jaxtwin.calibrate_monitor` finds it. None: for a fit with
      its recordings, what these say; otherwise usual thresholds.
    - `false_alarm_time`: the mean time between two false alarms, s.

    **Raises:** the errors of `jaxtwin.observe`; `ObserverError` if the recording is too short, if
    false alarms are asked for more often than once an hour, or if the calibration is that of
    another rig.
    """
    seconds = finite_number("monitor: false_alarm_time", false_alarm_time, ObserverError)
    if seconds < MIN_FALSE_ALARM_TIME:
        raise ObserverError(
            f"monitor: false_alarm_time: expected at least {MIN_FALSE_ALARM_TIME:g} s, below "
            f"which no tail is known, got {seconds:g}"
        )
    rig = (fit.twin if isinstance(fit, Fit) else fit).rig
    experiment = as_experiment("monitor: experiment", experiment, ObserverError, rig)
    check_settles(experiment)
    return monitor_observed(observe(fit, experiment, noise), fit, calibration, seconds)


def check_settles(experiment: Experiment) -> None:
    """Refuses a recording in which an observer does not settle.

    **Raises:** `ObserverError`.
    """
    if experiment.duration < 2 * SETTLE:
        raise ObserverError(
            f"{experiment.name or 'experiment'}: expected a recording of at least {2 * SETTLE:g} "
            f"s, in which an observer settles, got {experiment.duration:g} s"
        )


def monitor_observed(
    observed: Observed,
    fit: Twin | Fit,
    calibration: MonitorCalibration | None,
    seconds: float,
) -> Monitored:
    """Finds what changes in a recording that was observed already; the arguments are those of
    `monitor`, with the mean time between false alarms in s."""
    if calibration is None:
        calibration = _calibration(fit, observed)
    check_calibration(calibration, observed)
    response = response_of(observed.observer)
    monitor = Monitor(observed.observer, calibration, response, seconds)
    return Monitored(observed, monitor, calibration, seconds, evidences_of(monitor, observed))


def check_calibration(calibration: MonitorCalibration, observed: Observed) -> None:
    """Checks that a calibration is that of the channels that are read.

    **Raises:** `ObserverError` otherwise.
    """
    of_kind(
        "monitor: calibration", calibration, MonitorCalibration, "a MonitorCalibration",
        ObserverError,
    )  # fmt: skip
    missing = [
        name for name in channels_of(observed.observer.model) if name not in calibration.scales
    ]
    if missing:
        raise ObserverError(
            f"monitor: calibration: expected the channels {', '.join(observed.channels)}, got "
            f"{', '.join(calibration.scales) or 'none'}"
        )


def _calibration(fit: Twin | Fit, observed: Observed) -> MonitorCalibration:
    """What the recordings of the match say; if they are not at hand, what is usual."""
    if isinstance(fit, Fit) and fit.comparisons is not None:
        several = [observe(fit, experiment, observed.noise) for experiment in fit.experiments]
        return calibration_of_recordings(several)
    return usual_calibration(observed)
