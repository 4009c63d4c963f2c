"""Checks of the fields of an `Experiment`. Each check returns the field as the experiment stores
it."""

import sys
from collections.abc import Iterable, Mapping, Sequence
from numbers import Real

import numpy as np
from jaxtyping import Float, Shaped
from numpy.typing import ArrayLike

from .._arguments import is_ordered, mapping_of
from .._celsius import COLDEST_ROOM, HOTTEST_ROOM, ZERO_CELSIUS
from .._pint_quantities import in_unit
from ..errors import RecordingError
from ..rig import is_channel_name

ABSOLUTE_ZERO = -ZERO_CELSIUS  # degC
ROUNDING = 1e-6  # sums of tenths in float32 and unit conversions may leave this much above 1

# The highest temperature of a reading, degC. Instruments send codes beyond it, such as 9.9e37 for
# an open thermocouple.
MAX_READING_DEGC = 1e4

# The longest recording, s.
MAX_RECORDING_SECONDS = 3.2e9


class WrongSampleError(RecordingError):
    """A sample is invalid. The number of the sample, from which a reader of files finds its line,
    is an attribute."""

    def __init__(self, message: str, sample: int):
        super().__init__(message)
        self.sample = sample


def checked_time(time: ArrayLike) -> Float[np.ndarray, "times"]:
    """Time `(times,)`, s: finite and strictly increasing, at least two samples."""
    times = _numbers(in_unit("time", time, "s", RecordingError), "time")
    if times.ndim != 1:
        raise RecordingError(f"time: expected shape (times,), got {times.shape}")
    if times.size < 2:
        raise RecordingError(
            f"the recording is empty: expected at least 2 samples, got {times.size}"
        )
    _check_finite(times, "time", times)
    (late,) = np.nonzero(np.diff(times) <= 0)
    if late.size:
        k = late[0]
        raise WrongSampleError(
            f"time: expected increasing times, got {times[k + 1]:.12g} s at sample {k + 1} after "
            f"{times[k]:.12g} s",
            int(k) + 1,
        )
    if times[-1] - times[0] > MAX_RECORDING_SECONDS:
        raise RecordingError(
            f"time: expected at most {MAX_RECORDING_SECONDS:.10g} s from the first sample to the "
            "last, a hundred "
            f"years, got {times[-1] - times[0]:.10g}; are they in ms or ns?"
        )
    return times


def checked_duty(
    duty: ArrayLike, time: Float[np.ndarray, "times"], names: Sequence[str] = ()
) -> Float[np.ndarray, "times cells"]:
    """Duty cycles `(times, cells)`: finite, -1 to 1, at least one cell. `names` are those of the
    columns in messages."""
    values = _numbers(in_unit("duty", duty, "", RecordingError), "duty")
    if values.ndim == 1:
        values = values[:, None]
    if values.ndim != 2 or values.shape[0] != time.size or values.shape[1] == 0:
        raise RecordingError(
            f"duty: expected shape (times, cells) with {time.size} times and at least one cell, "
            f"got {np.shape(values)}"
        )
    for cell, column in enumerate(values.T):
        _check_finite(column, f"duty of {_called(cell, names)}", time)
    outside = np.argwhere(np.abs(values) > 1 + ROUNDING)
    if outside.size:
        k, cell = outside[0].tolist()
        raise WrongSampleError(
            f"duty of {_called(cell, names)}: expected -1 to 1, got {values[k, cell]:.10g} at "
            f"{_sample(k, time)}",
            int(k),
        )
    return _held(np.clip(values, -1, 1))


def duty_from_counts(
    pwm: Float[np.ndarray, "times cells"], counts: int, polarity: int, names: Sequence[str] = ()
) -> Float[np.ndarray, "times cells"]:
    """Duty cycles, positive if the plate is heated.

    **Arguments:**

    - `pwm`: -counts to counts, `(times, cells)`.
    - `counts`: the counts of full duty.
    - `polarity`: 1 if positive counts heat the plate, -1 if they cool it.
    - `names`: those of the columns in messages.

    **Returns:**

    Duty cycles `(times, cells)`, -1 to 1. Counts that are not finite give duty cycles that are not
    finite.

    **Raises:**

    `RecordingError` that names the cell and the sample of a count out of range.
    """
    outside = np.argwhere(np.abs(pwm) > counts)
    if outside.size:
        k, cell = outside[0].tolist()
        raise WrongSampleError(
            f"PWM of {_called(cell, names)}: expected {-counts} to {counts} counts, got "
            f"{pwm[k, cell]:g} at sample {k} (counted from 0)",
            int(k),
        )
    return polarity * pwm / counts


def _called(cell: int, names: Sequence[str]) -> str:
    return names[cell] if cell < len(names) else f"cell {cell + 1}"


def checked_cells(cells: Iterable[str], number: int) -> tuple[str, ...]:
    """Checks the names of cells and heaters, of which none may occur twice: one for each column of
    duty, or none at all."""
    if not is_ordered(cells):
        raise RecordingError(f"cells: expected names in the order of the columns, got {cells!r}")
    names = tuple(cells)
    wrong = [name for name in names if not isinstance(name, str) or not name]
    if wrong or len(names) not in (0, number) or len(set(names)) < len(names):
        raise RecordingError(
            f"cells: expected the names of the {number} columns of duty, each once, got "
            f"{', '.join(map(str, names))}"
        )
    return names


def checked_channels(channels: Iterable[str]) -> tuple[str, ...]:
    """Checks channel names, of which none may occur twice. A single string is a single name.

    A set is refused, because its order is not defined and names belong to columns by their order.
    """
    if not isinstance(channels, str) and not is_ordered(channels):
        raise RecordingError(
            "channels: expected one name or several in the order of the columns, such as a list, "
            f"got {channels!r}"
        )
    names = (channels,) if isinstance(channels, str) else tuple(channels)
    # Subclasses of text by NumPy and pandas print in another way.
    names = tuple(str(name) if isinstance(name, str) else name for name in names)
    for name in names:
        if not isinstance(name, str) or not is_channel_name(name):
            raise RecordingError(
                "channel name: expected letters, digits and, between them, '_-.' and blanks, got "
                f"{name!r}"
            )
        if name == "ambient":
            raise RecordingError(
                "channel name: expected another name than 'ambient'; pass the ambient "
                "temperature as ambient=..."
            )
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise RecordingError(
            f"channels: expected each name once, got {', '.join(twice)} more than once"
        )
    return names


def checked_temperatures(
    temperatures: ArrayLike | None, time: Float[np.ndarray, "times"], channels: tuple[str, ...]
) -> Float[np.ndarray, "times channels"] | None:
    """Temperatures `(times, channels)`, degC, above absolute zero, or `None`.

    A missing sample is NaN; masked values and None become NaN. At least one sample must exist.
    """
    if temperatures is None:
        return None
    values = _numbers(
        in_unit("temperatures", temperatures, "degC", RecordingError), "temperatures", may_lack=True
    )
    if values.ndim == 1:
        values = values[:, None]
    if values.shape != (time.size, len(channels)) or not channels:
        raise RecordingError(
            f"temperatures: expected shape (times, channels) with {time.size} times and "
            f"{len(channels)} channels, one for each channel name, got {values.shape}"
        )
    for name, column in zip(channels, values.T, strict=True):
        _check_temperature(column, f"temperature {name}", time)
    if np.isnan(values).all():
        raise RecordingError(
            "temperatures: expected at least one sample, got missing ones (NaN) only; pass None "
            "if nothing was recorded"
        )
    return values


def checked_ambient(
    ambient: ArrayLike | float | int | None, time: Float[np.ndarray, "times"]
) -> float | Float[np.ndarray, "times"] | None:
    """Ambient temperature, degC: a number, a series `(times,)`, or `None`.

    A series is an input of the simulation and must have no gaps. Missing samples are interpolated
    linearly, and have the value of the nearest sample at both ends. Rooms change slowly, and
    loggers read their temperature less often than that of the plate.
    """
    if ambient is None:
        return None
    values = _numbers(in_unit("ambient", ambient, "degC", RecordingError), "ambient", may_lack=True)
    if values.shape not in ((), time.shape):
        raise RecordingError(
            f"ambient: expected one number or shape ({time.size},), got shape {values.shape}"
        )
    there = ~np.isnan(values)
    if not there.any():
        raise RecordingError(
            "ambient: expected temperatures, got nan at all times; pass None if it is not known"
        )
    if not there.all():
        values = _held(np.interp(time, time[there], values[there]))
    _check_temperature(np.broadcast_to(values, time.shape), "ambient", time)
    if values.max() > HOTTEST_ROOM:
        raise RecordingError(
            f"ambient: expected the temperature of a room in degC, at most {HOTTEST_ROOM:g}, got "
            f"{values.max():g}; in K, that is {values.max() - ZERO_CELSIUS:g} degC"
        )
    if values.min() < COLDEST_ROOM:
        raise RecordingError(
            f"ambient: expected the temperature of a room, at least {COLDEST_ROOM:g} degC, got "
            f"{values.min():.10g} degC; is it {values.min() + ZERO_CELSIUS:.10g} degC, called K?"
        )
    if np.all(values == values.flat[0]):
        return float(values.flat[0])
    return values


def checked_inputs(
    inputs: Mapping[str, ArrayLike | float | int] | None, time: Float[np.ndarray, "times"]
) -> dict[str, Shaped[np.ndarray, "times"]]:
    """The inputs besides the duty: numbers, or names of states, at each time."""
    given = {} if inputs is None else inputs
    mapping_of("inputs", given, "name -> values", RecordingError)
    return {name: _checked_input(name, values, time) for name, values in sorted(given.items())}


def _checked_input(
    name: object, values: ArrayLike | float | int, time: Float[np.ndarray, "times"]
) -> Shaped[np.ndarray, "times"]:
    if not isinstance(name, str) or not name.isidentifier():
        raise RecordingError(f"inputs: expected names of letters, digits and _, got {name!r}")
    array = np.asarray(values)
    if array.dtype == object and all(isinstance(value, str) for value in array.flat):
        array = array.astype(str)
    if array.dtype.kind == "b":
        array = array.astype(float)
    if array.dtype.kind != "U":
        array = _numbers(array, f"input {name}")
    if array.shape not in ((), time.shape):
        raise RecordingError(
            f"input {name}: expected one value or shape ({time.size},), got shape {array.shape}"
        )
    array = np.array(np.broadcast_to(array, time.shape))
    if array.dtype.kind == "U":
        array = array.astype(f"U{max(1, *(len(text) for text in set(array.tolist())))}")
    else:
        _check_finite(array, f"input {name}", time)
    array.setflags(write=False)
    return array


def _numbers(values: object, field: str, may_lack: bool = False) -> np.ndarray:
    """Converts a field to real numbers. Values that are masked, None or NA become NaN if the field
    `may_lack` some."""
    # Nothing is traced before JAX is imported, which reading a file does not need.
    if "jax" in sys.modules and isinstance(values, sys.modules["jax"].core.Tracer):
        raise RecordingError(
            f"{field}: expected numbers, got values that JAX traces; jaxtwin.Stepper can be "
            "differentiated by duty and room"
        )
    if np.ma.is_masked(values):  # a conversion would lose the mask
        if not may_lack:
            raise RecordingError(f"{field}: expected finite numbers, got masked values")
        values = np.ma.filled(np.ma.asarray(values, np.float64), np.nan)
    try:
        array = np.asarray(values)
    except ValueError:  # rows of different lengths
        raise RecordingError(
            f"{field}: expected an array of numbers, got rows of different lengths"
        ) from None
    if array.dtype == object:
        array = _without_none(array)
    if array.size and array.dtype.kind not in "iuf":
        raise RecordingError(f"{field}: expected real numbers, got {array.dtype.name} values")
    return _held(array)


def _without_none(objects: np.ndarray) -> np.ndarray:
    """Replaces None and pandas' NA among numbers by NaN. Anything else is returned unchanged.

    Lists with None, and columns of pandas that support NA, are arrays of objects.
    """
    pandas = sys.modules.get("pandas")
    missing = (None,) if pandas is None else (None, pandas.NA)
    plain = [float("nan") if any(x is marker for marker in missing) else x for x in objects.flat]
    if not all(isinstance(x, Real) and not isinstance(x, bool | np.bool_) for x in plain):
        return objects
    return np.array(plain, np.float64).reshape(objects.shape)


def _held(array: np.ndarray) -> np.ndarray:
    """Returns a read-only copy, so that an experiment and its fingerprint never change."""
    copy = np.array(array, np.float64, order="C")
    copy[np.isnan(copy)] = np.nan  # one of the many bit patterns that mean it
    copy.setflags(write=False)
    return copy


def _check_finite(values: np.ndarray, field: str, time: np.ndarray) -> None:
    (wrong,) = np.nonzero(~np.isfinite(values))
    if wrong.size:
        k = wrong[0]
        raise WrongSampleError(
            f"{field}: expected finite numbers, got {values[k]} at {_sample(k, time)}", int(k)
        )


def _check_temperature(values: np.ndarray, field: str, time: np.ndarray) -> None:
    """Checks that temperatures are finite and those of a rig, or NaN."""
    _check_finite(np.nan_to_num(values, nan=0.0, posinf=np.inf, neginf=-np.inf), field, time)
    (wrong,) = np.nonzero((values < ABSOLUTE_ZERO) | (values > MAX_READING_DEGC))
    if wrong.size:
        k = wrong[0]
        code = "; an instrument's code for no reading is a missing sample, NaN"
        raise WrongSampleError(
            f"{field}: expected {ABSOLUTE_ZERO} to {MAX_READING_DEGC:g} degC, got "
            f"{values[k]:.10g} degC at "
            f"{_sample(k, time)}{code if values[k] > MAX_READING_DEGC else ''}",
            int(k),
        )


def _sample(k: int | np.integer, time: np.ndarray) -> str:
    return f"sample {k} (counted from 0, t = {time[k]:.10g} s)"
