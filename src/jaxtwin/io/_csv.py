"""Recordings as text: a line of column names with units, then a line for each sample.

`time_s,duty_P1,duty_P2,T11_degC,T12_degC,ambient_degC`

Numbers are written with as many digits as are necessary to read the same number back. A missing
sample is an empty field. `_delimited` reads the variants that other programs write.
"""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import IO

import numpy as np
from jaxtyping import Float

from .._celsius import ZERO_CELSIUS
from .._errors import RecordingError
from ._checks import WrongSampleError, duty_from_counts
from ._delimited import CELL, INPUT, STAMPS, TEMPERATURE, TIME, Column, read_columns
from ._experiment import Experiment

EXPECTED = (
    "expected time_s, duty_P1 (-1 to 1) or pwm_P1 (counts) for each cell, NAME_degC or NAME_K for "
    "each channel, ambient_degC or ambient_K, and input_NAME for each other input, separated by "
    "commas, semicolons or tabs"
)
"""The columns of a file, for messages."""

ROWS = 10_000
"""The number of rows that are written at a time."""

SECONDS = {"s": 1.0, "ms": 1e3, "min": 1 / 60, "h": 1 / 3600, "us since 1970": 1e6}
"""The number of each unit of time in a second."""


def parse_csv(
    content: bytes,
    *,
    name: str,
    counts: int | None,
    polarity: int,
    names: Mapping[str, str] | None = None,
    ignore: Sequence[str] = (),
    own: Mapping[str, str] | None = None,
) -> Experiment:
    """The experiment in a .csv file; for the arguments see `read_recording`. `own` are titles to
    which the rig gives a meaning."""
    columns, lines = read_columns(content, EXPECTED, names, ignore, own)
    try:
        return experiment_of_columns(columns, name, counts, polarity)
    except WrongSampleError as error:
        raise RecordingError(f"line {lines[error.sample]}: {error}") from None


def experiment_of_columns(
    columns: list[Column], name: str, counts: int | None, polarity: int
) -> Experiment:
    """The experiment in named columns.

    **Raises:** `RecordingError` if a column is missing, is given twice or has another name, or if
    PWM counts of a driver are not known.
    """
    times: list[np.ndarray] = []
    duty: dict[int, np.ndarray] = {}
    temperatures: dict[str, Column] = {}
    stamps: dict[str, Column] = {}
    inputs: dict[str, np.ndarray | list[str]] = {}
    origin = 0.0
    for column in columns:
        if unit := TIME.fullmatch(column.name):
            values = column.complete()
            origin = values[0] if column.name == STAMPS else 0.0
            times.append((values - origin) / SECONDS[unit[1]])
        elif column.name.endswith(STAMPS):
            stamps[column.name[: -len(STAMPS) - 1]] = column
        elif cell := CELL.fullmatch(column.name):
            kind, number = cell[1], int(cell[2])
            if number in duty:
                raise RecordingError(
                    f"columns: expected one for the drive of cell P{number}, got two"
                )
            values = column.complete()
            if kind == "pwm":
                if counts is None:
                    raise RecordingError(
                        f"column {column.title}: expected the counts of full duty, such as "
                        "counts=255, or the rig with its driver, rig=..., got neither"
                    )
                values = duty_from_counts(values[:, None], counts, polarity)[:, 0]
            duty[number] = values / 100 if cell[3] else values
        elif state := INPUT.fullmatch(column.name):
            inputs[state[1]] = column.fields if column.is_blank else column.complete()
        elif channel := TEMPERATURE.fullmatch(column.name):
            label, unit = channel.groups()
            if label in temperatures:
                raise RecordingError(f"columns: expected one for the temperature {label}, got two")
            temperatures[label] = column
        else:
            raise RecordingError(
                f"columns: {EXPECTED}, got {column.title!r}{_hint(column.name)}; columns= gives "
                "it a name, ignore= leaves it out, in a command --column and --ignore"
            )
    if len(times) != 1:
        found = "no column time_s" if not times else "two columns for the time"
        raise RecordingError(f"columns: {EXPECTED}, got {found}")
    if sorted(duty) != list(range(1, len(duty) + 1)) or not duty:
        found = ", ".join(f"P{number}" for number in sorted(duty)) or "none"
        raise RecordingError(
            f"columns: expected drives of the cells P1, P2, ... without a gap, got {found}"
        )
    _align(temperatures, stamps, times[0], origin)
    ambient = temperatures.pop("ambient", None)
    # Channels that are blank in every line are not recorded; they select what a simulation returns.
    recorded = any(not column.is_blank for column in temperatures.values())
    return Experiment(
        times[0],
        np.stack([duty[number] for number in sorted(duty)], axis=1),
        channels=tuple(temperatures),
        temperatures=np.stack([_celsius(column) for column in temperatures.values()], axis=1)
        if recorded
        else None,
        ambient=None if ambient is None or ambient.is_blank else _celsius(ambient),
        inputs=inputs,
        name=name,
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
        own = (column.complete() - origin) / SECONDS["us since 1970"]
        if np.any(np.diff(own) < 0):
            raise RecordingError(
                f"column {column.title}: expected times that do not decrease, got {column.title} "
                f"earlier in {column.place} {column.lines[int(np.argmax(np.diff(own) < 0)) + 1]}"
            )
        read = temperatures[channel]
        there = ~np.isnan(read.values)
        values = np.where(there, np.interp(time, own[there], read.values[there]), np.nan)
        temperatures[channel] = replace(read, values=values)


def _hint(name: str) -> str:
    """Suggests what an unknown column may mean, for the end of a message; empty without an idea."""
    if re.match(r"duty[ _-]?(heater|heating|cooler|peltier|tec)s?(_%)?$", name.lower()):
        return "; the drives of the cells are duty_P1, duty_P2, ...: is it duty_P1?"
    if re.match(r"(set_?point|reference|target|soll(wert)?)s?([ _-]|$)", name.lower()):
        return "; references of a controller are no part of a recording"
    if re.match(r"fans?([ _-]|$)", name.lower()):
        return "; the speed of a fan is an input that the rig file declares in [[inputs]]"
    cell = re.fullmatch(r"(duty|pwm|)[ _-]*(p|cell|)[ _-]*0*([1-9]\d*)(_%)?", name.lower())
    if cell and (cell[1] or cell[2]):
        return f"; is it {cell[1] or 'duty'}_P{cell[3]}{cell[4] or ''}?"
    if re.search(r"_(degF|°F|F)$", name):
        return "; temperatures in degF are not read"
    if re.fullmatch(r"[A-Za-z][\w.-]*", name) and not name.startswith(("duty", "pwm")):
        return f"; is it a temperature without its unit, {name}_degC?"
    return ""


def _celsius(column: Column) -> np.ndarray:
    return column.values - ZERO_CELSIUS if column.name.endswith("_K") else column.values


def write_csv(experiment: Experiment, stream: IO[bytes]) -> None:
    """Writes the experiment as a .csv file, which `parse_csv` reads back exactly; some rows at a
    time, since text takes ten times the memory of numbers."""
    samples = len(experiment.time)
    cells = [f"duty_P{cell + 1}" for cell in range(experiment.n_cells)]
    channels = [f"{channel}_degC" for channel in experiment.channels]
    ambient = [] if experiment.ambient is None else ["ambient_degC"]
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    inputs = experiment.inputs
    writer.writerow(["time_s", *cells, *channels, *ambient, *(f"input_{name}" for name in inputs)])
    room = np.broadcast_to(0.0 if experiment.ambient is None else experiment.ambient, samples)
    for first in range(0, samples, ROWS):
        part = slice(first, first + ROWS)
        recorded = experiment.temperatures
        readings = [[""] * len(channels)] * len(experiment.time[part])
        if recorded is not None:
            rows = recorded[part].tolist()
            readings = [["" if value != value else value for value in row] for row in rows]
        columns = experiment.time[part].tolist(), experiment.duty[part].tolist(), readings
        rooms = room[part, None].tolist() if ambient else [[]] * len(experiment.time[part])
        others = [values[part].tolist() for values in inputs.values()]
        states = zip(*others, strict=True) if others else [()] * len(experiment.time[part])
        for time, duty, row, degC, levels in zip(*columns, rooms, states, strict=True):
            writer.writerow([time, *duty, *row, *degC, *levels])
    text.flush()
    text.detach()
