"""The contents of the page: a consumer that turns the records of a rig into frames."""

import shutil
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, final, runtime_checkable

import numpy as np

from .._celsius import ZERO_CELSIUS
from .._statistics import QUANTILE_975
from ..live import (
    DISK_BYTES,
    STILL_ON,
    Draws,
    Event,
    Finding,
    Follower,
    Gap,
    LinkChange,
    Reading,
    Record,
    RigState,
    Sample,
    finding_as_json,
    seconds,
)
from ..observers import Estimate, Moment, parameter_estimates
from ..physics import Twin
from ._champion import TwinBeside
from ._contents import HORIZON, STEPS, Outlook, look_ahead, outlook_content, sample_content
from ._frame_ring import FrameRing
from ._history import History
from ._metrics import Metric
from ._rig_layout import rig_layout
from ._story import Reason, Situation, is_rig_well, is_twin_right, what_comes

# The mean time between two pictures of the readings, ns of the host, and the shortest but for what
# one of them is late.
SAMPLE_NS = 100_000_000

# The time between two pictures of what the twin says, ns of the host.
OUTLOOK_NS = 1_000_000_000

# The number of readings above which a picture stands for several: those of a rig that is as fast as
# pictures are come in pairs now and then.
MAX_SINGLE_READINGS = 2

# The number of lines of the log that the page shows.
LINES = 60

_COUNTED = frozenset({"garbage", "nonsense", "duplicate"})  # events that the state counts
# The last time of the rig in which readings are compared with the band of what was expected, s.
COMPARED_SECONDS = 300.0

_MEMORY = 60.0  # s of the rig over which errors are averaged


@runtime_checkable
class LinkStates(Protocol):
    """What a page asks a source for, beside its records."""

    @property
    def states(self) -> Mapping[str, Any]:
        """The state of each link."""
        ...

    @property
    def ended(self) -> bool:
        """Whether no more records will come."""
        ...


@final
class Page:
    """What clients are shown of a rig. It consumes the records of a source, and puts frames into a
    ring: readings ten times a second, what the twin says once a second, and each finding.

    **Arguments:**

    - `ring`: the ring, from which clients read.
    - `source`: the connection or the replay.
    - `beside`: the twin that follows the rig.
    - `about`: what else the page says of its source: `source`, its name; `is_live`, whether its
      records are of now; `recording`, the file; `control`, whether commands are allowed.
    - `raised`: called with each new finding.
    - `disk`: the folder whose disk must not become full; None: there is none.
    """

    def __init__(
        self,
        ring: FrameRing,
        source: LinkStates,
        beside: TwinBeside,
        about: Mapping[str, Any],
        raised: Callable[[Finding], object] = lambda _: None,
        disk: Path | None = None,
    ):
        self.ring = ring
        self.problem = ""
        """What keeps the server from its work, such as a full disk; `""`: nothing."""
        self.cause: Reason | None = None
        """What explains the findings most likely; None: nobody has said."""
        self.records = 0
        """The number of records that were consumed."""
        self.turned = time.monotonic()
        """When the loop turned last, s of the monotonic clock."""
        rig = beside.twin.rig
        self.history = History(len(rig.channels), len(rig.driven))
        self._source, self._about, self._raised, self._disk = source, about, raised, disk
        self._lines: deque[dict[str, Any]] = deque(maxlen=LINES)
        self._energy = 0.0
        self._state = RigState()
        self._due = self._looked = self._heard = 0  # host times; the last is that of a sample
        self._unshown = self._apart = 0  # readings since the last picture, and before it
        self._still_on = ""
        self.heats = ""
        """What the readings show of a rig that heats after a run; `""` if they do not."""
        self._before: tuple[Finding, ...] = ()  # what monitors with other twins have found
        self._findings: tuple[Finding, ...] | None = None
        self._beside = beside
        self.follow(beside)

    @property
    def twin(self) -> Twin:
        """The twin that follows the rig."""
        return self._beside.twin

    @property
    def draws(self) -> Draws | None:
        """Draws of what is not known of its values."""
        return self._beside.draws

    @property
    def followed(self) -> tuple[Follower, str]:
        """What follows the rig, and what its twin is called."""
        return self._follower, self._beside.label

    @property
    def present(self) -> tuple[Finding, ...]:
        """The findings of the monitor that are there now."""
        return tuple(self._beside.monitor.present)

    def follow(self, beside: TwinBeside) -> None:
        """Goes on with another twin, which begins to find the rig. What was found with the twin
        before is over then, and so is its diagnosis."""
        if beside is not self._beside:
            self._before += tuple(
                finding if finding.until is not None else replace(finding, until=self._looked)
                for finding in self._beside.monitor.findings
            )
            self._before = self._before[-LINES:]
        self._beside = beside
        self._follower = beside.monitor.follower
        self._observed = self._error = self._nis = self._time = 0.0
        # Of the last minutes: time of the rig, readings, those in their band, sum of its widths.
        self._compared: deque[tuple[float, int, int, float]] = deque()
        self._outlook: Outlook | None = None
        self._reading: Reading | None = None  # which is not shown yet
        self._parameters: Estimate | None = None
        self.cause, self._is_awaited = None, False
        self._acknowledged = 0  # when the last alarm was found that is known, ns of the host
        directions, rows = beside.observer.model.directions, beside.twin.rig.parameters
        names = () if directions is None else directions.names
        self.history.follow(names)
        self.ring.append(
            "layout",
            {
                **rig_layout(beside.twin),
                **self._about,
                "twin": beside.label,
                "horizon": HORIZON,
                "uncertain": [
                    {
                        "name": name,
                        "unit": rows[name].unit,
                        "description": rows[name].description,
                        "value": float(beside.twin.values[name]),
                    }
                    for name in names
                ],
                "server": self.ring.name,
            },
        )
        # A client that was connected to an earlier server still shows what that one said.
        self.ring.append("diagnosis", {"state": "none", "causes": []})
        self._show_findings()

    def say(self, level: str, text: str, at: float | None = None) -> None:
        """Adds a line to the log of the page; `at` is its time, s since 1970."""
        self._lines.append({"t": time.time() if at is None else at, "level": level, "text": text})
        self.ring.append("log", list(self._lines))

    def show_diagnosis(self, diagnosis: dict[str, Any]) -> None:
        """Shows a diagnosis, as `LiveDiagnosis` gives it."""
        self.ring.append("diagnosis", diagnosis)
        self._is_awaited = diagnosis["state"] in ("awaited", "running")
        if diagnosis["state"] != "done":
            return
        self.cause = None
        if diagnosis["causes"]:
            cause = diagnosis["causes"][-1]
            best = cause["explanations"][0]
            until = None if cause["until_s"] is None else cause["until"]
            self.cause = Reason(best["phrase"], best["probability"], best["onset"], until)
            self.say("notice", f"most likely (estimate): {self.cause}")

    def acknowledge(self) -> None:
        """Takes what was found until now as known: it leaves the first answer when it is over."""
        times = [finding.found or 0 for finding in self._beside.monitor.findings]
        self._acknowledged = int(max(times, default=0))
        self.say("notice", "what was found until now is acknowledged")

    def on_finding(self, finding: Finding) -> None:
        """Takes a new finding of an alarm or of the monitor."""
        level = "notice" if not finding.is_alarm else finding.severity
        since = None if finding.since is None else seconds(finding.since)
        if finding.kind in (STILL_ON, "unconfirmed"):
            self._still_on = finding.detail
        self.say(level, f"{finding.kind}: {finding.detail}", since)
        self._raised(finding)

    def on_record(self, record: Record, state: RigState) -> None:
        """Takes the next record, and what is known of the rig after it."""
        self.records += 1
        self._state = state
        self._beside.monitor.on_record(record, state)
        for finding in self._beside.take_news():
            self.on_finding(finding)
        match record:
            case Sample() if record.pwm:
                self._heard = state.time_of(record)
                if not any(record.pwm):
                    self._still_on = ""
            case Reading() if not record.recalibrating:
                self._reading = record
                self._unshown += 1
                self._judge(record, state)
                # Also in the middle of a turn that takes long, on a busy machine.
                self._show_reading(state, record.arrival)
            case LinkChange():
                detail = f": {record.detail}" if record.detail else ""
                text = f"{record.link} is {record.state}{detail}"
                self.say(
                    "notice" if record.state == "down" else "plain", text, seconds(record.arrival)
                )
            case Gap():
                text = f"{record.count} messages ({record.stream}) were lost"
                self.say("plain", text, seconds(record.arrival))
            case Event() if record.kind not in _COUNTED and record.kind != "alarm":
                self.say("plain", f"{record.kind} {record.detail}".strip(), seconds(record.arrival))

    def on_time(self, state: RigState, now: int) -> None:
        """Makes the frames that are due at host time `now`, ns."""
        self.turned = time.monotonic()
        self._show_reading(state, now)
        if now - self._looked >= OUTLOOK_NS:
            self._looked = now
            if self._follower.measured is not None and not self._source.ended:
                self._look(state)
            self._show_findings()
            self._show_story(state, now)

    def pause(self, now: int) -> float:
        """How long the readings may gather from host time `now`, ns, on: until the next picture if
        there are several for each, s. Each turn of the loop costs as much as some readings."""
        return max(seconds(self._due - now), 0.0) if self._apart > MAX_SINGLE_READINGS else 0.0

    @property
    def metrics(self) -> list[Metric]:
        """The numbers of the page for a program that watches it. Another thread may ask."""
        follower, state, outlook = self._follower, self._state, self._outlook
        channels, driven = self.twin.channels, self.twin.rig.driven
        applied = None if state.sample is None else self.twin.rig.driver.duty(state.sample.pwm)
        power = None if outlook is None else outlook.power
        live = {name: float(link == "live") for name, link in self._source.states.items()}
        alarms = sum(finding.is_alarm and finding.until is None for finding in self._findings or ())

        def gauge(name: str, about: str, label: str, names: Any, values: Any) -> Metric:
            return Metric(f"jaxtwin_{name}", "gauge", about, label, _named(names, values))

        def single(name: str, kind: str, about: str, value: float | int) -> Metric:
            return Metric(f"jaxtwin_{name}", kind, about, "", {"": float(value)})

        return [
            gauge("temperature_celsius", "What a channel reads.", "channel", channels,
                  follower.measured),
            gauge("expected_celsius", "What the twin expected of a channel.", "channel", channels,
                  follower.predicted),
            gauge("duty_ratio", "The duty of a cell, -1 to 1.", "cell", driven, applied),
            gauge("estimated_power_watts", "The power of a cell by the twin.", "cell", driven,
                  power),
            Metric("jaxtwin_link_live", "gauge", "Whether a link is live.", "link", live),
            single("estimated_energy_joules_total", "counter",
                   "The energy that the cells have drawn, by the twin.", self._energy),
            single("expectation_error_kelvin", "gauge",
                   "Readings minus expected readings, root mean square of a minute.", self._error),
            single("surprise_ratio", "gauge",
                   "The mean normalised innovation squared of a minute.", self._nis),
            single("alarms", "gauge", "The alarms of the monitor that are there.", alarms),
            single("tripped", "gauge", "Whether the device has switched off.", bool(state.trip)),
            single("records_total", "counter", "The records since the start.", self.records),
            Metric("jaxtwin_messages_bad_total", "counter",
                   "Messages that were lost, damaged, repeated or without sense.", "how",
                   dict(state.counts)),
        ]  # fmt: skip

    def _show_reading(self, state: RigState, now: int) -> None:
        """Shows the last reading if a picture is due at host time `now`, ns."""
        reading = self._reading
        if reading is not None and now >= self._due:
            # A picture that is late does not make all that follow late.
            is_on_grid = now - self._due < SAMPLE_NS
            self._reading, self._due = None, (self._due if is_on_grid else now) + SAMPLE_NS
            self._apart, self._unshown = self._unshown, 0
            time_s, follower = seconds(state.time_of(reading)), self._follower
            assert follower.predicted is not None
            values = reading.temperatures, follower.predicted, self._band(), follower.duty
            self.ring.append("sample", sample_content(time_s, *values, state.ambient))

    def _judge(self, reading: Reading, state: RigState) -> None:
        """Averages how well the reading was expected, and adds it to the history."""
        follower = self._follower
        assert follower.predicted is not None
        now = seconds(state.time_of(reading))
        step = max(now - self._time, 0.0) * state.rate if self._time else 0.0
        self._time = max(now, self._time)
        self._observed += step
        errors = reading.temperatures - follower.predicted
        valid = np.isfinite(errors)
        if valid.any():
            weight = 1.0 - np.exp(-step / _MEMORY)
            square = float(np.mean(errors[valid] ** 2))
            self._error = float(np.sqrt(self._error**2 + weight * (square - self._error**2)))
            half = self._band()[valid]
            count = int(np.isfinite(half).sum())
            within = int((np.abs(errors[valid]) <= half).sum())
            self._compared.append((self._observed, count, within, float(np.nansum(half))))
            while self._observed - self._compared[0][0] > COMPARED_SECONDS:
                self._compared.popleft()
            whitened = float(np.mean(np.asarray(follower.device_state.whitened)[valid] ** 2))
            self._nis += weight * (whitened - self._nis)
        if self._outlook is not None:
            self._energy += float(np.sum(self._outlook.power)) * step
        values = reading.temperatures, follower.predicted, self._band(), follower.duty
        self.history.add(now, *values, self._parameters)

    def _band(self) -> np.ndarray:
        """Half the width of the 95 % band of what is expected."""
        if self._outlook is None:
            return np.full(len(self.twin.channels), np.nan)
        return QUANTILE_975 * np.asarray(self._outlook.expected_spread)

    def _look(self, state: RigState) -> None:
        follower, elements = self._follower, self.twin.wiring.elements
        self._outlook = look_ahead(self._beside.observer, follower.state, follower.duty)
        step = HORIZON / STEPS / state.rate
        times = [self._time + step * (number + 1) for number in range(STEPS)]
        directions = self._beside.observer.model.directions
        self._parameters = parameter_estimates(directions, self._outlook.now.values)
        content = outlook_content(
            self._outlook, elements, self._time, times, self._energy, self._parameters
        )
        self.ring.append("outlook", content)

    def _show_findings(self) -> None:
        result = (*self._before, *self._beside.monitor.findings)
        if result == self._findings:
            return
        self._findings = result
        self.ring.append(
            "findings", [finding_as_json(finding) for finding in reversed(result[-LINES:])]
        )

    def _show_story(self, state: RigState, now: int) -> None:
        rig, follower = self.twin.rig, self._follower
        names = [channel.name for channel in rig.channels]
        limit = rig.maximum_temperature
        measured = follower.measured
        newest = int(state.measured.max()) if len(state.measured) else 0
        links = {name: str(link) for name, link in self._source.states.items()}
        # A replay shows the time of its records, which are old by themselves.
        age = None if not newest else seconds(now - newest) if self._about["is_live"] else 0.0
        self._heard = self._heard or now  # that of the first look, if it has said nothing yet
        silent = seconds(now - self._heard) if self._about["is_live"] else 0.0
        later = None
        if self._outlook is not None:
            ahead = self._outlook.readings
            later = Moment(ahead.mean[-1], ahead.spread[-1])
        compared = np.array([sums[1:] for sums in self._compared] or [(0, 0, 0.0)]).sum(axis=0)
        findings = [
            finding
            for finding in self._beside.monitor.findings
            if finding.until is None
            or (finding.is_alarm and (finding.found or 0) > self._acknowledged)
        ]
        situation = Situation(
            channels=names,
            readings=np.full(len(names), np.nan) if measured is None else measured,
            links=links,
            refusals=getattr(self._source, "refusals", {}),
            age=age,
            silent=silent,
            faults={names[place]: why for place, why in state.faults.items()},
            trip=state.trip,
            still_on=self.heats or self._still_on,
            limit=None if limit is None else limit - ZERO_CELSIUS,
            findings=findings,
            cause=self.cause,
            acknowledged=self._acknowledged,
            is_awaited=self._is_awaited,
            problem=self.problem or self._full_disk(),
            ended=self._source.ended,
            observed=self._observed,
            within=compared[1] / max(compared[0], 1),
            band=compared[2] / max(compared[0], 1),
            compared=min(self._observed, COMPARED_SECONDS),
            later=later,
        )
        self.ring.append(
            "story",
            {
                "t": round(seconds(now), 1),
                "rig": is_rig_well(situation)._asdict(),
                "twin": is_twin_right(situation)._asdict(),
                "minute": what_comes(situation)._asdict(),
                "links": links,
                "counts": dict(state.counts),
                "trip": state.trip,
                "new": sum(situation.is_new(finding) for finding in findings),
            },
        )

    def _full_disk(self) -> str:
        """What is said of a disk that is nearly full, as `Alarms` does; `""` if it is not."""
        if self._disk is None or (free := shutil.disk_usage(self._disk).free) >= DISK_BYTES:
            return ""
        return f"{free / 1e6:.0f} MB are free at {self._disk}."


def _named(names: Any, values: Any) -> dict[str, float]:
    """Numbers by names, without those that are missing."""
    if values is None:
        return {}
    pairs = zip(names, np.asarray(values, float).tolist(), strict=False)
    return {name: value for name, value in pairs if np.isfinite(value)}
