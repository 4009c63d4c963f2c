"""What a page shows of a fleet: a line for each rig, three sentences for all, and what several rigs
have in common."""

import math
import time
from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import Any

from ..serve._metrics import Metric
from ..serve._story import Sentence
from ._fleet import Fleet
from ._watched_rig import WatchedRig

# The worst first.
LEVELS = ("critical", "warning", "notice", "unknown", "good")

# Question -> what is said of those for which the answer is good, and if it is good for all.
ANSWERS = {
    "rig": ("are well", "Nothing is found."),
    "twin": ("twins are right", "Nothing is unexplained."),
    "minute": ("stay within limits", "Nothing gets near its limit in the next minute."),
}

# What a kind of finding is called where several rigs have it.
WORDS = {
    "sudden": "a sudden change",
    "implausible": "unexplained heat, or another parameter",
    "drift": "a channel that drifts",
    "frozen": "a frozen channel",
    "gone": "a channel at the room",
    "silent": "no readings",
    "over-temperature": "too hot",
    "channel-fault": "a channel without readings",
}

# The smallest number of rigs of a group, and part of it, whose common fault is a trend.
MIN_RIGS = 3
MIN_FRACTION = 0.05

# The number of rigs that a sentence names.
SHOWN_RIGS = 3


def overview(fleet: Fleet) -> dict[str, Any]:
    """Describes a fleet as a dictionary that JSON can hold.

    **Returns:** `t`, s since 1970; `answers`, three sentences; `trends`, sentences; `problems`; and
    `rigs`, a line for each: its name, group and twin, level, head and text of whether it is well,
    and level and head of whether its twin is right and of what comes.
    """
    rigs = fleet.rigs
    stories = {name: rig.story() for name, rig in rigs.items()}
    return {
        "t": round(time.time(), 1),
        "answers": {name: _answer(stories, name)._asdict() for name in ANSWERS},
        "trends": trends(rigs),
        "problems": fleet.problems,
        "rigs": [
            {
                "name": name,
                "group": rigs[name].group,
                "twin": rigs[name].made.label,
                "rig": list(story["rig"]),
                "right": list(story["twin"][:2]),
                "next": list(story["minute"][:2]),
            }
            for name, story in stories.items()
        ],
    }  # fmt: skip


def trends(rigs: Mapping[str, WatchedRig]) -> list[dict[str, Any]]:
    """What several rigs of a group have in common: the most frequent first."""
    sizes = Counter(rig.group for rig in rigs.values())
    seen: defaultdict[tuple[str, str, bool], list[str]] = defaultdict(list)
    for name, rig in rigs.items():
        findings = [finding for finding in rig.findings if finding.is_alarm]
        if rig.cause:
            seen[rig.group, rig.fault, True].append(name)
        else:
            for kind in {finding.kind for finding in findings}:
                seen[rig.group, WORDS.get(kind, kind), False].append(name)
    common = [
        {
            "text": f"{len(names)} of {sizes[group]} in {group}: {what}{' (estimate)' * is_cause}",
            "rigs": names,
            "group": group,
        }
        for (group, what, is_cause), names in seen.items()
        if len(names) >= max(MIN_RIGS, MIN_FRACTION * sizes[group])
    ]
    return sorted(common, key=lambda one: -len(one["rigs"]))


def metrics_of(rig: WatchedRig) -> list[Metric]:
    """The numbers of a rig for a program that watches the fleet."""
    story, channels = rig.story(), rig.made.twin.channels

    def single(name: str, about: str, value: float | int) -> Metric:
        return Metric(f"jaxtwin_{name}", "gauge", about, "", {"": float(value)})

    def gauge(name: str, about: str, values: Any) -> Metric:
        pairs = zip(channels, [] if values is None else values.tolist(), strict=False)
        by_name = {channel: value for channel, value in pairs if math.isfinite(value)}
        return Metric(f"jaxtwin_{name}", "gauge", about, "channel", by_name)

    alarms = sum(finding.is_alarm for finding in rig.findings)
    age = rig.age
    return [
        single("rig_severity", "0 for a rig that is well, 4 for one that is critical.",
               len(LEVELS) - 1 - LEVELS.index(story["rig"].level)),
        single("twin_severity", "The same of whether its twin is right.",
               len(LEVELS) - 1 - LEVELS.index(story["twin"].level)),
        single("alarms", "The alarms that are there.", alarms),
        single("reading_age_seconds", "The time since the last message with readings.",
               math.nan if age is None else age),
        single("expectation_error_kelvin",
               "Readings minus expected readings, root mean square of a minute.", rig.error),
        single("surprise_ratio", "The mean normalised innovation squared of a minute.",
               rig.surprise),
        gauge("temperature_celsius", "What a channel reads.", rig.measured),
        gauge("expected_celsius", "What the twin expected of a channel.",
              None if rig.measured is None else rig.expected),
        Metric("jaxtwin_messages_total", "counter",
               "Readings that were used, and messages that were late, malformed or too many.",
               "how",
               dict(rig.queue.counts)),
    ]  # fmt: skip


def _answer(stories: Mapping[str, Mapping[str, Sentence]], question: str) -> Sentence:
    """For how many rigs the answer to a question is good, and what the worst are."""
    answers, (some, nothing) = (
        {one: story[question] for one, story in stories.items()},
        ANSWERS[question],
    )
    levels = Counter(sentence.level for sentence in answers.values())
    worst: Any = next((level for level in LEVELS if levels[level]), "unknown")
    if worst == "good":
        return Sentence("good", f"All {len(answers)} {some}", nothing)
    names = [name for name, sentence in answers.items() if sentence.level == worst]
    heads = Counter(answers[name].head for name in names).most_common(SHOWN_RIGS)
    what = "; ".join(f"{count}: {head.lower()}" for head, count in heads)
    more = f" and {len(names) - SHOWN_RIGS} more" * (len(names) > SHOWN_RIGS)
    text = f"{what} ({', '.join(names[:SHOWN_RIGS])}{more})."
    return Sentence(worst, f"{levels['good']} of {len(answers)} {some}", text)
