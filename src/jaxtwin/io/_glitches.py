"""Single readings that no temperature takes: the reading leaves for a sample and is back."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

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
