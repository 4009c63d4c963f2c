"""Findings from scores: each is raised once, grows, and clears."""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Float

from ..live.safety._interlock import Finding, Severity
from ._evidence import Evidence, Evidences
from ._monitor import Monitor, channels_of
from ._state_test import parameters_of, state_names
from ._thresholds import FAMILIES, MonitorCalibration

# Channels that begin within this time begin together, s: tests date an onset to a few samples.
MAX_ONSET_DIFFERENCE_SECONDS = 10.0

# Two channels may fail one after the other by chance.
MIN_CHANNELS = 3


def together(
    findings: Sequence[Finding], channels: Sequence[str], second: float = 1.0
) -> list[Finding]:
    """Findings, of which those of one kind that begin together in most channels are one: that of
    the largest size, whose text names it and counts the others.

    **Arguments:**

    - `findings`: in the order of their onset.
    - `channels`: all channels of the recording. Findings of anything else are left as they are.
    - `second`: a second in the unit of their times.
    """
    left, joined = list(findings), []
    while left:
        first, *later = left
        group = [first]
        if first.channel in channels:
            group += [
                other
                for other in later
                if other.channel in channels and begin_together(first, other, second)
            ]
        names = {finding.channel for finding in group}
        if len(names) < MIN_CHANNELS or 2 * len(names) <= len(channels):
            group, names = [first], {first.channel}
        left = [finding for finding in left if not any(finding is each for each in group)]
        joined.append(_one_of(group, len(names)))
    return joined


def begin_together(first: Finding, other: Finding, second: float = 1.0) -> bool:
    """Whether two findings are of one kind and begin at about the same time; `second` is one in the
    unit of their times."""
    apart = abs((other.since or 0) - (first.since or 0))
    return other.kind == first.kind and apart <= MAX_ONSET_DIFFERENCE_SECONDS * second


def events(findings: Sequence[Finding]) -> list[list[Finding]]:
    """Findings that overlap in time, the most telling first: most likely one thing has happened.
    They are given in the order of their onset."""
    result: list[list[Finding]] = []
    end = -math.inf
    for finding in findings:
        since = finding.since or 0
        if not result or since > end:
            result.append([])
        result[-1].append(finding)
        end = max(end, math.inf if finding.until is None else finding.until)
    for group in result:
        # An alarm says more than a notice, a channel than all together, and kelvins than watts.
        group.sort(
            key=lambda finding: (
                finding.is_alarm,
                bool(finding.channel),
                finding.unit == "K",
                abs(finding.size or 0),
            ),
            reverse=True,
        )
    return result


def _one_of(group: Sequence[Finding], channels: int) -> Finding:
    """The largest of some findings, from the first onset until the last of them is over."""
    if len(group) == 1:
        return group[0]
    largest = max(group, key=lambda finding: abs(finding.size or 0.0))
    over = [finding.until for finding in group if finding.until is not None]
    return replace(
        largest,
        detail=f"{largest.channel} and {channels - 1} others: {largest.detail}",
        since=group[0].since,
        found=min(finding.found for finding in group if finding.found is not None),
        until=max(over) if len(over) == len(group) else None,
    )


# A finding clears when its scores have been below a half for this time, s of the rig.
CALM_SECONDS = 30.0

# Test -> the kind of its findings.
KINDS = {
    "sum": "sudden",
    "ratio": "sudden",
    "joint": "sudden",
    "energy": "sudden",
    "state": "implausible",
    "error": "drift",
    "frozen": "frozen",
    "gone": "gone",
    "impossible": "impossible",
    "changed": "changed",
}


class _FindingRow(NamedTuple):
    """A test of one channel, state or parameter."""

    test: str
    name: str
    place: int
    unit: str
    of_what: str = "channel"

    @property
    def key(self) -> tuple[str, str]:
        """Tests of one kind and channel raise the same finding."""
        return KINDS[self.test], self.name


@dataclass
class _Open:
    finding: Finding
    peak: float
    last: float | int


@final
class FindingLog:
    """Turns what a monitor says at each sample into findings.

    **Arguments:**

    - `monitor`: the monitor. `calibration`, `seconds`: what it was made with.
    - `ticks`: the units of time in a second: 1 for a recording, 1e9 for host times in ns.
    - `kept`: how many findings that are over are kept; None: all.
    """

    def __init__(
        self,
        monitor: Monitor,
        calibration: MonitorCalibration,
        seconds: float | int,
        ticks: int = 1,
        kept: int | None = None,
    ):
        self._monitor, self._calibration = monitor, calibration
        self._seconds, self._ticks = seconds, ticks
        self._rows = tuple(_rows(monitor))
        self._open: dict[tuple[str, str], _Open] = {}
        self._closed: deque[Finding] = deque(maxlen=kept)

    @property
    def present(self) -> tuple[Finding, ...]:
        """The findings that are there, in the order of their onset."""
        # Copies: a page in another thread may ask.
        there = (each.finding for each in list(self._open.values()))
        return tuple(sorted(there, key=lambda finding: finding.since or 0))

    @property
    def is_any_present(self) -> bool:
        """Whether there are findings now."""
        return bool(self._open)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The findings that are kept, in the order of their onset; those that are there have no
        `until`."""
        return tuple(
            sorted((*list(self._closed), *self.present), key=lambda finding: finding.since or 0)
        )

    def take(self, now: float | int, evidence: Evidence, rate: float = 1.0) -> list[Finding]:
        """Takes what the tests say of a sample.

        **Arguments:**

        - `evidence`: that of all tests, as `joined` or `at_sample` gives it.
        - `now`: the time of the sample. `rate`: the seconds of the rig in a second of it, which is
          not 1 beside a virtual rig at another speed, or a replay.

        **Returns:** the findings that are new.
        """
        scores = np.asarray(evidence.score)
        tick = self._ticks / rate  # of a second of the rig
        new: dict[tuple[str, str], Finding] = {}
        for place in np.flatnonzero(scores >= 0.5):
            row, score = self._rows[place], float(scores[place])
            size = float(np.asarray(evidence.size)[place])
            there = self._open.get(row.key)
            if there is not None:
                there.last = now
                if self._says_more(row, score, there):
                    there.peak = max(score, there.peak)
                    there.finding = self._grown(there.finding, row, size, score)
                    if row.key in new:
                        new[row.key] = there.finding
            elif score >= 1 and not (row.test == "changed" and self._is_alarmed()):
                age = float(np.asarray(evidence.age)[place]) * tick
                since = now - (round(age) if self._ticks > 1 else age)
                begun = self._grown(_begun(row, since, now), row, size, score)
                self._open[row.key] = _Open(begun, score, now)
                new[row.key] = begun
        for key, entry in list(self._open.items()):
            if now - entry.last >= CALM_SECONDS * tick:
                self._closed.append(replace(entry.finding, until=entry.last))
                del self._open[key]
        return list(new.values())

    def to_dict(self) -> dict[str, Any]:
        """The findings as a dictionary that JSON can hold, from which `resume` goes on."""
        there = [[asdict(entry.finding), entry.peak, entry.last] for entry in self._open.values()]
        return {"open": there, "closed": [asdict(finding) for finding in self._closed]}

    def resume(self, content: dict[str, Any]) -> None:
        """Goes on from what `to_dict` gave."""
        self._closed.extend(Finding(**fields) for fields in content["closed"])
        for fields, peak, last in content["open"]:
            finding = Finding(**fields)
            self._open[finding.kind, finding.channel] = _Open(finding, peak, last)

    @staticmethod
    def _says_more(row: _FindingRow, score: float, there: _Open) -> bool:
        """Whether a test says more of a finding than is known: a shift in K says more than the
        scatter."""
        is_scatter = row.test == "energy"
        if row.key[0] == "sudden" and is_scatter != (there.finding.unit == ""):
            return not is_scatter and score >= 1
        return score > there.peak

    def _is_alarmed(self) -> bool:
        """Whether there is an alarm, which then explains why a parameter has changed."""
        return any(entry.finding.is_alarm for entry in self._open.values())

    def _grown(self, finding: Finding, row: _FindingRow, size: float, score: float) -> Finding:
        return replace(
            finding,
            detail=_detail(row, size),
            size=size,
            unit=row.unit,
            probability=self._probability(row, score, size),
        )

    def _probability(self, row: _FindingRow, score: float, size: float) -> float | None:
        """That it is no false alarm, if faults are as frequent as false alarms are to be."""
        if row.test in FAMILIES:
            threshold = self._monitor.thresholds[row.test]
            tail = self._calibration.deciding(row.test, self._seconds * len(FAMILIES))
            seconds = tail.seconds(threshold * score)
            return seconds / (seconds + self._seconds)
        if row.test == "changed":
            return self._monitor.shift.probability(row.place, size)
        return None


def _begun(row: _FindingRow, since: float | int, found: float | int) -> Finding:
    severity: Severity = "notice" if row.test in ("changed", "impossible") else "warning"
    return Finding(row.key[0], "", row.name, since, severity, unit=row.unit, found=found)


def _rows(monitor: Monitor) -> Iterator[_FindingRow]:
    """The tests in the order of `Evidences`."""
    model = monitor.model
    channels = channels_of(model)
    of_states = model.layout.values
    units = {"sum": "K", "ratio": "K", "energy": "", "error": "K", "frozen": "", "gone": "K"}
    units["impossible"] = "K"
    for test in Evidences._fields:
        if test == "state":
            for place, name in enumerate(state_names(model)):
                if place < of_states:
                    yield _FindingRow(test, name, place, _unit(monitor, name), "parameter")
                elif place == of_states:
                    yield _FindingRow(test, name, place, "K", "room")
                else:
                    yield _FindingRow(test, name, place, "W", "heat")
        elif test == "changed":
            for place, name in enumerate(parameters_of(model)):
                yield _FindingRow(test, name, place, _unit(monitor, name), "parameter")
        elif test == "joint":
            if len(channels) > 1:
                yield _FindingRow(test, "", 0, "K")
        elif test != "error" or model.layout.channels:
            for place, name in enumerate(channels):
                yield _FindingRow(test, name, place, units[test])


def _unit(monitor: Monitor, name: str) -> str:
    """The unit of the change of a parameter: none if it is relative."""
    directions = monitor.model.directions
    assert directions is not None
    if directions.is_logarithmic[directions.names.index(name)]:
        return ""
    return monitor.model.twin.rig.parameters[name].unit or ""


def _detail(row: _FindingRow, size: float) -> str:
    name, more = row.name, "above" if size > 0 else "below"
    match row.test:
        case "sum" | "ratio":
            return f"{name} is {abs(size):.2g} K {more} what is expected"
        case "joint":
            return f"the channels are {abs(size):.2g} K off what is expected, all together"
        case "energy":
            return f"{name} scatters {size:.2g} times as much as is expected"
        case "state" if row.of_what == "room":
            return f"the room that explains the readings is {abs(size):.2g} K off"
        case "state" if row.of_what == "heat":
            return f"{name}: {size:+.2g} W of heat are unexplained"
        case "state":
            return f"{name} would have to change by {_change(row, size)} to explain the readings"
        case "error":
            return f"{name} has drifted from the other channels by {size:+.2g} K"
        case "frozen":
            return f"{name} does not change any more"
        case "impossible":
            return f"one impossible reading of {name}, {size:+.3g} K from what is expected"
        case "gone":
            return f"{name} is within {abs(size):.2g} K of the room while a cell is at full duty"
        case _:
            return f"{name} differs by {_change(row, size)} from the recordings of the match"


def _change(row: _FindingRow, size: float) -> str:
    return f"{size:+.2g} {row.unit}" if row.unit else f"{100 * size:+.2g} %"


def at_sample(evidences: Evidences, place: int) -> Evidence:
    """What all tests say of one sample of a recording, one behind the other."""
    parts = zip(*evidences, strict=True)
    return Evidence(*(np.concatenate([values[place] for values in part]) for part in parts))


def loudest(evidences: Evidences) -> Float[np.ndarray, " times"]:
    """The largest score at each sample."""
    return np.concatenate([evidence.score for evidence in evidences], axis=1).max(axis=1)
