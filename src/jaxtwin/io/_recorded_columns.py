"""Makes an experiment of named columns: holds missing duties and inputs at their last value, takes
the fault codes of sensors as missing readings, and converts PWM counts to duty cycles."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import final

import numpy as np
from jaxtyping import Float

from .._celsius import ZERO_CELSIUS
from ..errors import RecordingError
from ._checks import WrongSampleError, duty_from_counts
from ._column_meaning import CELL, DRIVE, INPUT
from ._delimited import Column
from ._experiment import Experiment
from ._glitches import FAULT_WORDS, fault_codes, is_missing

# The columns of a file, for messages.
EXPECTED = (
    "expected time_s, duty_P1 (-1 to 1) or pwm_P1 (counts) for each cell, NAME_degC, NAME_K or "
    "NAME_degF for each channel, ambient_degC, and input_NAME for each other input, separated by "
    "commas, semicolons or tabs"
)

# Units of a time stamp in a second.
STAMP = 1e6

# Where a recording of a rig in a room begins, and how far from there at most: degC, K. Readings
# that begin there in kelvin, and never fall below what a room can be, are probably in kelvin.
TYPICAL_START, START_MARGIN = 20.0, 20.0


@final
@dataclass(frozen=True)
class RecordedDrive:
    """What a reader says about the drive and the clock of a recording; see `read_recording`.

    - `counts`, `polarity`: those of PWM counts. `constant`: the duty of actuators without a column.
    - `names`: the cells and heaters of the rig, in its order; None if it is not known.
    - `spread`: whether samples of one time are spread evenly up to the next time.
    """

    counts: int | None = None
    polarity: int = 1
    constant: float | None = None
    names: tuple[str, ...] | None = None
    spread: bool = False


def experiment_of_columns(columns: list[Column], name: str, drive: RecordedDrive) -> Experiment:
    """The experiment in named columns.

    **Raises:** `RecordingError` if a column is missing, is given twice or has another name, or if
    PWM counts of a driver are not known.
    """
    times = [column for column in columns if column.kind == "time"]
    unknown = [column for column in columns if column.kind == "unknown"]
    if unknown:
        raise RecordingError(
            f"columns: {EXPECTED}, got {unknown[0].title!r}"
            f"{_hint(unknown[0].title, drive.names)}; columns= gives it a name, ignore= leaves it "
            "out, in a command --column and --ignore"
        )
    if len(times) != 1:
        got = "no column time_s" if not times else "two columns for the time"
        raise RecordingError(f"columns: {EXPECTED}, got {got}")
    columns, notes = held(columns)
    time, origin, spread = _seconds(next(c for c in columns if c.kind == "time"), drive)
    notes += spread
    temperatures: dict[str, Column] = {}
    for column in (c for c in columns if c.kind == "temperature"):
        if column.name in temperatures:
            raise RecordingError(
                f"columns: expected one for the temperature {column.name}, got two"
            )
        temperatures[column.name], of_column = _without_fault_codes(column)
        notes += of_column
    stamps = {c.name.removesuffix("_time"): c for c in columns if c.kind == "own time"}
    duty, of_duty = _duty(columns, drive)
    actuators = tuple(duty)
    _align(temperatures, stamps, time, origin)
    ambient = temperatures.pop("ambient", None)
    if ambient is None or ambient.is_blank:
        _check_celsius(temperatures)
    # Channels that are blank in every line are not recorded; they select what a simulation returns.
    recorded = any(not column.is_blank for column in temperatures.values())
    return Experiment(
        time,
        np.stack(list(duty.values()), axis=1),
        cells=actuators,
        channels=tuple(temperatures),
        temperatures=np.stack([column.values for column in temperatures.values()], axis=1)
        if recorded
        else None,
        ambient=None if ambient is None or ambient.is_blank else ambient.values,
        inputs=_inputs(columns),
        name=name,
        notes=[*notes, *of_duty, *(column.note for column in columns if column.note)],
        start=datetime(1970, 1, 1) + timedelta(microseconds=float(origin)) if origin else None,
    )


def held(columns: Sequence[Column]) -> tuple[list[Column], list[str]]:
    """Holds missing duties and inputs at their last value, because many loggers write only changes,
    and leaves out the samples before the first one. Returns the columns, and notes of what was
    done."""
    first, notes = 0, []
    full = [*columns]
    for place, column in enumerate(columns):
        if column.kind not in ("duty", "pwm", "input"):
            continue
        # Names of states have no numbers; their fields are text.
        is_text = column.kind == "input" and column.is_blank
        missing = np.array([is_missing(f) for f in column.fields]) if is_text else None
        missing = np.isnan(column.values) if missing is None else missing & ~_are_states(column)
        if not missing.any() or missing.all():
            continue
        last = np.maximum.accumulate(np.where(missing, 0, np.arange(missing.size)))
        begin = int(np.argmin(missing))
        last[:begin] = begin
        fields = [column.fields[k] for k in last]
        full[place] = replace(column, values=column.values[last], fields=fields)
        first = max(first, begin)
        count = int(missing[begin:].sum())
        if count:
            notes.append(f"{column.title}: missing in {count} of {missing.size} samples, held")
    if not first:
        return full, notes
    part = [
        replace(c, values=c.values[first:], lines=c.lines[first:], fields=c.fields[first:])
        for c in full
    ]
    return part, [
        *notes,
        f"left out before the first duty: {first} of {len(columns[0].fields)} samples",
    ]


def _are_states(column: Column) -> np.ndarray:
    """Which fields are the name of a state that is also a word for a missing sample: `open`."""
    return np.array([field.lower() == "open" for field in column.fields])


def _seconds(column: Column, drive: RecordedDrive) -> tuple[np.ndarray, float, list[str]]:
    """The times of the samples, s, their zero if it is a time stamp, and what was done.

    **Raises:** `WrongSampleError` for several samples of one time that are not to be spread.
    """
    values = column.complete()
    origin = values[0] if column.is_since_1970 else 0.0
    time = (values - origin) / STAMP if column.is_since_1970 else values
    (same,) = np.nonzero(np.diff(time) == 0)
    if not same.size:
        return time, origin, []
    if not drive.spread:
        later = int(same[0]) + 1
        raise WrongSampleError(
            f"time: expected increasing times, got {time[later]:g} s at sample {later} after "
            f"{time[later]:g} s; if the clock shows whole seconds only and several samples belong "
            "to one, spread=True spreads them evenly, in a command --spread",
            later,
        )
    starts = np.append(0, np.nonzero(np.diff(time))[0] + 1)
    sizes = np.diff(np.append(starts, time.size))
    steps = np.diff(time[starts])
    # The clock's own step, beside which a longer one is a gap that has no samples.
    clock = float(np.median(steps)) if steps.size else 1.0
    width = np.minimum(np.append(steps, clock), clock)
    number = np.arange(time.size) - np.repeat(starts, sizes)
    spread = time + np.repeat(width / sizes, sizes) * number
    note = f"{column.title}: spread evenly, {same.size} of {time.size} samples had the time before"
    return spread, origin, [note]


def _without_fault_codes(column: Column) -> tuple[Column, list[str]]:
    """A temperature without the readings that are codes, and how many of each there were."""
    codes = fault_codes(column.values)
    values = np.where(codes, np.nan, column.values)
    kinds = Counter(column.fields[k] for k in np.flatnonzero(codes))
    missing = (column.fields[k] for k in np.flatnonzero(np.isnan(column.values)))
    kinds += Counter(field for field in missing if field.lower() in FAULT_WORDS)
    if not kinds:
        return column, []
    text = ", ".join(f"{field} ({count})" for field, count in kinds.most_common())
    note = f"{column.title}: missing in {kinds.total()} of {codes.size} samples, codes: {text}"
    return replace(column, values=values), [note]


def _duty(
    columns: Sequence[Column], drive: RecordedDrive
) -> tuple[dict[str, np.ndarray], list[str]]:
    """The duty of the actuators by their names, in the order of the rig, and what was added.
    Without a rig, P1, P2, ... are in the order of their numbers, and other names in that of the
    file."""
    duty: dict[str, np.ndarray] = {}
    for column in columns:
        part = DRIVE.fullmatch(column.name)
        if column.kind not in ("duty", "pwm") or part is None:
            continue
        name = part[2]
        if name in duty:
            raise RecordingError(f"columns: expected one for the drive of {name}, got two")
        values = column.complete()
        if column.kind == "pwm":
            if drive.counts is None:
                raise RecordingError(
                    f"column {column.title}: expected the counts of full duty, such as counts=255, "
                    "or the rig with its driver and counts in its table [driver], rig=..., got "
                    "neither"
                )
            values = duty_from_counts(values[:, None], drive.counts, drive.polarity, [name])[:, 0]
        duty[name] = values
    notes = []
    if drive.constant is not None:
        numbers = range(1, max([1, *_numbers(duty)]) + 1)
        known = drive.names or [f"P{number}" for number in numbers]
        added = [name for name in known if name not in duty]
        samples = columns[0].values.size
        duty |= {name: np.full(samples, drive.constant) for name in added}
        names = ", ".join(f"duty_{name}" for name in added)
        if not added:
            raise RecordingError(
                f"duty: expected none, as every drive has a column, got {drive.constant:g}"
            )
        notes = [f"{names}: {drive.constant:g} throughout, as stated"]
    numbers = _numbers(duty)
    wanted = [f"P{number}" for number in range(1, len(duty) + 1)]
    are_numbered = len(numbers) == len(duty)
    if drive.names is not None:
        expected, wanted = f"of {', '.join(drive.names)}", [*drive.names]
    elif are_numbered:
        expected = "of the cells P1, P2, ... without a gap"
    else:
        expected, wanted = "by names", [*duty]
    if not duty or set(wanted) != set(duty):
        got = ", ".join(f"P{number}" for number in numbers) if are_numbered else ", ".join(duty)
        raise RecordingError(
            f"columns: expected drives {expected}, got {got or 'none'}; duty= states one that is "
            "constant, in a command --duty 0"
        )
    return {name: duty[name] for name in wanted}, notes


def _numbers(names: Iterable[str]) -> list[int]:
    """The numbers of the cells that are called P1, P2, ..., in their order."""
    cells = (CELL.fullmatch(f"duty_{name}") for name in names)
    return sorted(int(cell[2]) for cell in cells if cell is not None)


def _inputs(columns: Sequence[Column]) -> dict[str, np.ndarray | list[str]]:
    inputs: dict[str, np.ndarray | list[str]] = {}
    for column in columns:
        if column.kind == "input" and (state := INPUT.fullmatch(column.name)):
            inputs[state[1]] = column.fields if column.is_blank else column.complete()
    return inputs


def _check_celsius(temperatures: dict[str, Column]) -> None:
    """Refuses readings in kelvin that say degC, of a recording without the temperature of the room,
    which would show it.

    **Raises:** `RecordingError` that names the column.
    """
    for column in temperatures.values():
        there = column.values[~np.isnan(column.values)]
        if not there.size:
            continue
        lowest, first = float(there.min()), float(np.median(there[:5]))
        is_near = abs(first - ZERO_CELSIUS - TYPICAL_START) < START_MARGIN
        if is_near and lowest > ZERO_CELSIUS - START_MARGIN:
            raise RecordingError(
                f"column {column.title}: expected degC, got {first:.4g} at the start and nothing "
                f"below {lowest:.4g}; in K, that is {first - ZERO_CELSIUS:.4g} degC: a column of "
                f"kelvin is called {column.name}_K; of a rig that is so hot, record the room too, "
                "ambient_degC"
            )


def _align(
    temperatures: dict[str, Column],
    stamps: dict[str, Column],
    time: Float[np.ndarray, " samples"],
    origin: float,
) -> None:
    """Interpolates temperatures that were read at times of their own at those of the samples.

    **Arguments:**

    - `temperatures`: the columns by their names, which are changed.
    - `stamps`: the times at which some of them were read, us since 1970.
    - `time`: the times of the samples, s.
    - `origin`: their zero, us since 1970; 0 if it is not known.
    """
    for channel, column in stamps.items():
        if channel not in temperatures or not origin:
            known = (
                ", ".join(temperatures) if origin else "a column of time stamps for all channels"
            )
            raise RecordingError(
                f"column {column.title}: expected the times of one of {known}, got {channel!r}"
            )
        own = (column.complete() - origin) / STAMP
        if np.any(np.diff(own) < 0):
            raise RecordingError(
                f"column {column.title}: expected times that do not decrease, got {column.title} "
                f"earlier in {column.place} {column.lines[int(np.argmax(np.diff(own) < 0)) + 1]}"
            )
        read = temperatures[channel]
        there = ~np.isnan(read.values)
        if there.any():
            values = np.where(there, np.interp(time, own[there], read.values[there]), np.nan)
            temperatures[channel] = replace(read, values=values)


def _hint(title: str, names: Sequence[str] | None) -> str:
    """Suggests what an unknown column may mean, for the end of a message; empty without an idea.
    `names` are those of the cells and heaters of the rig."""
    name = re.sub(r"\s*[\[(].*[\])]$", "", title)
    percent = "_%" if title.endswith(("%", "[%]", "(%)")) else ""
    if re.match(r"duty[ _-]?(heater|heating|cooler|peltier|tec)s?(_%)?$", name.lower()):
        return "; the drives of the cells are duty_P1, duty_P2, ...: is it duty_P1?"
    if names and re.match(r"(duty|pwm)_[^\W\d]", name) and CELL.match(name) is None:
        return f"; the drives of the rig are {', '.join(f'duty_{known}' for known in names)}"
    if re.match(r"(set_?point|reference|target|soll(wert)?)s?([ _-]|$)", name.lower()):
        return "; references of a controller are no part of a recording"
    if re.match(r"fans?([ _-]|$)", name.lower()):
        return "; the speed of a fan is an input that the rig file declares in [[inputs]]"
    cell = re.fullmatch(r"(duty|pwm|)[ _-]*(p|cell|)[ _-]*0*([1-9]\d*)(_%)?", name.lower())
    if cell and (cell[1] or cell[2]):
        return f"; is it {cell[1] or 'duty'}_P{cell[3]}{percent}?"
    if re.fullmatch(r"[A-Za-z][\w.-]*", name) and not name.startswith(("duty", "pwm")):
        return f"; is it a temperature without its unit, {name}_degC?"
    return ""
