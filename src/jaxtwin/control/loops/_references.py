r"""References of a closed loop: the desired value of each output at each sample.

In text a value is held until the next time. Before an entry that begins with `ramp` or `curve` the
reference moves from the value before it, and reaches the entry's value at its time: along a line,
or along the S-curve $3 s^2 - 2 s^3$ of the elapsed share $s$, whose rate is 0 at both ends.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from ..._arguments import finite_number
from ...errors import ControlError

# The largest number of references for which a loop is checked.
REPRESENTATIVES = 5

# How a reference moves to an entry: the share of the change by the share of the time.
SHAPES = {"hold": np.zeros_like, "ramp": np.copy, "curve": lambda share: share**2 * (3 - 2 * share)}


def reference_samples(
    where: str, references: object, times: Float[np.ndarray, " samples"], outputs: int
) -> Float[np.ndarray, "samples outputs"]:
    """The references at the samples, degC.

    **Arguments:**

    - `where`: the name of the argument, for error messages.
    - `references`: a number for all outputs; a text such as `"0:35,600:45"` or `"0:35/37"` (times
      in s, a value for all outputs or one for each, held until the next time), with
      `"0:16,ramp 600:40"` or `"0:16,curve 600:40"` for a change that ends at that time; or an array
      `(outputs,)` or `(samples, outputs)`, for a single output also `(samples,)`.
    - `times`: times of the samples, s.

    **Raises:** `ControlError` that quotes the invalid part.
    """
    if isinstance(references, str):
        return _scheduled(where, references, times, outputs)
    try:
        values = np.asarray(references, float)
        if outputs == 1 and values.shape == times.shape:
            values = values[:, None]
        shaped = np.broadcast_to(values, (len(times), outputs))
    except (TypeError, ValueError):
        raise ControlError(
            f"{where}: expected a number, text such as '0:35,600:45', or an array of shape "
            f"({outputs},) or ({len(times)}, {outputs}), in degC, got "
            f"{_described(references)}"
        ) from None
    if not np.isfinite(shaped).all():
        raise ControlError(f"{where}: expected finite numbers, in degC, got {references!r}")
    return shaped.copy()


def _scheduled(
    where: str, text: str, times: Float[np.ndarray, " samples"], outputs: int
) -> Float[np.ndarray, "samples outputs"]:
    entries = [_entry(where, part, outputs) for part in text.split(",")]
    switches = [entry.time for entry in entries]
    if entries[0].shape != "hold":
        raise ControlError(
            f"{where}: expected a temperature at time 0 before a ramp or a curve, such as "
            f"'0:16,ramp 600:40', got {text!r}"
        )
    if switches[0] != 0 or any(b <= a for a, b in pairwise(switches)):
        raise ControlError(
            f"{where}: expected times that begin at 0 and increase, such as '0:35,600:45', got "
            f"{text!r}"
        )
    if switches[-1] > times[-1]:
        raise ControlError(
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


def _entry(where: str, part: str, outputs: int) -> _Entry:
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
        raise ControlError(
            f"{where}: expected 'time:temperature' such as '600:45', 'ramp 600:45' or 'curve "
            f"600:45', or a temperature for each output such as '600:45/47', got {part.strip()!r}"
        ) from None
    if len(values) not in (1, outputs):
        raise ControlError(
            f"{where}: expected one temperature for all outputs, or one for each of the {outputs}, "
            f"got {len(values)} in {part.strip()!r}"
        )
    return _Entry(time, np.broadcast_to(values, (outputs,)), shape)


def references_ahead(
    references: Float[Array | np.ndarray, "samples outputs"], preview: int
) -> Float[Array | np.ndarray, "samples *preview outputs"]:
    """The references that a controller gets at each sample: those of the sample, or with a preview
    those of as many samples from it on. After the last sample its references go on."""
    if not preview:
        return references
    last = len(references) - 1
    return references[np.minimum(np.arange(last + 1)[:, None] + np.arange(preview), last)]


def representative_samples(
    references: Float[np.ndarray, "samples outputs"],
) -> Int[np.ndarray, " few"]:
    """The first samples of the lowest reference, of the highest, and of some between them, each
    different."""
    distinct, samples = np.unique(references, axis=0, return_index=True)
    return samples[
        np.unique(np.linspace(0, len(distinct) - 1, REPRESENTATIVES).round().astype(int))
    ]


def sample_times(
    where: str, duration: object, sample_time_s: float
) -> Float[np.ndarray, " samples"]:
    """Times of the samples from 0 to the duration, s.

    **Raises:** `ControlError` if the duration is not a multiple of the sample time.
    """
    duration = finite_number(f"{where}: duration", duration, ControlError)
    count = round(duration / sample_time_s)
    if count < 1 or not math.isclose(count * sample_time_s, duration, rel_tol=1e-9):
        raise ControlError(
            f"{where}: duration: expected a multiple of the controller's sample time "
            f"{sample_time_s:.10g} s, got {duration:.10g} s"
        )
    return sample_time_s * np.arange(count + 1)


def _described(value: object) -> str:
    shape = getattr(value, "shape", None)
    return repr(value) if shape is None else f"an array of shape {shape}"
