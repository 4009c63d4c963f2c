"""Readings that mean no temperature: codes of sensors and loggers, and single readings that leave
for a sample and are back."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

# What sensors and loggers write in place of a reading: words, and numbers that no sensor means.
#
# - Instruments write 9.9e37 (overload, SCPI) or -1e38: no number that large is a temperature.
# - A DS18B20 gives -127 when it is not connected and 85 after it has been switched on, and
#   other drivers -999 or -9999. These may be temperatures, and are taken for codes only where
#   the readings on both sides are elsewhere.


# The words for a missing sample, in small letters.
BLANK_WORDS = frozenset(
    {"", "nan", "-nan", "na", "n/a", "#n/a", "<na>", "null", "none", "-", "--", "---"}
)

# The words for a reading that failed, in small letters; they are missing, and are counted.
FAULT_WORDS = frozenset(
    [
        *("unavailable", "unknown", "undefined", "disconnected", "invalid", "bad", "open"),
        *("err", "error", "fault", "faulty", "ol", "+ol", "-ol", "o.l.", "ovld", "+ovld", "-ovld"),
        *("over", "under", "overload", "overrange", "underrange", "overflow"),
        *("#value!", "#ref!", "#div/0!", "#num!", "#null!"),
    ]
)

_MISSING = BLANK_WORDS | FAULT_WORDS

# The size from which on a number is a code, whatever its unit.
OVERLOAD = 1e30

# Temperatures that are codes where the readings around are elsewhere, degC.
CODES = (-127.0, 85.0, -999.0, -999.9, -9999.0, -32768.0)

# How far the readings around a code are from it at least, K.
MIN_DISTANCE_KELVIN = 15.0


def is_missing(field: str) -> bool:
    """Whether a text stands for a missing sample."""
    return field.lower() in _MISSING


def fault_codes(
    values: Float[np.ndarray, " samples"],
) -> Bool[np.ndarray, " samples"]:
    """The samples of a channel that are codes, not temperatures, degC."""
    with np.errstate(invalid="ignore"):
        codes = np.abs(values) >= OVERLOAD
        for code in CODES:
            is_code = np.isclose(values, code, rtol=0.0, atol=1e-6)
            if not is_code.any():
                continue
            others = np.where(is_code | codes | np.isnan(values), np.nan, values)
            codes |= is_code & _is_apart(others, code)
    return codes


def _is_apart(others: Float[np.ndarray, " samples"], code: float) -> Bool[np.ndarray, " samples"]:
    """Whether the nearest readings on both sides are far from a code, and are nearer to each other
    than to it, as they are not where a temperature passes through it. At an end the two nearest
    readings are compared."""
    (there,) = np.nonzero(~np.isnan(others))
    if not there.size:
        return np.full(others.shape, code < 0)  # a sensor that was never connected
    places = np.arange(others.size)
    before = np.searchsorted(there, places) - 1
    after = np.minimum(before + 1, there.size - 1)
    left = others[there[np.where(before < 0, np.minimum(1, there.size - 1), before)]]
    right = others[there[after]]
    last = before + 1 >= there.size
    right = np.where(last, others[there[max(there.size - 2, 0)]], right)
    nearest = np.minimum(np.abs(left - code), np.abs(right - code))
    return (nearest > MIN_DISTANCE_KELVIN) & (np.abs(left - right) < nearest)


# A glitch is at most this long; what lasts longer may have happened.
MAX_GLITCH_SAMPLES = 2

# The quantile of the changes between two samples that is taken for the largest usual one.
USUAL_QUANTILE = 0.99

# A glitch leaves and returns by more than this multiple of the largest usual change.
JUMP_FACTOR = 3.0

# The smallest glitch, K: recordings without noise have no usual change.
MIN_GLITCH_KELVIN = 1.0


class Glitch(NamedTuple):
    """A reading that is far from those before and after it, which are alike.

    - `channel`: its channel. `time`: s. `reading`: degC.
    - `offset`: its distance from the readings beside it, K.
    """

    channel: str
    time: float
    reading: float
    offset: float

    def __str__(self) -> str:
        return (
            f"{self.channel} at {self.time:g} s reads {self.reading:g} degC, {self.offset:+.3g} K "
            "from the readings beside it"
        )


def glitch_offsets(
    temperatures: Float[np.ndarray, "times channels"],
) -> Float[np.ndarray, "times channels"]:
    """The distance of each glitch from the readings beside it, K; 0 for all other readings.

    A glitch is up to `MAX_GLITCH_SAMPLES` readings of a channel in sequence, behind a jump and
    before a jump back that are both larger than `JUMP_FACTOR` times what is usual, while the
    readings on both sides are alike. The first and the last readings have only one side.
    """
    offsets = np.zeros_like(temperatures)
    for column, readings in enumerate(temperatures.T):
        present = np.flatnonzero(np.isfinite(readings))
        offsets[present, column] = _offsets_of(readings[present])
    return offsets


def _offsets_of(readings: Float[np.ndarray, " readings"]) -> Float[np.ndarray, " readings"]:
    offsets = np.zeros_like(readings)
    if len(readings) < 2 * MAX_GLITCH_SAMPLES + 2:
        return offsets
    changes = np.abs(np.diff(readings))
    # A single glitch makes two changes, which in a short recording are not usual either.
    largest = max(3, math.ceil((1 - USUAL_QUANTILE) * len(changes)))
    usual = float(np.sort(changes)[-largest])
    least = max(JUMP_FACTOR * usual, MIN_GLITCH_KELVIN)
    # Before the first and after the last reading anything may have been.
    edges = np.flatnonzero(np.concatenate([[True], changes > least, [True]]))
    lengths = np.diff(edges)
    for number, (start, stop) in enumerate(pairwise(edges)):
        beside = lengths[[place for place in (number - 1, number + 1) if 0 <= place < len(lengths)]]
        # One that is at an end has readings only on one side, which must be no glitch themselves.
        if stop - start > MAX_GLITCH_SAMPLES or beside.max(initial=0) <= MAX_GLITCH_SAMPLES:
            continue
        before = readings[start - 1] if start > 0 else readings[stop]
        after = readings[stop] if stop < len(readings) else readings[start - 1]
        inside = readings[start:stop] - (before + after) / 2
        if np.abs(inside).min() > max(least, abs(after - before)):
            offsets[start:stop] = inside
    return offsets
