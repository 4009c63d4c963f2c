"""Findings that begin at the same time in most channels have one cause, and are one finding."""

from collections.abc import Sequence
from dataclasses import replace

from ..live.safety._finding import Finding

# Channels that begin within this time begin together, s: tests date an onset to a few samples.
MAX_ONSET_DIFFERENCE_SECONDS = 10.0

# Two channels may fail one after the other by chance.
MIN_CHANNELS = 3


def together(findings: Sequence[Finding], channels: Sequence[str]) -> list[Finding]:
    """Findings of a recording, of which those of one kind that begin together in most channels are
    one: that of the largest size, whose text names it and counts the others.

    **Arguments:**

    - `findings`: in the order of their onset, with times in s.
    - `channels`: all channels of the recording. Findings of anything else are left as they are.
    """
    left, joined = list(findings), []
    while left:
        first, *later = left
        group = [first]
        if first.channel in channels:
            group += [one for one in later if one.channel in channels and _begins_with(first, one)]
        names = {one.channel for one in group}
        if len(names) < MIN_CHANNELS or 2 * len(names) <= len(channels):
            group, names = [first], {first.channel}
        left = [one for one in left if not any(one is each for each in group)]
        joined.append(_one_of(group, len(names)))
    return joined


def _begins_with(first: Finding, other: Finding) -> bool:
    return (
        other.kind == first.kind
        and (other.since or 0) - (first.since or 0) <= MAX_ONSET_DIFFERENCE_SECONDS
    )


def _one_of(group: Sequence[Finding], channels: int) -> Finding:
    """The largest of some findings, from the first onset until the last of them is over."""
    if len(group) == 1:
        return group[0]
    largest = max(group, key=lambda one: abs(one.size or 0.0))
    over = [finding.until for finding in group if finding.until is not None]
    return replace(
        largest,
        detail=f"{largest.channel} and {channels - 1} others: {largest.detail}",
        since=group[0].since,
        found=min(one.found for one in group if one.found is not None),
        until=max(over) if len(over) == len(group) else None,
    )
