"""Findings that begin at the same time in most channels have one cause, and are one finding."""

import math
from collections.abc import Sequence
from dataclasses import replace

from ..live.safety._finding import Finding

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
            key=lambda one: (one.is_alarm, bool(one.channel), one.unit == "K", abs(one.size or 0)),
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
