"""A rig of a fleet: its twin, the lane that follows it, and what is known of it."""

import hashlib
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, final

import jax
import numpy as np
from jaxtyping import Float

from .._celsius import ZERO_CELSIUS
from ..errors import RecordingError
from ..io import Experiment
from ..live import CALM_SECONDS, Finding, seconds
from ..monitoring import (
    DAY,
    KINDS,
    Evidence,
    LiveFindings,
    Monitor,
    MonitorCalibration,
    channels_of,
    nominal_calibration,
    response_of,
)
from ..observers import Moment, ProcessNoise, live_observer
from ..physics import Twin
from ..rig import load_rig, read_parameters
from ..serve._contents import Outlook, look_ahead
from ..serve._history import History
from ..serve._live_diagnosis import DELAYS
from ..serve._page import COMPARED_SECONDS
from ..serve._story import Reason, Sentence, Situation, is_rig_well, is_twin_right, what_comes
from ..twin_store import TwinStore
from ._fleet_file import Member
from ._journal import FleetJournal, Message, StoredState
from ._lanes import Lanes, Watcher
from ._sample_queue import ObserverStep, SampleQueue

# The mean time between two false alarms of a rig, s.
FALSE_ALARM_TIME = 30 * DAY

# What is drawn of a rig: an hour in intervals of 10 s, which takes 0.1 MB of a rig of 15 channels.
LEVELS = ((10.0, 360),)

# The number of findings that are over and are kept in memory, and of lines of the log.
MAX_ENDED_FINDINGS = 20
MAX_LINES = 30

# A forecast that is older is not shown, s of the rig: it would be compared with readings of now.
MAX_FORECAST_AGE = 30.0

# The 95 % limit of a normal number.
LIMIT_95 = 1.96

# The length of the recording that is diagnosed or refitted to, s, and the number of messages in
# which it is sought, enough for a rig that sends ten times a second.
RECENT_SECONDS = 1500.0
RECENT_MESSAGES = 30_000


class WatchedTwin(NamedTuple):
    """What is made from the files of a rig: its twin, its observer and monitor, and what it was
    made with.

    - `key`: tells one twin, with its noise and calibration, from another.
    """

    member: Member
    files: tuple[tuple[str, int], ...]
    twin: Twin
    label: str
    noise: ProcessNoise | None
    calibration: MonitorCalibration
    watcher: Watcher
    key: str


def watched_twin(member: Member) -> WatchedTwin:
    """Makes the twin of a rig, and what watches it.

    **Raises:** the errors of its files.
    """
    files, rig = member.files, load_rig(member.rig)
    noise, label, values = None, "values of the rig file", dict[str, float]()
    if member.store is not None:
        version = TwinStore(member.store).version("champion")
        noise, label = version.noise, f"version {version.number} of {member.store.name}"
        values = read_parameters(Path(version.address), rig)
    elif member.parameters is not None:
        values = read_parameters(member.parameters, rig)
        label = f"values of {member.parameters.name}"
    if member.noise is not None:
        noise = ProcessNoise.load(member.noise)
    twin = Twin(rig, values)
    observer = live_observer(twin, noise, member.sample_time)
    calibration = nominal_calibration(channels_of(observer.model), member.sample_time)
    if member.calibration is not None:
        calibration = MonitorCalibration.load(member.calibration)
    monitor = Monitor(observer, calibration, response_of(observer), FALSE_ALARM_TIME)
    digest = hashlib.sha256(rig.fingerprint.encode())
    for leaf in jax.tree.leaves((observer, monitor)):
        digest.update(np.asarray(leaf).tobytes())
    return WatchedTwin(
        member, files, twin, label, noise, calibration, (observer, monitor), digest.hexdigest()
    )


@final
class WatchedRig:
    """A rig in a lane of a block.

    **Arguments:**

    - `made`: its twin. `lanes`, `lane`: the block, and its place there.
    - `silence`: the time without readings after which there is an alarm, s.
    - `tell`: called with each new finding.
    """

    def __init__(
        self,
        made: WatchedTwin,
        lanes: Lanes,
        lane: int,
        silence: float,
        tell: Callable[["WatchedRig", Finding], None],
    ):
        self.made, self.lanes, self.lane = made, lanes, lane
        self.name, self.group = made.member.name, made.member.group
        rig = made.twin.rig
        self.queue = SampleQueue(rig, made.member.sample_time, made.watcher[0].longest_seconds)
        self.history = History(len(rig.channels), len(rig.driven), LEVELS)
        self.cause: Reason | None = None
        """What explains the findings most likely; None: nobody has said."""
        self.fault = ""
        """Its name without its size, such as `loosen P1`, which other rigs may share."""
        self.diagnosis: dict[str, Any] = {"state": "none", "causes": []}
        """What a page shows of the last diagnosis."""
        self.due: list[float] = []
        """The times of the rig at which it is to be diagnosed, s since 1970."""
        self.lines: deque[dict[str, Any]] = deque(maxlen=MAX_LINES)
        """What happened."""
        self.measured: Float[np.ndarray, " channels"] | None = None
        """The last readings, degC."""
        self.expected = np.full(len(rig.channels), np.nan)
        """What was expected of them, degC."""
        self._later: tuple[int, Moment] | None = None  # the time of a forecast, and what it says
        self.recorded_since = 0.0
        """The time of the first reading of the last recording of it, s since 1970."""
        self._silence, self._tell = silence, tell
        limit = rig.maximum_temperature
        self._limit = None if limit is None else limit - ZERO_CELSIUS
        self._findings = LiveFindings(
            made.watcher[1], made.calibration, FALSE_ALARM_TIME, self._found, MAX_ENDED_FINDINGS
        )
        self._alarms: dict[str, tuple[Finding, float]] = {}  # kind -> alarm, when it was there last
        self._since = self._heard = 0.0  # s of the monotonic clock
        self._observed, self._problem = 0.0, ""
        self.error = self.nis = 0.0
        """The root mean square of readings minus expected readings in the last minutes, K, and the
        mean normalised innovation squared."""
        self.coverage = 1.0
        """The share of the readings of the last minutes in the 95 % band of what was expected."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is there now: alarms, and the findings of the monitor."""
        alarms = (alarm for alarm, _ in list(self._alarms.values()))
        return (*alarms, *self._findings.present)

    @property
    def age(self) -> float | None:
        """The time since the last message with readings, s; None: there was none."""
        return time.monotonic() - self._heard if self._heard else None

    def hear(self, message: Message) -> None:
        """Takes a message."""
        if message.kind == "readings":
            self._heard = time.monotonic()
        self.queue.put(message.kind, message.payload, message.number)

    def take(
        self, step: ObserverStep, evidence: Evidence, expected: np.ndarray, white: np.ndarray
    ) -> None:
        """Takes what the lane says of readings."""
        assert step.readings is not None
        self.measured, self.expected = step.readings, expected
        self._observed = 0.0 if step.begins else self._observed + step.elapsed
        valid = np.isfinite(step.readings)
        if valid.any():
            weight = 1.0 - np.exp(-step.elapsed / COMPARED_SECONDS)
            share = float(np.mean(np.abs(white[valid]) <= LIMIT_95))
            self.coverage += weight * (share - self.coverage)
            square = float(np.mean((step.readings - expected)[valid] ** 2))
            self.error = float(np.sqrt(self.error**2 + weight * (square - self.error**2)))
            self.nis += weight * (float(np.mean(white[valid] ** 2)) - self.nis)
        # Without a score from a half on there is nothing to be begun, nor to go on.
        if self._findings.is_any_present or (evidence.score >= 0.5).any():
            self._findings.take(self.queue.time, evidence)
        band = np.full(len(expected), np.nan)
        self.history.add(seconds(self.queue.time), step.readings, expected, band, self.queue.duty)

    def diverge(self) -> None:
        """Begins again after the observer has diverged."""
        self.queue.counts["diverged"] += 1
        self.queue.restart()

    def update_alarms(self, problem: str) -> None:
        """Raises and ends the alarms of silence, temperature and channels. With a `problem` of the
        connection, such as a broker that is gone, no rig is called silent."""
        self._since = self._since or time.monotonic()
        self._problem = problem
        age = time.monotonic() - (self._heard or self._since)
        text = f"no readings for more than {self._silence:g} s"
        self._set("silent", age > self._silence and not problem, text)
        hottest = -np.inf
        if self.measured is not None and np.isfinite(self.measured).any():
            hottest = float(np.nanmax(self.measured))
        is_hot = self._limit is not None and hottest > self._limit
        self._set("over-temperature", is_hot, f"a channel is at {hottest:.1f} degC")
        failed = [] if self.measured is None else np.flatnonzero(np.isnan(self.measured)).tolist()
        names = ", ".join(self.made.twin.channels[place] for place in failed)
        self._set("channel-fault", bool(failed), f"no reading of {names}")

    def story(self) -> dict[str, Sentence]:
        """Is the rig well, is its twin right, what comes."""
        names, measured = self.made.twin.channels, self.measured
        none = np.full(len(names), np.nan)
        readings = none if measured is None else measured
        age, alarms = self.age, self._alarms
        # Of a rig that sends once a minute nothing is missing for a minute.
        is_silent = "silent" in alarms
        situation = Situation(
            channels=names,
            readings=readings,
            links={"to the broker": "down" if self._problem else "live"},
            refusals={},
            age=None if age is None else age if is_silent else 0.0,
            silent=0.0,
            faults={name: "no number" for name, reading in zip(names, readings, strict=True)
                    if measured is not None and np.isnan(reading)},
            trip="",
            still_on="",
            limit=self._limit,
            findings=self._findings.present,
            cause=self.cause,
            is_awaited=bool(self.due),
            acknowledged=0,
            problem="",
            ended=False,
            observed=self._observed,
            within=self.coverage,
            # Whitened readings have a deviation of 1 where the observer is right.
            band=LIMIT_95 * self.error / np.sqrt(max(self.nis, 1e-12)),
            compared=min(self._observed, COMPARED_SECONDS),
            later=self._fresh_forecast,
        )  # fmt: skip
        sentences = is_rig_well(situation), is_twin_right(situation), what_comes(situation)
        return dict(zip(("rig", "twin", "minute"), sentences, strict=True))

    def forecast(self, readings: Moment) -> None:
        """Takes the readings that are expected in a minute."""
        self._later = self.queue.time, readings

    @property
    def _fresh_forecast(self) -> Moment | None:
        """The readings that are expected in a minute; None if nothing is known, or it is old."""
        if self.measured is None or self._later is None:
            return None
        time, readings = self._later
        return readings if seconds(self.queue.time - time) <= MAX_FORECAST_AGE else None

    def outlook(self) -> Outlook | None:
        """What the twin says of now and of the next minute; None while there is no reading."""
        if self.measured is None:
            return None
        result = look_ahead(self.made.watcher[0], self.lanes.kalman(self.lane), self.queue.duty)
        self.forecast(Moment(result.readings.mean[-1], result.readings.spread[-1]))
        return result

    def recorded(self, journal: FleetJournal) -> Experiment:
        """The last minutes as a recording.

        **Raises:** `RecordingError` if there are fewer than two readings.
        """
        rig = self.made.twin.rig
        duty, ambient, rows = np.zeros(len(rig.driven)), np.nan, []
        apart = 0.5 * self.made.member.sample_time
        for message in journal.last(self.name, RECENT_MESSAGES):
            sample = self.queue.parsed(message.kind, message.payload)
            if sample is None:
                continue
            passed = seconds(sample.time - rows[-1][0]) if rows else np.inf
            if sample.duty is not None:
                duty, ambient = sample.duty, sample.ambient
                if passed < apart:  # it holds from that reading on, nearly
                    rows[-1] = (rows[-1][0], duty, *rows[-1][2:])
            elif passed >= apart:
                rows.append((sample.time, duty, sample.readings, ambient))
        rows = [row for row in rows if seconds(rows[-1][0] - row[0]) <= RECENT_SECONDS]
        if len(rows) < 2:
            raise RecordingError(f"{self.name}: expected readings of the last minutes, got none")
        self.recorded_since = seconds(rows[0][0])
        room = np.array([row[3] for row in rows])
        return Experiment(
            [seconds(row[0] - rows[0][0]) for row in rows],
            [row[1] for row in rows],
            cells=rig.driven,
            channels=self.made.twin.channels,
            temperatures=[row[2] for row in rows],
            ambient=room if np.isfinite(room).any() else None,
            inputs=rig.usual_inputs,
            name=f"{self.name} at {seconds(rows[-1][0]):.0f} s",
        )

    def stored(self) -> StoredState:
        """Its state, for the journal."""
        content = {
            "queue": self.queue.to_dict(),
            "findings": self._findings.to_dict(),
            "cause": self.cause,
            "fault": self.fault,
            "averages": [self._observed, self.error, self.nis, self.coverage],
        }
        return StoredState(self.made.key, content, self.lanes.packed(self.lane))

    def resume(self, stored: StoredState) -> bool:
        """Goes on from the state that the journal has; false if it is that of another twin."""
        if stored.twin != self.made.key or not self.lanes.unpack(self.lane, stored.lane):
            return False
        content = stored.content
        self.queue.resume(content["queue"])
        self._findings.resume(content["findings"])
        self.cause = content["cause"] and Reason(*content["cause"])
        self.fault = content["fault"]
        self._observed, self.error, self.nis, self.coverage = content["averages"]
        return True

    def _set(self, kind: str, is_there: bool, detail: str) -> None:
        """Registers that the cause of an alarm is there, or that it is absent."""
        now = time.monotonic()
        if is_there and kind not in self._alarms:
            at = time.time_ns()
            severity = "warning" if kind == "channel-fault" else "critical"
            alarm = Finding(kind, detail, since=at, severity=severity, found=at)
            self._alarms[kind] = alarm, now
            self._found(alarm)
        elif is_there:
            self._alarms[kind] = replace(self._alarms[kind][0], detail=detail), now
        elif kind in self._alarms and now - self._alarms[kind][1] > CALM_SECONDS:
            del self._alarms[kind]

    def _found(self, finding: Finding) -> None:
        at = seconds(finding.found or 0)
        level = finding.severity if finding.is_alarm else "notice"
        self.lines.append({"t": at, "level": level, "text": f"{finding.kind}: {finding.detail}"})
        if finding.is_alarm and finding.kind in KINDS.values() and not self.due:
            self.due = [at + delay for delay in DELAYS]
            self.diagnosis = {**self.diagnosis, "state": "awaited"}
        self._tell(self, finding)
