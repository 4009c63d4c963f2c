r"""Temperatures over time in words, `"0:16,ramp 600:40"`.

A value is held until the next time. Before an entry that begins with `ramp` or `curve` the
temperature moves from the value before it, and reaches the entry's value at its time: along a line,
or along the S-curve $3 s^2 - 2 s^3$ of the elapsed share $s$, whose rate is 0 at both ends.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .errors import JaxtwinError

# How a temperature moves to an entry: the share of the change by the share of the time.
SHAPES = {"hold": np.zeros_like, "ramp": np.copy, "curve": lambda share: share**2 * (3 - 2 * share)}


def scheduled_temperatures(
    where: str,
    text: str,
    times: Float[np.ndarray, " samples"],
    outputs: int,
    error: type[JaxtwinError],
) -> Float[np.ndarray, "samples outputs"]:
    """The temperatures of a text such as `"0:20,ramp 3600:25"` at some times, for each output.

    **Arguments:**

    - `where`: the name of the argument, for error messages.
    - `times`: s. `outputs`: their number; an entry has a value for all of them or one for each.

    **Raises:** `error`, which quotes the invalid part.
    """
    entries = [_entry(where, part, outputs, error) for part in text.split(",")]
    switches = [entry.time for entry in entries]
    if entries[0].shape != "hold":
        raise error(
            f"{where}: expected a temperature at time 0 before a ramp or a curve, such as "
            f"'0:16,ramp 600:40', got {text!r}"
        )
    if switches[0] != 0 or any(b <= a for a, b in pairwise(switches)):
        raise error(
            f"{where}: expected times that begin at 0 and increase, such as '0:35,600:45', got "
            f"{text!r}"
        )
    if switches[-1] > times[-1]:
        raise error(
            f"{where}: expected times up to the end at {times[-1]:g} s, got {switches[-1]:g} s in "
            f"{text!r}"
        )
    held = np.searchsorted(np.array(switches), times + 1e-9 * max(times[-1], 1), side="right") - 1
    samples = np.array([entry.values for entry in entries])[held]
    for number, (before, entry) in enumerate(pairwise(entries)):
        between = held == number
        elapsed = (times[between] - before.time) / (entry.time - before.time)
        change = np.outer(SHAPES[entry.shape](elapsed.clip(0, 1)), entry.values - before.values)
        samples[between] += change
    return samples


class _Entry(NamedTuple):
    """A part of a text: the values that hold from a time on, and how they are reached."""

    time: float
    values: Float[np.ndarray, " outputs"]
    shape: str


def _entry(where: str, part: str, outputs: int, error: type[JaxtwinError]) -> _Entry:
    first, _, rest = part.strip().partition(" ")
    shape, words = (first, rest) if first in ("ramp", "curve") else ("hold", part)
    time_text, colon, value_text = words.partition(":")
    try:
        if not colon:
            raise ValueError
        time, *values = (float(word) for word in (time_text, *value_text.split("/")))
        if not all(math.isfinite(number) for number in (time, *values)):
            raise ValueError
    except ValueError:
        raise error(
            f"{where}: expected 'time:temperature' such as '600:45', 'ramp 600:45' or 'curve "
            f"600:45', or a temperature for each output such as '600:45/47', got {part.strip()!r}"
        ) from None
    if len(values) not in (1, outputs):
        raise error(
            f"{where}: expected one temperature for all outputs, or one for each of the {outputs}, "
            f"got {len(values)} in {part.strip()!r}"
        )
    return _Entry(time, np.broadcast_to(values, (outputs,)), shape)
