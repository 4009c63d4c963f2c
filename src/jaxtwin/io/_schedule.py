"""A duty schedule in words, `"0:0.5,500:0.78"`, turned into samples."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from .._arguments import finite_number, mapping_of, of_kind, whole_number
from .._pint_quantities import in_unit
from ..errors import RecordingError
from ..rig import DURATION, parse_quantity

MOST_SAMPLES, MOST_CELLS = 10_000_000, 1000


def schedule_samples(
    text: str, *, duration: Any, step: Any, cells: int, inputs: Mapping[str, str]
) -> tuple[
    Float[np.ndarray, "times"],
    Float[np.ndarray, "times cells"],
    dict[str, Shaped[np.ndarray, "times"]],
]:
    """Times, duty cycles and other inputs of a schedule; see `Experiment.schedule` for its form.

    **Arguments:**

    - `text`: entries `time:duty` or `time:duty/duty/...`, separated by commas.
    - `duration`, `step`: numbers in s, text such as `"10 min"`, or quantities of pint.
    - `cells`: number of cells.
    - `inputs`: name -> entries `time:value`, separated by commas.

    **Returns:**

    The times `(times,)`, s, from 0 to `duration`, including every switch, the duty
    `(times, cells)`, and each input `(times,)`.

    **Raises:**

    `RecordingError` that quotes the invalid entry.
    """
    of_kind("schedule: text", text, str, "text such as '0:0.5,500:0.78'", RecordingError)
    duration = _seconds("schedule: duration", duration)
    step = _seconds("schedule: step", step)
    whole_number("schedule: cells", cells, 1, RecordingError)
    if not duration > 0:
        raise RecordingError(f"duration: expected a number above 0, in s, got {duration:.10g}")
    if not 0 < step <= duration:
        raise RecordingError(
            f"step: expected a number above 0 up to the duration {duration:g} s, got {step:.10g} s"
        )
    if duration / step > MOST_SAMPLES:
        raise RecordingError(
            f"step: expected at most {MOST_SAMPLES} samples in {duration:.10g} s, got more with "
            f"{step:g} s; use a longer step"
        )
    if cells > MOST_CELLS:
        raise RecordingError(f"cells: expected at most {MOST_CELLS}, got {cells}")
    entries = [_entry(part, cells) for part in text.split(",")]
    switches = _switches(text, [time for time, _ in entries], duration)
    mapping_of("schedule: inputs", inputs, "name -> schedule", RecordingError)
    others = {name: _input_entries(name, words, duration) for name, words in inputs.items()}
    marks = sorted({*switches, *(time for at, _ in others.values() for time in at), duration})

    grid = step * np.arange(math.floor(duration / step * (1 + 1e-9)) + 1)
    between = []
    for exact in marks:
        nearest = min(round(exact / step), len(grid) - 1)
        # A grid time within rounding of a switch is that switch: 3 * 0.1 is not 0.3 in binary.
        if math.isclose(grid[nearest], exact, rel_tol=1e-9):
            grid[nearest] = exact
        else:
            between.append(exact)
    time = np.union1d(grid, between)
    held = np.searchsorted(switches, time, side="right")  # 0: before the first entry
    levels = np.array([np.zeros(cells), *(duty for _, duty in entries)])
    columns = {
        name: values[np.searchsorted(at, time, side="right") - 1]
        for name, (at, values) in others.items()
    }
    return time, levels[held], columns


def _switches(text: str, times: list[float], duration: float) -> Float[np.ndarray, "switches"]:
    """The times of the entries of a schedule.

    **Raises:** `RecordingError` if they do not increase, or are not inside the duration.
    """
    switches = np.array(times)
    if np.any(np.diff(switches) <= 0):
        place = int(np.argmax(np.diff(switches) <= 0))
        raise RecordingError(
            f"schedule {text!r}: expected increasing times, got {switches[place + 1]:.10g} s after "
            f"{switches[place]:g} s"
        )
    if switches[0] < 0 or switches[-1] >= duration:
        outside = switches[0] if switches[0] < 0 else switches[-1]
        raise RecordingError(
            f"schedule {text!r}: expected times from 0 s to before the end at {duration:g} s, got "
            f"{outside:g} s"
        )
    return switches


def _input_entries(
    name: str, text: object, duration: float
) -> tuple[Float[np.ndarray, "switches"], Shaped[np.ndarray, "switches"]]:
    """The times and values of the schedule of an input: numbers if all of them are, otherwise
    names of states."""
    where = f"schedule of the input {name!r}"
    expected = "text such as '0:closed,600:open'"
    entries = str(of_kind(where, text, str, expected, RecordingError)).split(",")
    times, values = [], []
    for entry in entries:
        at, colon, value = (part.strip() for part in entry.partition(":"))
        try:
            if not colon or not value:
                raise ValueError
            times.append(float(at))
        except ValueError:
            raise RecordingError(f"{where}: expected {expected}, got {entry.strip()!r}") from None
        values.append(value)
    switches = _switches(f"{name}: {text}", times, duration)
    if switches[0] != 0:
        raise RecordingError(f"{where}: expected a first time of 0 s, got {switches[0]:.10g} s")
    try:
        return switches, np.array([float(value) for value in values])
    except ValueError:
        return switches, np.array(values)


def _seconds(where: str, value: object) -> float:
    """A time in s, from a number, a quantity of pint, or text with a unit."""
    if isinstance(value, str):
        try:
            return parse_quantity(value, DURATION)
        except ValueError as problem:
            raise RecordingError(
                f'{where}: expected a number in s, or text such as "10 min", got {value!r}, '
                f"{problem}"
            ) from None
    return finite_number(where, in_unit(where, value, "s", RecordingError), RecordingError)


def _entry(text: str, cells: int) -> tuple[float, Float[np.ndarray, "cells"]]:
    time_text, colon, duty_text = text.partition(":")
    try:
        if not colon:
            raise ValueError
        time = float(time_text)
        duty = np.array([float(part) for part in duty_text.split("/")])
    except ValueError:
        raise RecordingError(
            "schedule entry: expected 'time:duty' such as '500:0.78', or a duty for each cell "
            f"such as '500:0.78/0.5', got {text.strip()!r}"
        ) from None
    if not math.isfinite(time):
        raise RecordingError(
            f"schedule entry {text.strip()!r}: expected a finite number as the time, got {time}"
        )
    if not np.all(np.abs(duty) <= 1):
        raise RecordingError(
            f"schedule entry {text.strip()!r}: expected duty cycles from -1 to 1, got {duty_text}"
        )
    if len(duty) not in (1, cells):
        raise RecordingError(
            f"schedule entry {text.strip()!r}: expected one duty cycle for all cells, or one for "
            f"each of the {cells}, got {len(duty)}"
        )
    return time, np.broadcast_to(duty, (cells,))
