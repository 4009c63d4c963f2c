"""Monitors a recording; the result is a recording that was watched, with its findings."""

import math
import os
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, final

import numpy as np
from jaxtyping import Float

from .._arguments import finite_number, of_kind
from .._display import picture
from .._result import AbstractResult, dataset, table
from .._statistics import QUANTILE_975
from ..errors import ObserverError
from ..io import Experiment, as_experiment
from ..live.safety._interlock import Finding
from ..matching import Fit
from ..observers import Observed, ProcessNoise, observe
from ..physics import Twin
from ._calibrate import calibration_of_recordings, usual_calibration
from ._evidence import Evidences
from ._finding_log import FindingLog, at_sample, events, loudest, together
from ._monitor import SETTLE, Monitor, channels_of, evidences_of
from ._response import response_of
from ._thresholds import DAY, FAMILIES, MonitorCalibration

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


# A logarithm of a rate that is less certain than this, a factor of 1000, is not known.
MAX_SPREAD = 7.0

COLUMNS = ("kind", "channel", "since_s", "found_s", "until_s", "size", "unit", "probability",
           "severity", "detail")  # fmt: skip


@final
@dataclass(frozen=True, eq=False, repr=False)
class Monitored(AbstractResult):
    """What `jaxtwin.monitor` found in a recording.

    **Arguments:**

    - `observed`: the recording and its observer.
    - `monitor`: the monitor. It goes on, live, from nothing.
    - `calibration`: what was taken as healthy.
    - `false_alarm_time`: the mean time between two false alarms, s.
    - `evidences`: what each test said at each sample.
    """

    observed: Observed
    monitor: Monitor
    calibration: MonitorCalibration
    false_alarm_time: float
    evidences: Evidences

    @property
    def experiment(self) -> Experiment:
        """The recording."""
        return self.observed.experiment

    @property
    def time(self) -> Float[np.ndarray, " samples"]:
        """The times of the samples, s."""
        return self.observed.time

    @cached_property
    def findings(self) -> list[Finding]:
        """What was found, in the order of its onset, with times of the recording in s. One that was
        there at the end has no `until`. What begins together in most channels is one finding."""
        log = FindingLog(self.monitor, self.calibration, self.false_alarm_time)
        # Quiet samples open and hold nothing; a last one lets those before clear.
        loud = np.flatnonzero(loudest(self.evidences) >= 0.5)
        for place in sorted({*loud.tolist(), len(self.time) - 1}):
            log.take(float(self.time[place]), at_sample(self.evidences, int(place)))
        return together(log.findings, self.experiment.channels)

    @property
    def alarms(self) -> list[Finding]:
        """The findings at which somebody should look: all but notices."""
        return [finding for finding in self.findings if finding.is_alarm]

    def thresholds(self) -> "pandas.DataFrame":
        """Returns a table with a row for each statistic: its threshold, the recordings or
        simulations that it comes from with their hours, and the 95 % interval of the mean time
        between its false alarms that the extrapolation leaves, days; NaN if it is a usual one, or
        if the recordings hardly know."""
        return table(self._thresholds(), "statistic")

    def to_dataframe(self) -> "pandas.DataFrame":
        """Returns a table with a row for each finding."""
        return table(self._rows(), columns=COLUMNS)

    def to_xarray(self) -> "xarray.Dataset":
        """Returns a labelled dataset: score (time, test), the largest score of each test, which is
        a finding from 1 on; and the columns of `to_dataframe` (finding)."""
        scores = [evidence.score.max(axis=1, initial=0.0) for evidence in self.evidences]
        found = self.to_dataframe()
        return dataset(
            {
                "score": ("time test", np.transpose(scores), "1"),
                "time": ("time", self.time, "s"),
                **{name: ("finding", found[name]) for name in COLUMNS},
            },
            {"recording": self.experiment.name},
            test=self.evidences._fields,
        )

    def _for_json(self) -> dict[str, Any]:
        return {
            "recording": self.experiment.name,
            "duration_s": self.experiment.duration,
            "false_alarm_days": self.false_alarm_time / DAY,
            "alarms": len(self.alarms),
            "findings": [dict(zip(COLUMNS, row, strict=True)) for row in self._rows()],
            "thresholds": self._thresholds(),
        }

    def summary(self) -> str:
        """What was found as text: a line for each event, which are findings that overlap in time.
        `findings` and `to_dataframe` have all of them."""
        name = self.experiment.name or "recording"
        if not self.findings:
            return f"{name}: nothing found in {self.experiment.duration:.0f} s"
        lines = [f"{name}: {_count(len(self.alarms))}"]
        for first, *others in events(self.findings):
            since = min(finding.since or 0.0 for finding in (first, *others))
            ends = [finding.until for finding in (first, *others)]
            known = [end for end in ends if end is not None]
            until = "the end" if len(known) < len(ends) else f"{max(known):.0f} s"
            sure = "" if first.probability is None else f", probability {first.probability:.3g}"
            more = f"; {len(others)} more finding{'s'[: len(others) > 1]}" if others else ""
            lines.append(f"  {since:.0f} s to {until}: {first.kind}: {first.detail}{sure}{more}")
        return "\n".join(lines)

    def plot(self) -> "Figure":
        """Draws the readings, the findings as a timeline below them, and the scores.

        **Returns:** the figure.
        """
        return picture("plot_monitored", self)

    def __repr__(self) -> str:
        name = self.experiment.name or "a recording"
        kinds = ", ".join(sorted({finding.kind for finding in self.findings})) or "nothing found"
        return f"<Monitored {name}: {_count(len(self.alarms))}; {kinds}>"

    def _rows(self) -> list[tuple[Any, ...]]:
        fields = [name.removesuffix("_s") for name in COLUMNS]
        return [tuple(getattr(finding, field) for field in fields) for finding in self.findings]

    def _thresholds(self) -> list[dict[str, Any]]:
        each, rows = self.false_alarm_time * len(FAMILIES), []
        for family in FAMILIES:
            tail = self.calibration.deciding(family, each)
            is_known = tail.spread < MAX_SPREAD
            factor = math.exp(QUANTILE_975 * tail.spread) if is_known else math.nan
            rows.append(
                {
                    "statistic": family,
                    "threshold": tail.threshold(each),
                    "source": tail.source,
                    "hours": tail.hours,
                    "days": each / DAY,
                    "days_lower": each / DAY / factor,
                    "days_upper": each / DAY * factor,
                }
            )
        return rows


def _count(alarms: int) -> str:
    return "1 alarm" if alarms == 1 else f"{alarms or 'no'} alarms"


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
