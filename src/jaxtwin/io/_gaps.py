"""Gaps in the times of a recording, and what is known of the rig meanwhile.

A logger that loses rows, writes on change or changes its rate leaves gaps: steps of more than three
median steps. One rule holds for all that takes a recording:

- Over a gap the duty is held, as between any two samples, if the gap is not longer than all shorter
  steps together, or than ten minutes.
- Behind a longer gap the readings either go on where they were. Then the clock was moved (a device
  without a clock of its own gets the time from a network), and the gap counts as a median step; so
  does a gap of more than ten minutes in which a channel that warms or cools has not moved, as where
  summer time begins.
- Or they do not, or the rig had come to rest as between two sessions. Then nobody knows what
  happened: another recording begins, and where a recording is not divided the duty is held for as
  long as that rule allows.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from ..errors import RecordingError

if TYPE_CHECKING:
    from ._experiment import Experiment

# Whether a recording goes on behind a gap, or is divided there.
Gaps: TypeAlias = Literal["hold", "split"]

# A step longer than this many median steps is a gap: samples were lost, not merely late.
GAP_FACTOR = 3.0

# The longest gap over which the duty is held however short the recording is, s.
MAX_HELD = 600.0

# Readings that differ by less than this on both sides of a gap go on, K; or by less than
# `USUAL_CHANGES` times the 99th percentile of the changes between two samples.
MAX_JUMP_KELVIN = 0.5

USUAL_CHANGES = 3.0

# The least and the largest number of readings on each side of a gap that say how fast a channel
# warms or cools.
RATE_SAMPLES = 10, 100

# A rig has come to rest where its readings are those at the start of the recording but for this
# part of their range.
AT_REST = 0.1


class GapSteps(NamedTuple):
    """The gaps among the steps between samples.

    - `before`: the number of the sample before each gap.
    - `seconds`: what each gap counts for, s.
    - `is_clock`, `is_unknown`: whether the clock was moved there, and whether nobody knows what
      happened; otherwise the duty is held.
    """

    before: Int[np.ndarray, " gaps"]
    seconds: Float[np.ndarray, " gaps"]
    is_clock: Bool[np.ndarray, " gaps"]
    is_unknown: Bool[np.ndarray, " gaps"]


def gap_steps(experiment: "Experiment") -> GapSteps:
    """Finds the gaps. In an experiment without readings, which was made and not recorded, the duty
    is held over all of them."""
    temperatures = experiment.temperatures
    steps = np.diff(experiment.time)
    usual = float(np.median(steps))
    (before,) = np.nonzero(steps > GAP_FACTOR * usual)
    sizes = steps[before]
    none = np.zeros(len(before), bool)
    if temperatures is None or not len(before):
        return GapSteps(before, sizes, none, none)
    ascending = np.sort(steps)
    shorter = np.append(0.0, np.cumsum(ascending))[np.searchsorted(ascending, sizes)]
    longest = np.maximum(shorter, MAX_HELD)
    is_long = sizes > longest
    goes_on, keeps_rate = none.copy(), none.copy()
    for k in np.flatnonzero(sizes > MAX_HELD):
        row = int(before[k])
        goes_on[k] = _readings_go_on(temperatures, row) and not _is_between_sessions(
            temperatures, experiment.duty, row
        )
        keeps_rate[k] = goes_on[k] and _keeps_rate(experiment.time, temperatures, row)
    is_clock, is_unknown = goes_on & (is_long | keeps_rate), is_long & ~goes_on
    seconds = np.where(is_clock, usual, np.where(is_unknown, longest, sizes))
    return GapSteps(before, seconds, is_clock, is_unknown)


def _readings_go_on(temperatures: Float[np.ndarray, "times channels"], before: int) -> bool:
    """Whether the readings behind a gap are those before it, but for a usual change."""
    for column in temperatures.T:
        (there,) = np.nonzero(~np.isnan(column))
        behind = int(np.searchsorted(there, before + 1))
        if behind in (0, len(there)):
            continue
        changes = np.abs(np.diff(column[there]))
        usual = float(np.percentile(np.delete(changes, behind - 1), 99)) if len(there) > 2 else 0.0
        missed = there[behind] - there[behind - 1]
        if changes[behind - 1] > max(MAX_JUMP_KELVIN, USUAL_CHANGES * usual * missed):
            return False
    return True


def _keeps_rate(
    time: Float[np.ndarray, " times"],
    temperatures: Float[np.ndarray, "times channels"],
    before: int,
) -> bool:
    """Whether a channel warms or cools behind a gap as fast as before it, but has not moved in it:
    in a rig that relaxes under a held duty, it is either slower behind a gap or has moved."""
    gap, (least, most) = time[before + 1] - time[before], RATE_SAMPLES
    for column in temperatures.T:
        (there,) = np.nonzero(~np.isnan(column))
        behind = int(np.searchsorted(there, before + 1))
        earlier, later = there[:behind][-most:], there[behind:][:most]
        if min(len(earlier), len(later)) < least:
            continue
        (first, error), (second, _) = (_rate(time[rows], column[rows]) for rows in (earlier, later))
        moved = max(abs(column[later[0]] - column[earlier[-1]]), MAX_JUMP_KELVIN)
        is_moving = abs(first) > max(5 * error, 4 * moved / gap)
        if is_moving and second * first > 0.5 * first**2:
            return True
    return False


def _rate(
    time: Float[np.ndarray, " samples"], readings: Float[np.ndarray, " samples"]
) -> tuple[float, float]:
    """The slope of a line through readings, and its standard error, K/s."""
    away = time - time.mean()
    squares = float(away @ away)
    slope = float(away @ readings) / squares
    left = readings - readings.mean() - slope * away
    return slope, float(np.sqrt(left @ left / (len(time) - 2) / squares))


def _is_between_sessions(
    temperatures: Float[np.ndarray, "times channels"],
    duty: Float[np.ndarray, "times cells"],
    before: int,
) -> bool:
    """Whether a rig that was driven on both sides of a gap had come to rest before it."""
    is_driven = np.any(duty != 0, axis=1)
    if is_driven[before] or not is_driven[:before].any() or not is_driven[before + 1 :].any():
        return False
    for column in temperatures.T:
        earlier = column[: before + 1]
        earlier = earlier[~np.isnan(earlier)]
        if len(earlier) and abs(earlier[-1] - earlier[0]) > AT_REST * np.ptp(earlier):
            return False
    return True


def elapsed_time(experiment: "Experiment") -> Float[np.ndarray, " times"]:
    """The time that passed for the rig since the first sample, s."""
    time = experiment.time
    gaps = gap_steps(experiment)
    if not (gaps.is_clock | gaps.is_unknown).any():
        return time - time[0]
    steps = np.diff(time)
    steps[gaps.before] = gaps.seconds
    return np.append(0.0, np.cumsum(steps))


def separate_recordings(experiment: "Experiment") -> "tuple[Experiment, ...]":
    """The recordings between the gaps in which nobody knows what happened; the recording itself if
    there is none.

    **Raises:** `RecordingError` if a single sample stands between two of them.
    """
    gaps = gap_steps(experiment)
    ends = gaps.before[gaps.is_unknown] + 1
    if not len(ends):
        return (experiment,)
    rows = np.split(np.arange(len(experiment.time)), ends)
    for part in rows:
        if len(part) == 1 or not experiment.sampled[part].any():
            first, last = experiment.time[part[[0, -1]]]
            raise RecordingError(
                f"{experiment.name or 'the recording'}: expected at least two samples and a "
                "reading between gaps over which the duty cannot be held, got "
                f"{len(part)} from {first:.10g} s to {last:.10g} s; leave them out with "
                "Experiment.between, or delete the rows"
            )
    return tuple(
        part_of(experiment, part, f"{experiment.name} part {number}")
        for number, part in enumerate(rows, 1)
    )


def parts_between_gaps(experiment: "Experiment") -> "tuple[Experiment, ...]":
    """The parts between all gaps. Each begins with the recording, without readings before its own,
    so that a run reaches it with the rig as the duty has left it: a body and its heater then have
    the temperatures that they had, which no reading shows."""
    parts: list[Experiment] = []
    for recording in separate_recordings(experiment):
        temperatures = recording.temperatures
        if temperatures is None:
            return (experiment,)
        ends = gap_steps(recording).before + 1
        for rows in np.split(np.arange(len(recording.time)), ends):
            readings = np.full_like(temperatures, np.nan)
            readings[rows] = temperatures[rows]
            if np.isnan(readings).all():
                continue
            # A recording has at least two samples, the second here perhaps without a reading.
            until = np.arange(max(rows[-1] + 1, 2))
            part = replace(recording, temperatures=readings)
            parts.append(part_of(part, until, f"{experiment.name} part {len(parts) + 1}"))
    return (experiment,) if len(parts) == 1 else tuple(parts)


def part_of(
    experiment: "Experiment",
    rows: Int[np.ndarray, " rows"] | Bool[np.ndarray, " times"],
    name: str,
) -> "Experiment":
    """Some samples of a recording at their own times, under a name."""
    ambient = experiment.ambient
    return replace(
        experiment,
        time=experiment.time[rows],
        duty=experiment.duty[rows],
        temperatures=None if experiment.temperatures is None else experiment.temperatures[rows],
        ambient=ambient[rows] if isinstance(ambient, np.ndarray) else ambient,
        inputs={input_: values[rows] for input_, values in experiment.inputs.items()},
        name=name.strip(),
    )


def gap_sentences(experiment: "Experiment") -> list[str]:
    """What is assumed of the gaps of a recording, in sentences; none if there is no gap."""
    time, name = experiment.time, experiment.name or "the recording"
    gaps = gap_steps(experiment)
    held = ~(gaps.is_clock | gaps.is_unknown)
    sentences = []
    if held.any() and experiment.temperatures is not None:
        seconds, number = gaps.seconds[held], int(held.sum())
        first = time[gaps.before[held][0]]
        of = f"a gap of {seconds[0]:.6g} s behind {first:.10g} s"
        if number > 1:
            of = (
                f"{number} gaps of up to {seconds.max():.6g} s, {seconds.sum():.6g} s in all, the "
                f"first behind {first:.10g} s"
            )
        rows = gaps.before[held]
        changes = np.any(experiment.duty[rows] != experiment.duty[rows + 1], axis=1)
        longest = gaps.seconds[held][changes].max(initial=0.0)
        late = (
            f"; it changes in {changes.sum()} of them, up to {longest:.6g} s, nobody knows when, "
            "and counts from their end on: what that heat has done falls to the values of the "
            "match; log each change, or give the part before or behind (Experiment.between)"
        )
        sentences.append(f"{name}: the duty is held over {of}{late if changes.any() else ''}")
    for row, counted, is_clock in zip(gaps.before, gaps.seconds, gaps.is_clock, strict=True):
        span = f"nothing from {time[row]:.10g} s to {time[row + 1]:.10g} s"
        if is_clock:
            sentences.append(
                f"{name}: {span}, but the readings go on: the clock was moved, and the gap counts "
                f"as {counted:.6g} s"
            )
    for row, counted in zip(
        gaps.before[gaps.is_unknown], gaps.seconds[gaps.is_unknown], strict=True
    ):
        sentences.append(
            f"{name}: nothing from {time[row]:.10g} s to {time[row + 1]:.10g} s, longer than the "
            f"{counted:.6g} s over which the duty may be held: what is behind it counts as another "
            f"recording, and a run of both goes on as after {counted:.6g} s"
        )
    return sentences
