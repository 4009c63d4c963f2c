"""The page of `benchmarks.faults`: tables with intervals, and the confusion matrix."""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from scipy.stats import binomtest, chi2

from jaxtwin.monitoring import SETTLE

from ._tables import table
from ._virtual_hours import LENGTH, WATCHED

Line = Mapping[str, Any]

DUTIES = 0.0, 0.3, 0.5, 1.01
"""The ends of the classes of duty."""

WITHIN = {"supply": 300.0}
"""Within what time a fault should be found, s, if not within two minutes."""


def faults_page(
    lines: Sequence[Line], faults: Mapping[str, Any], judged: Mapping[str, float], machine: str
) -> str:
    """The results as a page."""
    runs = [one for one in lines if "fault" in one]
    hours = [one for one in lines if "first" in one]
    about = (
        f"{machine}; `python -m benchmarks.faults`. {len(runs)} hours with a fault and "
        f"{sum(one['hours'] for one in hours)} healthy ones of the virtual `dual-cell`: 15 "
        "channels with errors of their own, noise, corrections of the camera, another room, a "
        "random duty, and a rig that differs from the twin by a draw from the posterior of the "
        "match, in the six directions that its readings show. The thresholds of the monitor are "
        "those of one false alarm in 30 days, from 100 other hours. Intervals are of 95 %, by "
        "Clopper and Pearson. [What changes in a rig](../../docs/awareness.md) says what follows.\n"
    )
    parts = ["# Faults of a virtual rig\n", about]
    if runs:
        parts += [_judged(runs, judged), _by_duty(runs), _all(runs, faults), _matrix(runs, faults)]
    return "\n".join([*parts, _healthy(lines, runs, hours)])


def share(count: int, total: int) -> str:
    """A share with its interval, in per cent."""
    if not total:
        return ""
    inside = binomtest(count, total).proportion_ci(0.95, "exact")
    return f"{100 * count / total:.0f} ({100 * inside.low:.0f} to {100 * inside.high:.0f})"


def _delay(one: Line, way: str) -> float:
    """The time until a fault was found, s; infinite for never."""
    by_monitor = float("inf") if one["monitor_s"] is None else one["monitor_s"]
    by_diagnosis = float("inf") if one["cause"] is None else one["cause"]["found_s"]
    return {
        "monitor": by_monitor,
        "diagnosis": by_diagnosis,
        "both": min(by_monitor, by_diagnosis),
    }[way]


def _is_named(one: Line) -> bool:
    return one["cause"] is not None and one["cause"]["name"] == _truth(one)


def _is_tied(one: Line) -> bool:
    """Whether the fault is not the likeliest explanation, and tied with it."""
    return one["cause"] is not None and not _is_named(one) and _truth(one) in one["cause"]["tie"]


def _truth(one: Line) -> str:
    return f"{one['model']} {one['part']}"


def _judged(runs: Sequence[Line], judged: Mapping[str, float]) -> str:
    rows = []
    for name, size in judged.items():
        own = [one for one in runs if one["fault"] == name and one["size"] == size]
        limit = WITHIN.get(name, 120.0)
        soon = {
            way: sum(_delay(one, way) <= limit for one in own)
            for way in ("diagnosis", "monitor", "both")
        }
        found = [one for one in own if one["cause"] is not None]
        right = sum(_is_named(one) or _is_tied(one) for one in found)
        rows.append((
            f"{name} {size:g}", len(own), f"{limit:.0f}",
            *(share(soon[way], len(own)) for way in ("both", "diagnosis", "monitor")),
            share(right, len(found)), sum(_is_named(one) for one in found),
        ))  # fmt: skip
    head = ("fault", "runs", "within, s", "found, %", "by the diagnosis, %", "by the monitor, %",
            "of those that it found named or tied, %", "named")  # fmt: skip
    return "## The faults that must be found\n\n" + table(head, rows)


def _by_duty(runs: Sequence[Line]) -> str:
    """What the duty of the cell has to do with it."""
    own = [one for one in runs if one["fault"] == "contact" and one["size"] == 1.5]
    rows = []
    for low, high in itertools.pairwise(DUTIES):
        here = [one for one in own if low <= one["duty"] < high]
        soon = sum(_delay(one, "both") <= 120.0 for one in here)
        rows.append((f"{low:g} to {min(high, 1):g}", len(here), soon))
    return (
        "A contact of 1.5 times the resistance, by the mean duty of its cell in the 120 s after "
        "the onset: what a contact does is proportional to the heat that it passes.\n\n"
        + table(("duty", "runs", "found within 120 s"), rows)
    )


def _all(runs: Sequence[Line], faults: Mapping[str, Any]) -> str:
    rows = []
    for name, (_, _, sizes) in faults.items():
        for size in sizes:
            own = [one for one in runs if one["fault"] == name and one["size"] == size]
            if not own:
                continue
            limit = WITHIN.get(name, 120.0)
            found = [one for one in own if one["cause"] is not None]
            delays = [_delay(one, "diagnosis") for one in own]
            middle = median(delays)
            known = [one for one in found if _is_named(one) or _is_tied(one)]
            names = Counter(one["cause"]["name"] for one in found).most_common(3)
            rows.append((
                name, f"{size:g}", len(own), len(found),
                sum(one <= limit for one in delays),
                "" if middle == float("inf") else f"{middle:.0f}",
                sum(_delay(one, "monitor") <= limit for one in own),
                sum(_is_named(one) for one in found), sum(_is_tied(one) for one in found),
                f"{sum(one['cause']['inside'] for one in known)} of {len(known)}",
                ", ".join(f"{one} {count}" for one, count in names),
            ))  # fmt: skip
    head = ("fault", "size", "runs", "found by the diagnosis", "in time", "median delay, s",
            "in time by the monitor", "named", "tied", "size in its band", "named as")  # fmt: skip
    return (
        "## Three sizes of each\n\n"
        "*In time* is within 120 s, of a supply within 300 s. *Named*: the likeliest explanation "
        "is the fault; *tied*: it is another, but the fault is not less likely by a factor of 20. "
        "*Size in its band*: of those, in how many the 95 % band of the size holds the true "
        "one.\n\n" + table(head, rows)
    )


def _matrix(runs: Sequence[Line], faults: Mapping[str, Any]) -> str:
    runs = sorted(runs, key=lambda one: list(faults).index(one["fault"]))
    rows: dict[str, Counter[str]] = {}
    for one in runs:
        said = "healthy" if one["cause"] is None else one["cause"]["name"]
        rows.setdefault(one["fault"], Counter())[said] += 1
    order = {_truth(one): None for one in runs}
    said = {name for row in rows.values() for name in row}
    names = [name for name in order if name in said]
    names += sorted(said - set(names), key=lambda name: (name == "healthy", name))
    lines = ((name, *(row[one] or "" for one in names)) for name, row in rows.items())
    return "\nWhat the likeliest explanation was, of all sizes together:\n\n" + table(
        ("", *names), lines
    )


def _healthy(lines: Sequence[Line], runs: Sequence[Line], hours: Sequence[Line]) -> str:
    alarms = sum(len(one["alarms"]) for one in hours)
    total = sum(one["hours"] for one in hours)
    before = sum(one["onset"] for one in runs) / 3600
    watched = sum(WATCHED - SETTLE - (LENGTH - one["onset"]) for one in runs) / 3600
    causes = sum(len(one["false_causes"]) for one in runs)
    whole = [one for one in lines if "diagnosed" in one]
    wrong = sum(len(one["causes"]) for one in whole)
    others = [one for one in lines if "other" in one]
    alarmed, called = (sum(bool(one[key]) for one in others) for key in ("alarms", "causes"))
    early = sum(one["false_alarms"] for one in runs)
    return (
        "## A healthy rig\n\n"
        + table(
            ("watched by", "hours", "false", "95 % interval for 1000 hours"),
            [
                ("monitor, healthy hours", f"{total:.0f}", alarms, poisson(alarms, total)),
                ("monitor, before a fault", f"{before:.0f}", early, poisson(early, before)),
                (
                    "monitor, together",
                    f"{total + before:.0f}",
                    alarms + early,
                    poisson(alarms + early, total + before),
                ),
                ("diagnosis, whole hours", len(whole), wrong, poisson(wrong, len(whole))),
                ("diagnosis, before a fault", f"{watched:.0f}", causes, poisson(causes, watched)),
            ],
        )
        + "".join(
            f"\nSeed {one['seed']}: {'; '.join(one['alarms'])}."
            for batch in hours
            for one in batch["alarms"]
        )
        + "\n\nHealthy hours of rigs from the whole posterior of the match, which leaves contacts "
        f"open by a factor of two to four: {len(others)}; with an alarm of the monitor {alarmed}, "
        f"with a cause {called}. To this twin they are other rigs, and need a match of their own.\n"
    )


def poisson(count: int, hours: float) -> str:
    """The exact interval of what a count in some hours says of 1000 hours."""
    if not hours:
        return ""
    low = chi2.ppf(0.025, 2 * count) / 2 if count else 0.0
    high = chi2.ppf(0.975, 2 * count + 2) / 2
    return f"{1000 * low / hours:.2g} to {1000 * high / hours:.2g}"
