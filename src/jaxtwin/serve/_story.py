"""Three sentences that a person understands from three metres away: is the rig well, is the twin
right, what is about to happen."""

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple, final

import numpy as np
from jaxtyping import Float

from .._statistics import QUANTILE_975
from ..live import Finding, seconds
from ..monitoring import SETTLE
from ..observers import Moment

# The age from which on readings say nothing about the present, s.
OLD_SECONDS = 3.0

# The share of readings within the 95 % band below which a twin expects them worse than it says.
MIN_WITHIN = 0.85

# A cause of at least this probability is stated as what has happened.
MIN_PROBABILITY = 0.9

# A change in the next minute that is smaller than this is none.
STEADY_KELVIN = 0.2

Level = Literal["good", "unknown", "notice", "warning", "critical"]


@final
class Sentence(NamedTuple):
    """An answer: `level` for its colour and sign, `head` in a few words, `text` with numbers;
    `since` and `until`, between which what it says was there, s since 1970, None where nobody
    says."""

    level: Level
    head: str
    text: str
    since: float | None = None
    until: float | None = None


@final
class Reason(NamedTuple):
    """What explains findings most likely: a `phrase` with its size, its `probability`, its onset
    `since`, s since 1970, and its end `until`, None while it is there."""

    phrase: str
    probability: float
    since: float
    until: float | None = None

    def __str__(self) -> str:
        return f"{self.phrase}, {100 * self.probability:.0f} %"


@final
class Situation(NamedTuple):
    """What is known of a rig, as far as the answers need it.

    - `channels`: the names of the channels. `readings`: degC, NaN where there is none.
    - `links`: the state of each link. `refusals`: why the device of a link was refused.
    - `age`: the age of the newest reading, s; None if there was none. `silent`: for how long the
      controller has reported nothing, s.
    - `faults`: the channels that have failed, with the reason.
    - `trip`: why the device has switched off; `""` if it has not. `still_on`: why nobody knows that
      it is off after a stop; `""` if it has reported so.
    - `limit`: the temperature at which the cells are switched off, degC; None: not stated.
    - `findings`: the findings that are there, and alarms that are over and that nobody has
      acknowledged. `cause`: what explains them most likely; None: nobody has said. `is_awaited`:
      whether a diagnosis of the last findings is awaited.
    - `acknowledged`: the host time until which alarms and their cause are acknowledged, ns.
    - `problem`: what keeps the server from its work, such as a full disk.
    - `ended`: whether the source has ended, as a replay does.
    - `observed`: for how long the rig has been observed, s of the rig.
    - `within`: the share of the readings of the last minutes in the 95 % band of what was expected
      of them. `band`: half its mean width, K. `compared`: how long these minutes are, s of the rig.
    - `later`: the readings that are expected in a minute; None if nothing is.
    """

    channels: Sequence[str]
    readings: Float[np.ndarray, " channels"]
    links: Mapping[str, str]
    refusals: Mapping[str, str]
    age: float | None
    silent: float
    faults: Mapping[str, str]
    trip: str
    still_on: str
    limit: float | None
    findings: Sequence[Finding]
    cause: Reason | None
    is_awaited: bool
    acknowledged: int
    problem: str
    ended: bool
    observed: float
    within: float
    band: float
    compared: float
    later: Moment | None

    def is_new(self, finding: Finding) -> bool:
        """Whether a finding is an alarm that nobody has acknowledged."""
        return finding.is_alarm and (finding.found or 0) > self.acknowledged


def is_rig_well(now: Situation) -> Sentence:
    """Whether the rig is well; the worst comes first. It is well if nothing else is to be said."""
    worst = _worst(now)
    if not (new := [finding for finding in now.findings if now.is_new(finding)]):
        return worst
    head = _found(now, new, "notice").head
    return worst if head == worst.head else worst._replace(text=f"{worst.text} Also: {head}.")


def _worst(now: Situation) -> Sentence:
    if now.ended:
        return Sentence("unknown", "The recording is over", "What is shown are its last readings.")
    if now.still_on:
        return Sentence("critical", "The cells may be on", f"{_capital(now.still_on)}.")
    if now.age is None or now.age > OLD_SECONDS:
        return _silent(now)
    hottest = _hottest(now)
    if now.limit is not None and hottest is not None and hottest[1] > now.limit:
        text = f"{hottest[0]} reads {hottest[1]:.1f} °C; the limit is {now.limit:g} °C."
        return Sentence("critical", "The rig is too hot", text)
    if now.trip:
        text = f"It reports “{now.trip}” and refuses every duty until it is reset."
        return Sentence("warning", "The device has switched off", text)
    new = [finding for finding in now.findings if now.is_new(finding)]
    # Findings may be over while their cause is there, as under a duty that does not show it.
    is_there = _sure(now) and now.cause is not None and now.cause.until is None
    if new and (is_there or any(finding.until is None for finding in new)):
        return _found(now, new, "warning")
    if now.faults:
        names = ", ".join(now.faults)
        return Sentence("warning", "A channel has failed", f"No reading from {names}.")
    if now.silent > OLD_SECONDS:
        text = f"It has reported nothing for {now.silent:.0f} s. {_links(now)}."
        return Sentence("warning", "The controller is silent", text)
    if any(state != "live" for state in now.links.values()):
        return Sentence("warning", "A link is not live", f"{_links(now)}.")
    if now.problem:
        return Sentence("warning", "The server has a problem", now.problem)
    if new or now.findings:
        # Over, known, or no alarm.
        return _found(now, new or now.findings, "notice")
    text = "Nothing has been found, and every link is live."
    return Sentence("good", "The rig is well", text)


def is_twin_right(now: Situation) -> Sentence:
    """Whether the twin is right: whether it expects the readings as well as it says."""
    if now.age is None or now.age > OLD_SECONDS:
        return Sentence("unknown", "The twin waits", "There is no reading to compare it with.")
    if now.observed < SETTLE:
        left = SETTLE - now.observed
        return Sentence("unknown", "The twin is finding the rig", f"Ready in {left:.0f} s.")
    share = f"{100 * now.within:.0f} % of the readings of the last {_minutes(now.compared)}"
    share = f"{share} are within ±{now.band:.2g} K of what it expected; 95 % are usual."
    alarms = [finding for finding in now.findings if finding.is_alarm and finding.until is None]
    if alarms:
        # An observer follows what it cannot explain: its readings are in the band all the same.
        detail = _capital(_largest(alarms).detail)
        return Sentence("warning", "The twin does not explain the rig", f"{detail}.")
    if now.cause:
        return Sentence("notice", "The twin does not know what changed", share)
    notices = [finding for finding in now.findings if not finding.is_alarm]
    if notices:
        return Sentence("notice", "The twin has to adapt", f"{_capital(notices[0].detail)}.")
    if now.within < MIN_WITHIN:
        return Sentence("notice", "The twin is less exact than usual", share)
    return Sentence("good", "The twin is right", share)


def what_comes(now: Situation) -> Sentence:
    """What is about to happen in the next minute, by the twin."""
    if now.later is None or now.ended or now.age is None or now.age > OLD_SECONDS:
        return Sentence("unknown", "No forecast", "A forecast needs readings.")
    if now.cause or any(finding.is_alarm and finding.until is None for finding in now.findings):
        level, by = "notice", "By a twin that does not explain the rig: "
    else:
        level, by = "good", ""
    mean, half = now.later.mean, QUANTILE_975 * now.later.spread
    highest = int(np.argmax(mean + half))
    if now.limit is not None and mean[highest] + half[highest] > now.limit:
        text = f"{_forecast(now, highest)}; the limit is {now.limit:g} °C."
        return Sentence("warning", "The limit is near", text)
    change = np.where(np.isfinite(now.readings), mean - now.readings, 0.0)
    most = int(np.argmax(np.abs(change)))
    if abs(change[most]) <= max(STEADY_KELVIN, float(half[most])):
        return Sentence(level, "Steady for the next minute", f"{by}{_forecast(now, highest)}.")
    word = "warming" if change[most] > 0 else "cooling"
    hottest = _hottest(now)
    is_other = hottest is not None and hottest[0] != now.channels[most]
    word = f"{now.channels[most]} {word}" if is_other else word.capitalize()
    text = f"{by}{_forecast(now, most)}; now {now.readings[most]:.1f} °C."
    return Sentence(level, f"{word} by {abs(change[most]):.1f} K in a minute", text)


def _found(now: Situation, findings: Sequence[Finding], level: Level) -> Sentence:
    """What has been found: its reason if that is known, or else the finding that says most."""
    largest = _largest(findings)
    detail, more = _capital(largest.detail), len(findings) - 1
    others = f" {more} more finding{'s' if more > 1 else ''}." if more else ""
    if now.cause and _sure(now):
        sure = f"{100 * now.cause.probability:.0f} %"
        count = f"{more + 1} finding{'s' if more else ''}"
        return Sentence(
            level,
            _capital(now.cause.phrase),
            f"Estimate, {sure}, of {count}. The twin does not know it yet.",
            now.cause.since,
            now.cause.until,
        )
    since = None if largest.since is None else seconds(int(largest.since))
    until = None if largest.until is None else seconds(int(largest.until))
    if now.cause:
        text = f"Most likely (estimate): {now.cause}."
    else:
        text = "A diagnosis follows." if now.is_awaited else "Nobody knows why."
    text = text if largest.is_alarm else "It is no alarm."
    return Sentence(
        level,
        detail if until is None else f"Over: {largest.detail}",
        f"{text}{others}",
        since,
        until,
    )


def _largest(findings: Sequence[Finding]) -> Finding:
    """That of a single part, which says more than what is said of all together."""
    return max(
        findings,
        key=lambda finding: (finding.until is None, bool(finding.channel), abs(finding.size or 0)),
    )


def _sure(now: Situation) -> bool:
    return now.cause is not None and now.cause.probability >= MIN_PROBABILITY


def _minutes(length: float) -> str:
    return f"{length / 60:.0f} minutes" if length >= 90 else f"{length:.0f} s"


def _forecast(now: Situation, place: int) -> str:
    assert now.later is not None
    mean, half = now.later.mean[place], QUANTILE_975 * now.later.spread[place]
    return f"{now.channels[place]} is expected at {mean:.1f} ± {half:.1f} °C"


def _silent(now: Situation) -> Sentence:
    """What is known where no readings arrive."""
    text = f"{_links(now)}."
    if now.age is None:
        return Sentence("unknown", "Waiting for the rig", text)
    return Sentence("critical", "No readings", f"The last is {now.age:.0f} s old. {text}")


def _links(now: Situation) -> str:
    """The links that were refused, or else the state of all."""
    links = "; ".join(f"The link {name} is {state}" for name, state in now.links.items())
    refused = "; ".join(f"The link {name} was refused: {why}" for name, why in now.refusals.items())
    return refused or links or "There is no link"


def _hottest(now: Situation) -> tuple[str, float] | None:
    if not np.isfinite(now.readings).any():
        return None
    place = int(np.nanargmax(now.readings))
    return now.channels[place], float(now.readings[place])


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
