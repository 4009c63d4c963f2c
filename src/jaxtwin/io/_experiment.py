"""An experiment on a rig: its inputs, and the temperatures that were recorded."""

import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, final

import numpy as np
from jaxtyping import Bool, Float, Shaped
from numpy.typing import ArrayLike

from .._arguments import finite_number, is_ordered, of_kind
from .._display import aligned, html_table, picture
from .._name_suggestions import did_you_mean
from .._result import AbstractResult, dataset, table
from .._temperature_schedule import scheduled_temperatures
from ..errors import JaxtwinError, RecordingError
from ..rig import Rig
from ._checks import (
    checked_ambient,
    checked_cells,
    checked_channels,
    checked_duty,
    checked_inputs,
    checked_temperatures,
    checked_time,
)
from ._gaps import elapsed_time, gap_sentences, gap_steps, part_of, parts_between_gaps
from ._glitches import Glitch, glitch_offsets
from ._schedule import schedule_samples

if TYPE_CHECKING:
    import pandas
    import polars  # pyright: ignore[reportMissingImports]
    import xarray
    from matplotlib.figure import Figure

# One recording or several, or their files.
Recordings: TypeAlias = (
    "Experiment | str | os.PathLike[str] | Sequence[Experiment | str | os.PathLike[str]]"
)

# The name of an experiment in error messages.
EXPERIMENT = "an Experiment, as read_recording, Experiment.schedule and .from_dataframe make it"


@final
@dataclass(frozen=True, init=False, eq=False, repr=False)
class Experiment(AbstractResult):
    """The inputs, the outputs and the ambient temperature of one run of a rig. They are checked,
    read-only and in float64.

    Two experiments are equal when their contents are, whatever their names, and columns of duty
    belong to the same cells, where both say to which; a cache can use `fingerprint` as its key.

    **Arguments:**

    - `time`: strictly increasing, at least two samples, `(times,)`, s. It need not start at 0.
    - `duty`: the duty cycle of each cell, -1 to 1, positive heats the plate, `(times, cells)`, or
      `(times,)` for a single cell. Sample k is held until time k + 1.
    - `cells`: the names of the cells and heaters that the columns of duty belong to; by default
      they are in the order of the rig. `for_rig` puts them in this order.
    - `channels`: the names of the temperature channels. They may be given without temperatures, to
      choose the channels that a simulation returns.
    - `temperatures`: recorded temperatures `(times, channels)`, degC, or `None`. A missing sample
      is NaN (masked values, None and pandas' NA become NaN). It has no weight wherever recorded and
      simulated temperatures are compared. `sampled` marks the samples that exist.
    - `ambient`: ambient temperature, degC: a number, a series `(times,)`, or `None` if it is not
      known. A constant series is stored as a number. Missing samples of a series are interpolated
      linearly; before the first and after the last it stays constant.
    - `inputs`: the rig's other inputs, name -> a number or the name of a state, for the whole run
      or for each time, such as `{"lid": "closed"}`. Sample k is held until time k + 1.
    - `name`: a label for plots and tables.
    - `group`: the day or session to which it belongs, in which camera and contacts stayed as they
      were; recordings of a group share the values of the parameters that `match` lets differ
      between groups.
    - `notes`: what was done when it was read that its numbers do not show, such as readings that
      are codes and count as missing; a sentence each.
    - `start`: the clock time at 0 s, in the time zone of the recording; None: it is not known.

    **Raises:**

    `RecordingError` that names the sample and what was expected: a time or duty cycle that is
    missing or not finite, time that does not increase, a duty cycle outside -1 to 1, temperatures
    below absolute zero or without any sample, shapes that do not belong together, channel names
    that occur twice.
    """

    time: Float[np.ndarray, "times"]
    duty: Float[np.ndarray, "times cells"]
    cells: tuple[str, ...]
    channels: tuple[str, ...]
    temperatures: Float[np.ndarray, "times channels"] | None
    ambient: float | Float[np.ndarray, "times"] | None
    inputs: Mapping[str, Shaped[np.ndarray, "times"]]
    name: str
    group: str
    notes: tuple[str, ...]
    start: datetime | None

    def __init__(
        self,
        time: ArrayLike,
        duty: ArrayLike,
        *,
        cells: Iterable[str] = (),
        channels: Iterable[str] = (),
        temperatures: ArrayLike | None = None,
        ambient: ArrayLike | float | int | None = None,
        inputs: Mapping[str, ArrayLike | float | int] | None = None,
        name: str = "",
        group: str = "",
        notes: Iterable[str] = (),
        start: datetime | None = None,
    ) -> None:
        times = checked_time(time)
        names = checked_channels(channels)
        cells = tuple(cells) if is_ordered(cells) else cells
        driven = checked_duty(duty, times, cells if isinstance(cells, tuple) else ())
        fields = {
            "time": times,
            "duty": driven,
            "cells": checked_cells(cells, driven.shape[1]),
            "channels": names,
            "temperatures": checked_temperatures(temperatures, times, names),
            "ambient": checked_ambient(ambient, times),
            "name": of_kind("name", name, str, "text", RecordingError),
            "group": of_kind("group", group, str, "text", RecordingError),
            "inputs": checked_inputs(inputs, times),
            "notes": tuple(notes),
            "start": start,
        }
        for field, value in fields.items():
            object.__setattr__(self, field, value)

    @classmethod
    def schedule(
        cls,
        text: str,
        *,
        duration: Any,
        step: Any = 1.0,
        cells: int = 1,
        channels: Iterable[str] = (),
        ambient: str | float | int | None = None,
        inputs: Mapping[str, str] | None = None,
        name: str = "",
    ) -> "Experiment":
        """An experiment without recorded temperatures, from a duty schedule in words.

        **Arguments:**

        - `text`: `"0:0.5,500:0.78"` is a duty cycle of 0.5 in every cell from 0 s and 0.78 from 500
          s on; `"0:0.5/0.3"` states a duty for each cell. Before the first time the duty is 0.
        - `duration`, `step`: the samples are 0, step, 2 step, ... up to the duration: numbers in
            s, text such as `"10 min"`, or quantities of pint. A switch between two samples gets
            one of its own.
        - `cells`: number of cells.
        - `inputs`: schedules of the rig's other inputs, such as `{"lid": "0:closed,600:open"}` or
          `{"flow": "0:1.5,300:0"}`, the first of which begins at 0 s.
        - `ambient`: the temperature of the room, degC: a number, or text such as
          `"0:20,ramp 3600:25"` for one that is held until the next time, or reached along a line.
        - `channels`, `name`: as in `Experiment`.

        **Returns:**

        The `Experiment`.

        **Raises:**

        `RecordingError` that quotes the invalid entry.
        """
        time, duty, columns = schedule_samples(
            text, duration=duration, step=step, cells=cells, inputs=inputs or {}
        )
        where = "schedule: ambient"
        room = (
            scheduled_temperatures(where, ambient, time, 1, RecordingError)[:, 0]
            if isinstance(ambient, str)
            else ambient
        )
        return cls(time, duty, channels=channels, ambient=room, inputs=columns, name=name)

    @classmethod
    def from_dataframe(
        cls,
        frame: "pandas.DataFrame | polars.DataFrame",
        *,
        rig: Rig | None = None,
        time: str | None = None,
        counts: int | None = None,
        polarity: Literal[1, -1] = 1,
        name: str = "",
    ) -> "Experiment":
        """An experiment from a table of pandas or polars with the columns of a .csv recording:
        `duty_P1` or `pwm_P1` for each cell, `NAME_degC` or `NAME_K` for each channel,
        and `ambient_degC`; units may stand in brackets. `frame.rename(columns=...)` gives other
        columns these names, and `frame[[...]]` leaves some out.

        **Arguments:**

        - `frame`: a row for each sample. A missing temperature is NaN, None or NA, or the code of a
          sensor; a missing duty is the last one.
        - `rig`: the rig, as in `read_recording`.
        - `time`: the column of the times. By default the index if it holds durations or time
            stamps, otherwise a column of these or `time_s`, otherwise the index, in s, unless it
            only numbers the rows. Times are numbers in s or in the unit of their title, durations
            (timedelta) or time stamps (datetime), counted from the first.
        - `counts`, `polarity`: those of `pwm_P1`, as in `read_recording`.
        - `name`: as in `Experiment`.

        **Returns:**

        The `Experiment`.

        **Raises:**

        `RecordingError` that names the column and, if there is one, the row, counted from 0.
        """
        from ._dataframe import experiment_of_dataframe

        return experiment_of_dataframe(
            frame, rig=rig, time=time, counts=counts, polarity=polarity, name=name
        )

    @classmethod
    def from_xarray(cls, dataset: "xarray.Dataset", *, name: str | None = None) -> "Experiment":
        """An experiment from a labelled data set, as `to_xarray` gives it.

        **Arguments:**

        - `dataset`: `duty` (time, cell) and, if they are known, `temperature` (time, channel) and
          `ambient`, with their units as attributes. Other variables are ignored.
        - `name`: as in `Experiment`; None: the attribute `name` of the data set.

        **Returns:**

        The `Experiment`.

        **Raises:**

        `RecordingError` that names the variable, its dimensions or its unit.
        """
        from ._netcdf import experiment_of_dataset

        return experiment_of_dataset(dataset, name=name)

    def with_inputs(self, **inputs: Any) -> "Experiment":
        """The experiment with these inputs beside its own, such as `with_inputs(lid="closed")`.

        **Arguments:**

        - `inputs`: as in `Experiment`.

        **Raises:**

        `RecordingError` for a shape or a number that is not valid.
        """
        return replace(self, inputs={**self.inputs, **inputs})

    def for_rig(self, rig: Rig) -> "Experiment":
        """The experiment with its columns of duty in the order of a rig, and with the names of its
        cells and heaters: those of `cells` by their names, others as they are.

        **Arguments:**

        - `rig`: the rig that it drives.

        **Raises:** `RecordingError` if the rig has other cells and heaters.
        """
        from ._duty_of_rig import of_rig  # which imports this module

        return of_rig(self, rig, self.name or "the experiment", RecordingError)

    def switched(self, rig: Rig) -> "Experiment":
        """The experiment as the relays of a rig switch it: where a heater is `time_proportional` in
        the rig file, its duty is 1 or 0, with a sample at each switch. A simulation of it shows the
        ripple of the temperatures; without this a twin has the mean duty. Windows begin at the
        first sample. Temperatures at the additional times are missing.

        ```python
        drive = Experiment.schedule("0:0.3", duration=600, step=1, cells=len(twin.rig.driven))
        ripple = twin.simulate(drive.switched(twin.rig))
        ```

        **Arguments:**

        - `rig`: the rig that it drives.

        **Raises:** `RecordingError` if the rig has other cells and heaters, or for more switches
        than fit into memory.
        """
        from ._duty_of_rig import switched  # which imports this module

        return switched(self, rig)

    @property
    def n_cells(self) -> int:
        """The number of cells and heaters."""
        return self.duty.shape[1]

    @property
    def cell_names(self) -> tuple[str, ...]:
        """The names of the cells and heaters: `cells`, or else P1, P2, ..."""
        return self.cells or tuple(f"P{number + 1}" for number in range(self.n_cells))

    @property
    def duration(self) -> float:
        """The time from the first sample to the last, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def sampled(self) -> Bool[np.ndarray, "times channels"]:
        """Whether a temperature was recorded, `(times, channels)`: False at a missing sample."""
        if self.temperatures is None:
            return np.zeros((len(self.time), len(self.channels)), bool)
        return ~np.isnan(self.temperatures)

    @property
    def unsampled(self) -> tuple[str, ...]:
        """The channels without any recorded temperature, though others have some."""
        if self.temperatures is None:
            return ()
        counts = np.count_nonzero(self.sampled, axis=0)
        return tuple(name for name, n in zip(self.channels, counts, strict=True) if n == 0)

    @property
    def glitches(self) -> "tuple[Glitch, ...]":
        """The readings that are far from those before and after them, which are alike: no
        temperature of the rig, but an error of a sensor or of a logger."""
        if self.temperatures is None:
            return ()
        offsets = glitch_offsets(self.temperatures)
        return tuple(
            Glitch(
                self.channels[column],
                float(self.time[row]),
                float(self.temperatures[row, column]),
                float(offsets[row, column]),
            )
            for row, column in np.argwhere(offsets != 0)
        )

    def without_glitches(self) -> "Experiment":
        """The experiment with its `glitches` as missing samples, which its `notes` name; itself if
        there are none."""
        if not (glitches := self.glitches):
            return self
        assert self.temperatures is not None
        offsets = glitch_offsets(self.temperatures)
        notes = [f"left out: {glitch}" for glitch in glitches]
        readings = np.where(offsets == 0, self.temperatures, np.nan)
        return replace(self, temperatures=readings, notes=(*self.notes, *notes))

    @property
    def switch_times(self) -> Float[np.ndarray, "switches"]:
        """The times at which the duty cycle of any cell changes, without the first sample, s."""
        changes = np.any(self.duty[1:] != self.duty[:-1], axis=1)
        return self.time[1:][changes]

    @property
    def gaps(self) -> Float[np.ndarray, "gaps 2"]:
        """Start and end of every step that is longer than three median steps, s."""
        before = gap_steps(self).before
        return np.stack([self.time[before], self.time[before + 1]], axis=1)

    @property
    def parts(self) -> "tuple[Experiment, ...]":
        """The parts between gaps, named after the experiment with their number; the experiment
        itself if it has no gap. Each begins with the recording, but only its own readings are
        there: a run reaches it with the rig as the duty has left it. It begins behind the last gap
        that is too long for that."""
        return parts_between_gaps(self)

    @cached_property
    def elapsed(self) -> Float[np.ndarray, "times"]:
        """The time that passed for the rig since the first sample, s: that of the samples, unless a
        gap is too long to hold the duty, such as that of a clock that was moved."""
        return elapsed_time(self)

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of the contents, as hexadecimal digits; names, those of cells too, and notes do
        not count."""
        content = hashlib.sha256(repr((self.duty.shape, self.channels)).encode())
        for part in (self.time, self.duty, self.temperatures, self.ambient):
            if part is None:
                content.update(b"none")
            else:
                array = np.asarray(part, np.float64) + 0.0  # -0.0 and 0.0 are the same number
                content.update(repr(array.shape).encode() + array.tobytes())
        for name, values in self.inputs.items():
            content.update(repr((name, values.dtype.str)).encode() + values.tobytes())
        return content.hexdigest()

    def between(self, t0: float | int | None = None, t1: float | int | None = None) -> "Experiment":
        """The part of the experiment with `t0 <= time < t1`, at its own times.

        `between(None, 500)` and `between(500, None)` share no sample, so that they divide an
        experiment into parts for matching and validation.

        **Arguments:**

        - `t0`, `t1`: the start and the end, s; `None` leaves that end open.

        **Returns:**

        An `Experiment` whose time is not shifted.

        **Raises:**

        `RecordingError` if fewer than two samples are left.
        """
        start = -np.inf if t0 is None else finite_number("between: t0", t0, RecordingError)
        end = np.inf if t1 is None else finite_number("between: t1", t1, RecordingError)
        part = (self.time >= start) & (self.time < end)
        if np.count_nonzero(part) < 2:
            raise RecordingError(
                f"between: expected at least 2 samples of {self!r} between {start:g} s and "
                f"{end:g} s, got {np.count_nonzero(part)}"
            )
        return part_of(self, part, self.name)

    def begins_with(self, other: "Experiment") -> bool:
        """Whether the times and duties of another experiment are the first ones of this."""
        count = len(other.time)
        return np.array_equal(self.time[:count], other.time) and np.array_equal(
            self.duty[:count], other.duty
        )

    def select(self, channels: Iterable[str]) -> "Experiment":
        """Returns the experiment with only these channels, in this order.

        **Arguments:**

        - `channels`: names of channels in `self.channels`.

        **Returns:**

        An `Experiment`.

        **Raises:**

        `RecordingError` for an unknown name, or a name that occurs twice.
        """
        names = checked_channels(channels)
        unknown = [name for name in names if name not in self.channels]
        if unknown or not names:
            known = ", ".join(self.channels) or "none"
            raise RecordingError(
                f"channels: expected some of {known}, got {', '.join(unknown) or 'none'}"
                f"{did_you_mean(unknown, self.channels)}"
            )
        columns = [self.channels.index(name) for name in names]
        temperatures = None if self.temperatures is None else self.temperatures[:, columns]
        return replace(self, channels=names, temperatures=temperatures)

    def to_xarray(self) -> "xarray.Dataset":
        """The experiment as a labelled data set.

        **Returns:**

        `duty` (time, cell); if they are known, `temperature` (time, channel), degC, and `ambient`
        (a number or (time,)), degC; `input_NAME` (time) for each other input. Units are attributes;
        cells are named by `cells`, or else P1, P2, ...
        """
        variables: dict[str, Any] = {
            "duty": ("time cell", self.duty, "1", "duty cycle"),
            "time": ("time", self.time, "s"),
        }
        labels = {"cell": self.cell_names}
        if self.temperatures is not None:
            variables["temperature"] = ("time channel", self.temperatures, "degC")
        for name, values in self.inputs.items():
            variables[f"input_{name}"] = ("time", values)
        if self.ambient is not None:
            dimensions = "time" if isinstance(self.ambient, np.ndarray) else ""
            variables["ambient"] = (dimensions, self.ambient, "degC", "ambient temperature")
        if self.channels:
            labels["channel"] = self.channels
        return dataset(variables, {"name": self.name}, **labels)

    def to_dataframe(self) -> "pandas.DataFrame":
        """The experiment as a table with the columns of a .csv recording, which `from_dataframe`
        reads back: a row for each sample, its index `time_s`; `duty_P1`, ..., `T11_degC`, ... and,
        if it is known, `ambient_degC`. A missing temperature is NaN."""
        readings = self.temperatures
        if readings is None:
            readings = np.full((len(self.time), len(self.channels)), np.nan)
        columns = {"time_s": self.time}
        columns |= {f"duty_{n}": duty for n, duty in zip(self.cell_names, self.duty.T, strict=True)}
        columns |= {f"{n}_degC": read for n, read in zip(self.channels, readings.T, strict=True)}
        if self.ambient is not None:
            columns["ambient_degC"] = np.broadcast_to(self.ambient, self.time.shape)
        columns |= {f"input_{name}": values for name, values in self.inputs.items()}
        return table(columns, "time_s")

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes it to a .csv or a netCDF (.nc) file, as `write_recording` does.

        **Returns:** the path.

        **Raises:** the errors of `write_recording`.
        """
        from ._write import write_recording

        return write_recording(self, Path(path))

    def plot(self) -> "Figure":
        """Plots the channels' temperatures above the cells' duty cycles. Several
        experiments side by side are drawn by `jaxtwin.plots.plot_recordings`."""
        return picture("plot_recordings", [self])

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Experiment):
            return NotImplemented
        are_same = not (self.cells and other.cells) or self.cells == other.cells
        return are_same and self.fingerprint == other.fingerprint

    def __hash__(self) -> int:
        return hash(self.fingerprint)

    def __repr__(self) -> str:
        return f"<Experiment {'; '.join(f'{row}: {text}' for row, text in self._summary())}>"

    def summary(self) -> str:
        """What it is made of, a line each."""
        return aligned(self._summary())

    def _repr_html_(self) -> str:
        return html_table("Experiment", ("", ""), self._summary())

    def _summary(self) -> list[tuple[str, str]]:
        step = np.median(np.diff(self.time))
        first, last = self.time[0], self.time[-1]
        duty = f"{self.duty.min():.3g} to {self.duty.max():.3g}"
        changes = _count(len(self.switch_times), "change")
        measured = " (not recorded)" if self.channels and self.temperatures is None else ""
        if self.temperatures is not None and not self.sampled.all():
            measured = f" ({self._missing()})"
        if isinstance(self.ambient, np.ndarray):
            ambient = f"{self.ambient.min():.1f} to {self.ambient.max():.1f} degC"
        else:
            ambient = "unknown" if self.ambient is None else f"{self.ambient:.1f} degC"
        return [
            ("name", self.name or "-"),
            ("time", f"{len(self.time)} samples, {first:g} to {last:g} s, every {step:g} s"),
            ("duty", f"{', '.join(self.cells) or _count(self.n_cells, 'cell')}, {duty}, {changes}"),
            ("channels", (", ".join(self.channels) or "none") + measured),
            ("ambient", ambient),
            *(("gap", sentence.removeprefix(f"{self.name}: ")) for sentence in gap_sentences(self)),
            *([("inputs", ", ".join(self.inputs))] if self.inputs else []),
            *([("notes", "; ".join(self.notes))] if self.notes else []),
        ]

    def _missing(self) -> str:
        """Text on the number of missing samples, and on channels without any sample."""
        number = self.sampled.size - np.count_nonzero(self.sampled)
        text = f"{number} of {_count(self.sampled.size, 'sample')} missing"
        return f"{text}, {', '.join(self.unsampled)} without any" if self.unsampled else text


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def as_experiment(where: str, given: Any, error: type[JaxtwinError], rig: Rig) -> Experiment:
    """An experiment, or the recording of a rig in a file; errors as for `as_experiments`."""
    (experiment,) = as_experiments(where, [given], error, rig)
    return experiment


def as_experiments(
    where: str, given: Any, error: type[JaxtwinError], rig: Rig | None = None
) -> list[Experiment]:
    """Makes a list of one experiment or of several.

    **Arguments:**

    - `where`: the function and the argument, for the message.
    - `given`: one experiment or several. The list may be empty.
    - `rig`: the rig, if the paths of recordings of it are taken as well. Columns of duty are put in
      its order.

    **Raises:** `error` if anything else is given; `RecordingError` for a file that cannot be read.
    """
    from ._duty_of_rig import of_rig  # which imports this module
    from ._read import read_recording  # which imports this module

    is_list = isinstance(given, Iterable) and not isinstance(given, str | bytes)
    items = list(given) if is_list else [given]
    if rig is not None:
        items = [
            read_recording(Path(item), rig=rig) if isinstance(item, str | os.PathLike) else item
            for item in items
        ]
    several = [of_kind(where, item, Experiment, EXPERIMENT, error) for item in items]
    return (
        several
        if rig is None
        else [
            of_rig(experiment, rig, experiment.name or "the experiment", error)
            for experiment in several
        ]
    )
