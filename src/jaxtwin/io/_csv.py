"""Recordings as text: a line of column names with units, then a line for each sample.

`time_s,duty_P1,duty_P2,T11_degC,T12_degC,ambient_degC`

Numbers are written with as many digits as it takes to read the same number back.
"""

import csv
import io
import re

import numpy as np

from .._errors import RecordingError
from ._checks import ABSOLUTE_ZERO
from ._counts import duty_from_counts
from ._experiment import Experiment

ALLOWED = (
    "allowed are, separated by commas, time_s, duty_P1 (-1 to 1) or pwm_P1 (counts) for each cell, "
    "NAME_degC or NAME_K for each channel, and ambient_degC or ambient_K"
)


def parse_csv(content: bytes, *, name: str, counts: int, polarity: int) -> Experiment:
    """The experiment in a .csv file; for the arguments see `read_recording`."""
    columns = _columns(content)
    time = columns.pop("time_s", None)
    if time is None:
        raise RecordingError(f"has no column time_s; {ALLOWED}")
    duty: dict[int, np.ndarray] = {}
    temperatures: dict[str, np.ndarray] = {}
    for title, values in columns.items():
        if cell := re.fullmatch(r"(duty|pwm)_P([1-9]\d{0,3})", title):
            kind, number = cell[1], int(cell[2])
            if number in duty:
                raise RecordingError(f"has two columns for the drive of cell P{number}")
            if kind == "pwm":
                values = duty_from_counts(values[:, None], counts, polarity)[:, 0]
            duty[number] = values
        elif channel := re.fullmatch(r"(.+)_(degC|K)", title):
            label, unit = channel.groups()
            if label in temperatures:
                raise RecordingError(f"has two columns for the temperature {label}")
            temperatures[label] = values + ABSOLUTE_ZERO if unit == "K" else values
        else:
            raise RecordingError(f"column {title!r} is not known; {ALLOWED}")
    if sorted(duty) != list(range(1, len(duty) + 1)) or not duty:
        found = ", ".join(f"P{number}" for number in sorted(duty)) or "none"
        raise RecordingError(
            f"has drives of the cells {found}; allowed are P1, P2, ... without gap"
        )
    ambient = temperatures.pop("ambient", None)
    blank = {label for label, values in temperatures.items() if not values.size}
    if blank and len(blank) < len(temperatures):
        raise RecordingError(
            f"channel {', '.join(sorted(blank))} is blank; allowed is a number in every line, or "
            "blank in all channels where none was recorded"
        )
    return Experiment(
        time,
        np.stack([duty[number] for number in sorted(duty)], axis=1),
        channels=tuple(temperatures),
        temperatures=np.stack(list(temperatures.values()), axis=1)
        if temperatures and not blank
        else None,
        ambient=ambient,
        name=name,
    )


def format_csv(experiment: Experiment) -> str:
    """The experiment as the text of a .csv file, which `parse_csv` reads back exactly."""
    samples = len(experiment.time)
    columns: dict[str, list] = {"time_s": experiment.time.tolist()}
    for cell, duty in enumerate(experiment.duty.T):
        columns[f"duty_P{cell + 1}"] = duty.tolist()
    for index, channel in enumerate(experiment.channels):
        recorded = experiment.temperatures
        columns[f"{channel}_degC"] = (
            [""] * samples if recorded is None else recorded[:, index].tolist()
        )
    if experiment.ambient is not None:
        columns["ambient_degC"] = np.broadcast_to(experiment.ambient, samples).tolist()
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return text.getvalue()


def _columns(content: bytes) -> dict[str, np.ndarray]:
    """The columns by title, float64; one that is blank in every line has no numbers."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordingError(
            f"is no recording: neither MATLAB nor netCDF, and no text (byte {error.start})"
        ) from None
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    titles: list[str] = []
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        for row in reader:
            if not row or (row[0].startswith("#") and not rows):
                continue
            if not titles:
                titles = _titles(row)
                continue
            if len(row) != len(titles):
                raise RecordingError(
                    f"line {reader.line_num} has {len(row)} fields; the columns are {len(titles)}"
                )
            rows.append(row)
            lines.append(reader.line_num)
    except csv.Error as error:
        raise RecordingError(f"line {reader.line_num} is no line of a .csv file: {error}") from None
    if not rows:
        raise RecordingError("is empty: it holds no samples; at least 2 are needed")
    return {
        title: _numbers(title, [row[index].strip() for row in rows], lines)
        for index, title in enumerate(titles)
    }


def _titles(row: list[str]) -> list[str]:
    titles = [title.strip() for title in row]
    if "time_s" not in titles:
        found = ",".join(row)
        raise RecordingError(
            f"is no recording: its first line {found[:60]!r} must name the columns; {ALLOWED}"
        )
    twice = sorted({title for title in titles if titles.count(title) > 1})
    if twice:
        raise RecordingError(f"column {', '.join(twice)} occurs more than once; allowed is once")
    return titles


def _numbers(title: str, fields: list[str], lines: list[int]) -> np.ndarray:
    if title.endswith(("_degC", "_K")) and not any(fields):
        return np.empty(0)
    values = np.array([_number(field) for field in fields])
    (wrong,) = np.nonzero(~np.isfinite(values))
    if wrong.size:
        index = wrong[0]
        raise RecordingError(
            f"line {lines[index]}, column {title}: found {fields[index][:40]!r}; allowed are "
            "finite numbers such as 21.5"
        )
    return values


def _number(field: str) -> float:
    """The number that the field holds, NaN where it holds none."""
    try:
        # float() would read 1_000 as a thousand
        return float("nan" if "_" in field else field)
    except ValueError:
        return float("nan")
