"""Thresholds: numbers that the statistics of a monitor pass, where these come from, and how long it
is to a false alarm."""

import dataclasses
import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import erf, sqrt
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Float

from .._arguments import path_of
from .._whole_file import write_whole_file
from ..errors import ObserverError
from ._cumulative import REFERENCE

DAY = 86_400.0

# The statistics whose thresholds follow from the time between false alarms: of the innovations the
# cumulative sum, the likelihood ratios and the energy; of the observer the slow states, and the
# errors of single channels.
FAMILIES = ("sum", "ratio", "joint", "energy", "state", "error")


class Tail(NamedTuple):
    r"""How often a statistic of a healthy rig passes a level: an exponential tail.

    The rate above a level $h$ is $r\,e^{-(h-u)/b}$.

    - `level`: $u$. `rate`: $r$, 1/s. `scale`: $b$.
    - `source`: `"recordings"`, `"simulations"` or `"usual"`.
    - `hours`: the running that was looked at.
    - `spread`: the standard deviation of the logarithm of the rate at the threshold of a month.
    """

    level: float
    rate: float
    scale: float
    source: str = "usual"
    hours: float = 0.0
    spread: float = math.nan

    def threshold(self, seconds: float | int) -> float:
        """The level that is passed once in `seconds`."""
        return self.level + self.scale * math.log(max(self.rate * seconds, 1.0))

    def seconds(self, threshold: float) -> float:
        """The mean time between two passages of a level, s."""
        exponent = min((threshold - self.level) / self.scale, 600.0)
        return math.exp(exponent) / self.rate


class Reference(NamedTuple):
    """What the observer said of a parameter in the recordings that the twin was matched on.

    - `mean`: the mean over the recordings of its relative change, of its change where it may be
      negative. `spread`: its standard deviation between recordings. `recordings`: their number.
    """

    mean: float
    spread: float
    recordings: int


# The least number of equal readings in sequence that says that a channel is frozen.
MIN_EQUAL_READINGS = 30.0

# Level, rate for each sample and scale of usual tails: those of independent innovations of which
# one in twenty has three times the spread (`benchmarks/monitor.py`). The last two are not measured:
# they are those of a normal process that forgets within minutes, with its distances half as large
# again.
USUAL: Mapping[str, tuple[float, float, float]] = {
    "sum": (4.9, 0.0033, 1.15),
    "ratio": (5.8, 0.0033, 1.33),
    "joint": (5.8, 0.0033, 1.33),
    "energy": (1.51, 0.0033, 0.138),
    "state": (3.0, 0.003, 0.5),
    "error": (3.0, 0.003, 0.5),
}


@final
@dataclass(frozen=True)
class MonitorCalibration:
    """What a monitor takes as healthy: saved beside the levels of the noise.

    `jaxtwin.calibrate_monitor` finds it from recordings and simulations.

    **Arguments:**

    - `sample_time`: the time between two readings, s.
    - `scales`: channel -> the standard deviation of its clipped standardised innovations.
    - `memory`: channel -> the correlation of two of them that follow each other.
    - `tails`: family -> tails from several sources; the one with the highest threshold counts.
    - `still`: channel -> the number of equal readings in sequence that says that it is frozen.
    - `references`: parameter -> what the matched recordings said of it.
    """

    sample_time: float
    scales: Mapping[str, float]
    memory: Mapping[str, float]
    tails: Mapping[str, tuple[Tail, ...]]
    still: Mapping[str, float]
    references: Mapping[str, Reference]

    def threshold(self, family: str, seconds: float | int) -> float:
        """The threshold of a family for a mean time between its false alarms, s."""
        return max(tail.threshold(seconds) for tail in self.tails[family])

    def deciding(self, family: str, seconds: float | int) -> Tail:
        """The tail that gives this threshold."""
        return max(self.tails[family], key=lambda tail: tail.threshold(seconds))

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the calibration to a TOML file, which `load` reads.

        **Returns:** the file.
        """
        lines = [f"sample_time_s = {self.sample_time!r}"]
        for title in ("scales", "memory", "still"):
            lines += ["", f"[{title}]"]
            lines += [f"{_key(name)} = {value!r}" for name, value in getattr(self, title).items()]
        lines += ["", "[references]"]
        for name, reference in self.references.items():
            lines += ["", f"[references.{_key(name)}]", *_entries(reference._asdict())]
        for family, several in self.tails.items():
            for tail in several:
                lines += ["", f"[[tails.{family}]]", *_entries(tail._asdict())]
        write_whole_file(path, "\n".join([*lines, ""]).encode(), ObserverError)
        return Path(path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "MonitorCalibration":
        """Reads the calibration that `save` wrote.

        **Raises:** `ObserverError` that names the file and the entry that is wrong.
        """
        source = path_of("MonitorCalibration.load: path", path, ObserverError)
        try:
            entries = tomllib.loads(source.read_text(encoding="utf-8-sig"))
        except (OSError, ValueError) as error:
            raise ObserverError(
                f"{source}: expected the calibration of a monitor as TOML: {error}"
            ) from error
        return cls(
            sample_time=_number(source, "sample_time_s", entries.get("sample_time_s")),
            scales=_numbers(source, "scales", entries),
            memory=_numbers(source, "memory", entries, lowest=-1.0, highest=1.0),
            tails=_tails(source, entries),
            still=_numbers(source, "still", entries),
            references={
                name: _reference(source, f"references.{name}", reference)
                for name, reference in _table(source, "references", entries).items()
            },
        )

    def for_seconds(self, seconds: float | int) -> dict[str, float]:
        """Family -> threshold, if all families together raise a false alarm once in `seconds`."""
        return {family: self.threshold(family, seconds * len(FAMILIES)) for family in FAMILIES}

    def with_tails(self, tails: Mapping[str, tuple[Tail, ...]]) -> "MonitorCalibration":
        """The same with other tails, where there are some."""
        joined = {name: tails.get(name) or usual for name, usual in self.tails.items()}
        return dataclasses.replace(self, tails=joined)


def usual_tails(sample_time: float) -> dict[str, tuple[Tail, ...]]:
    """The tails before any recording was looked at."""
    return {
        family: (Tail(level, rate / sample_time, scale),)
        for family, (level, rate, scale) in USUAL.items()
    }


def nominal_calibration(channels: Sequence[str], sample_time: float) -> MonitorCalibration:
    """What is usual for channels that are read so often."""
    return MonitorCalibration(
        sample_time=sample_time,
        scales=dict.fromkeys(channels, 1.0),
        memory=dict.fromkeys(channels, 0.0),
        tails=usual_tails(sample_time),
        still=dict.fromkeys(channels, MIN_EQUAL_READINGS),
        references={},
    )


def _key(name: str) -> str:
    quoted = name.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{quoted}"'


def _entries(entries: Mapping[str, Any]) -> list[str]:
    return [
        f'{name} = "{entry}"' if isinstance(entry, str) else f"{name} = {entry!r}"
        for name, entry in entries.items()
    ]


def _table(source: Path, name: str, entries: Mapping[str, Any]) -> dict[str, Any]:
    table = entries.get(name)
    if not isinstance(table, dict):
        raise ObserverError(f"{source}: {name}: expected a table, got {table!r}")
    return table


def _number(
    source: Path, name: str, entry: object, lowest: float = 0.0, highest: float = math.inf
) -> float:
    is_number = isinstance(entry, int | float) and not isinstance(entry, bool)
    if not (is_number and lowest < entry < highest):  # pyright: ignore[reportOperatorIssue]
        below = f" and below {highest:g}" if highest < math.inf else ""
        raise ObserverError(
            f"{source}: {name}: expected a number above {lowest:g}{below}, got {entry!r}"
        )
    return float(entry)  # pyright: ignore[reportArgumentType]


def _numbers(
    source: Path,
    name: str,
    entries: Mapping[str, Any],
    lowest: float = 0.0,
    highest: float = math.inf,
) -> dict[str, float]:
    return {
        key: _number(source, f"{name}.{key}", value, lowest, highest)
        for key, value in _table(source, name, entries).items()
    }


def _tails(source: Path, entries: Mapping[str, Any]) -> dict[str, tuple[Tail, ...]]:
    table, result = _table(source, "tails", entries), {}
    for family in FAMILIES:
        several = table.get(family)
        if not isinstance(several, list) or not several:
            raise ObserverError(f"{source}: tails.{family}: expected tables, got {several!r}")
        result[family] = tuple(_tail(source, f"tails.{family}", tail) for tail in several)
    return result


def _tail(source: Path, name: str, entry: object) -> Tail:
    if not isinstance(entry, dict):
        raise ObserverError(f"{source}: {name}: expected a table, got {entry!r}")
    numbers = [
        _number(source, f"{name}.{key}", entry.get(key), -1e9 if key == "level" else 0.0)
        for key in ("level", "rate", "scale")
    ]
    hours, spread = entry.get("hours", 0.0), entry.get("spread", math.nan)
    good = all(
        isinstance(value, int | float) and not isinstance(value, bool) for value in (hours, spread)
    )
    if not good or not isinstance(entry.get("source"), str):
        raise ObserverError(f"{source}: {name}: expected source, hours and spread, got {entry!r}")
    return Tail(*numbers, source=entry["source"], hours=float(hours), spread=float(spread))


def _reference(source: Path, name: str, entry: object) -> Reference:
    if not isinstance(entry, dict):
        raise ObserverError(f"{source}: {name}: expected a table, got {entry!r}")
    mean = _number(source, f"{name}.mean", entry.get("mean"), -1e9)
    spread = _number(source, f"{name}.spread", entry.get("spread"), -1e-300)
    recordings = entry.get("recordings")
    if not isinstance(recordings, int) or isinstance(recordings, bool) or recordings < 1:
        raise ObserverError(
            f"{source}: {name}.recordings: expected a number of recordings, got {recordings!r}"
        )
    return Reference(mean, spread, recordings)


# How long Page's sum runs until a false alarm: exactly, for normal innovations, and counted.
#
# A two-sided sum with run length $L$ upwards and downwards alike has $L/2$ (Kemp 1961). One side is
# a Markov chain on a grid of the sum (Brook and Evans 1972): with $Q$ the probabilities between
# states below the threshold, the mean run lengths are $(I - Q)^{-1} 1$.

# The number of states between 0 and the threshold.
MARKOV_STATES = 400


def mean_run_length(threshold: float, reference: float = REFERENCE) -> float:
    """The mean number of independent normal innovations until a two-sided sum passes a threshold
    that it should not."""
    width = 2 * threshold / (2 * MARKOV_STATES - 1)
    centres = width * np.arange(MARKOV_STATES)
    edges = np.append(-np.inf, centres + width / 2)
    steps = edges[None, :] - centres[:, None] + reference
    below = np.vectorize(lambda x: 0.5 * (1 + erf(x / sqrt(2))))(steps)
    matrix = np.diff(below, axis=1)
    lengths = np.linalg.solve(np.eye(MARKOV_STATES) - matrix, np.ones(MARKOV_STATES))
    return float(lengths[0] / 2)


def alarms_of_sum(
    innovations: Float[np.ndarray, " samples"], threshold: float, reference: float = REFERENCE
) -> int:
    """How often a two-sided sum passes a threshold, if it begins again after each alarm."""
    alarms, up, down = 0, 0.0, 0.0
    for x in innovations.tolist():
        up, down = max(0.0, up + x - reference), max(0.0, down - x - reference)
        if max(up, down) >= threshold:
            alarms, up, down = alarms + 1, 0.0, 0.0
    return alarms
