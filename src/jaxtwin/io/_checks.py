"""What the fields of an `Experiment` must be; each check returns the field as it is held."""

import sys
from collections.abc import Iterable
from numbers import Real
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from .._errors import RecordingError
from ..rig._camera import is_channel_name

ABSOLUTE_ZERO = -273.15  # degC
ROUNDING = 1e-9  # counts / 255 and unit conversions may leave this much above full duty


class WrongSampleError(RecordingError):
    """A sample that breaks a rule, and its number, by which a reader of files finds its line."""

    def __init__(self, message: str, sample: int):
        super().__init__(message)
        self.sample = sample


def checked_time(time: ArrayLike) -> Float[np.ndarray, "times"]:
    """Time `(times,)`, s: finite and strictly increasing, at least two samples."""
    times = _numbers(time, "time")
    if times.ndim != 1:
        raise RecordingError(f"time has shape {times.shape}; allowed is (times,)")
    if times.size < 2:
        raise RecordingError(f"the recording is empty: {times.size} samples; at least 2 are needed")
    _check_finite(times, "time", times)
    (late,) = np.nonzero(np.diff(times) <= 0)
    if late.size:
        k = late[0]
        raise WrongSampleError(
            f"time does not increase at sample {k + 1}: {times[k + 1]:g} s after {times[k]:g} s; "
            "each time must be later than the one before",
            int(k) + 1,
        )
    return times


def checked_duty(
    duty: ArrayLike, time: Float[np.ndarray, "times"]
) -> Float[np.ndarray, "times cells"]:
    """Duty cycles `(times, cells)`: finite, -1 to 1, at least one cell."""
    values = _numbers(duty, "duty")
    if values.ndim == 1:
        values = values[:, None]
    if values.ndim != 2 or values.shape[0] != time.size or values.shape[1] == 0:
        raise RecordingError(
            f"duty has shape {np.shape(values)}; allowed is (times, cells) with {time.size} times "
            "and at least one cell"
        )
    for cell, column in enumerate(values.T):
        _check_finite(column, f"duty of cell {cell + 1}", time)
    outside = np.argwhere(np.abs(values) > 1 + ROUNDING)
    if outside.size:
        k, cell = outside[0]
        raise WrongSampleError(
            f"duty of cell {cell + 1} is {values[k, cell]:g} at {_sample(k, time)}; "
            "allowed is -1 to 1",
            int(k),
        )
    return _held(np.clip(values, -1, 1))


def duty_from_counts(
    pwm: Float[np.ndarray, "times cells"], counts: int, polarity: int
) -> Float[np.ndarray, "times cells"]:
    """Duty cycles, positive where the plate is heated.

    **Arguments:**

    - `pwm`: -counts to counts, `(times, cells)`.
    - `counts`: counts of full duty.
    - `polarity`: 1 where positive counts heat the plate, -1 where they cool it.

    **Returns:**

    Duty cycles `(times, cells)`, -1 to 1. What is not finite stays so.

    **Raises:**

    `RecordingError` that names the cell and the sample of a count out of range.
    """
    outside = np.argwhere(np.abs(pwm) > counts)
    if outside.size:
        k, cell = outside[0]
        raise WrongSampleError(
            f"PWM of cell {cell + 1} is {pwm[k, cell]:g} at sample {k} (counted from 0); "
            f"allowed is {-counts} to {counts} counts",
            int(k),
        )
    return polarity * pwm / counts


def checked_channels(channels: Iterable[str]) -> tuple[str, ...]:
    """Channel names, each once. A single string is one name."""
    if not isinstance(channels, Iterable):
        raise RecordingError(f"channels: found {channels!r}, allowed is one name or several")
    names = (channels,) if isinstance(channels, str) else tuple(channels)
    # NumPy's and pandas' own kinds of text print in another way.
    names = tuple(str(name) if isinstance(name, str) else name for name in names)
    for name in names:
        if not isinstance(name, str) or not is_channel_name(name):
            raise RecordingError(
                f"channel name {name!r}: allowed are letters, digits and, between them, '_-.' "
                "and blanks"
            )
        if name == "ambient":
            raise RecordingError("channel name 'ambient' is taken: give it as the argument ambient")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise RecordingError(f"channel {', '.join(twice)} occurs more than once; allowed is once")
    return names


def checked_temperatures(
    temperatures: ArrayLike | None, time: Float[np.ndarray, "times"], channels: tuple[str, ...]
) -> Float[np.ndarray, "times channels"] | None:
    """Temperatures `(times, channels)`, degC, above absolute zero, or `None`.

    A sample that is missing is NaN; masked values and None become that. At least one is there.
    """
    if temperatures is None:
        return None
    values = _numbers(temperatures, "temperatures", may_lack=True)
    if values.ndim == 1:
        values = values[:, None]
    if values.shape != (time.size, len(channels)) or not channels:
        raise RecordingError(
            f"temperatures have shape {values.shape}; allowed is (times, channels) with "
            f"{time.size} times and one column for each channel name, of which there are "
            f"{len(channels)}"
        )
    for name, column in zip(channels, values.T, strict=True):
        _check_temperature(column, f"temperature {name}", time)
    if np.isnan(values).all():
        raise RecordingError(
            "temperatures: found no sample that is not missing (NaN), allowed is at least one; "
            "pass None where nothing was recorded"
        )
    return values


def checked_ambient(
    ambient: ArrayLike | float | int | None, time: Float[np.ndarray, "times"]
) -> float | Float[np.ndarray, "times"] | None:
    """Ambient temperature, degC: a number, a series `(times,)`, or `None`.

    A series is an input of the simulation and has no gaps: what is missing from it lies on a
    straight line between its neighbours, and stays what the nearest sample was at both ends. Rooms
    change slowly, and loggers ask them less often than the plate.
    """
    if ambient is None:
        return None
    values = _numbers(ambient, "ambient", may_lack=True)
    if values.shape not in ((), time.shape):
        raise RecordingError(
            f"ambient has shape {values.shape}; allowed is one number or ({time.size},)"
        )
    there = ~np.isnan(values)
    if not there.any():
        raise RecordingError(
            "ambient is nan throughout; allowed are temperatures, or None where it is not known"
        )
    if not there.all():
        values = _held(np.interp(time, time[there], values[there]))
    _check_temperature(np.broadcast_to(values, time.shape), "ambient", time)
    if np.all(values == values.flat[0]):
        return float(values.flat[0])
    return values


def _numbers(values: Any, field: str, may_lack: bool = False) -> np.ndarray:
    """The field as real numbers; NaN for what is masked, None or NA, where it `may_lack` some."""
    if np.ma.is_masked(values):  # the mask would be lost and what it hides come to light
        if not may_lack:
            raise RecordingError(f"{field} has masked values; allowed are finite numbers")
        values = np.ma.filled(np.ma.asarray(values, np.float64), np.nan)
    try:
        array = np.asarray(values)
    except ValueError:  # rows of different lengths
        raise RecordingError(f"{field} is no array of numbers: its rows differ in length") from None
    if array.dtype == object:
        array = _without_none(array)
    if array.size and array.dtype.kind not in "iuf":
        raise RecordingError(f"{field} holds {array.dtype.name} values; allowed are real numbers")
    return _held(array)


def _without_none(objects: np.ndarray) -> np.ndarray:
    """Numbers among None and pandas' NA, with NaN for these; unchanged where it is anything else.

    Lists with None come as objects, and so do the columns of pandas that know NA.
    """
    pandas = sys.modules.get("pandas")
    missing = (None,) if pandas is None else (None, pandas.NA)
    plain = [float("nan") if any(x is marker for marker in missing) else x for x in objects.flat]
    if not all(isinstance(x, Real) and not isinstance(x, bool | np.bool_) for x in plain):
        return objects
    return np.array(plain, np.float64).reshape(objects.shape)


def _held(array: np.ndarray) -> np.ndarray:
    """A copy that nobody else can change, so that an experiment and its fingerprint stay true."""
    copy = np.array(array, np.float64, order="C")
    copy[np.isnan(copy)] = np.nan  # one of the many bit patterns that mean it
    copy.setflags(write=False)
    return copy


def _check_finite(values: np.ndarray, field: str, time: np.ndarray) -> None:
    (wrong,) = np.nonzero(~np.isfinite(values))
    if wrong.size:
        k = wrong[0]
        raise WrongSampleError(
            f"{field} is {values[k]} at {_sample(k, time)}; allowed are finite numbers", int(k)
        )


def _check_temperature(values: np.ndarray, field: str, time: np.ndarray) -> None:
    """Absolute zero or above and finite, or NaN."""
    _check_finite(np.nan_to_num(values, nan=0.0, posinf=np.inf, neginf=-np.inf), field, time)
    (wrong,) = np.nonzero(values < ABSOLUTE_ZERO)
    if wrong.size:
        k = wrong[0]
        raise WrongSampleError(
            f"{field} is {values[k]:g} degC at {_sample(k, time)}; "
            f"allowed is {ABSOLUTE_ZERO} degC and above",
            int(k),
        )


def _sample(k: int | np.integer, time: np.ndarray) -> str:
    return f"sample {k} (counted from 0, t = {time[k]:g} s)"
