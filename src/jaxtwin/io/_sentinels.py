"""What sensors and loggers write in place of a reading: words, and numbers that no sensor means.

- Instruments write 9.9e37 (overload, SCPI) or -1e38: no number that large is a temperature.
- A DS18B20 gives -127 when it is not connected and 85 after it has been switched on, and other
  drivers -999 or -9999. These may be temperatures, and are taken for codes only where the readings
  on both sides are elsewhere.
"""

import numpy as np
from jaxtyping import Bool, Float

# The words for a missing sample, in small letters.
BLANK_WORDS = frozenset(
    {"", "nan", "-nan", "na", "n/a", "#n/a", "<na>", "null", "none", "-", "--", "---"}
)

# The words for a reading that failed, in small letters; they are missing, and are counted.
FAULT_WORDS = frozenset(
    [
        *("unavailable", "unknown", "undefined", "disconnected", "invalid", "bad", "open"),
        *("err", "error", "fault", "faulty", "ol", "+ol", "-ol", "o.l.", "ovld", "+ovld", "-ovld"),
        *("over", "under", "overload", "overrange", "underrange", "overflow"),
        *("#value!", "#ref!", "#div/0!", "#num!", "#null!"),
    ]
)

_MISSING = BLANK_WORDS | FAULT_WORDS

# The size from which on a number is a code, whatever its unit.
OVERLOAD = 1e30

# Temperatures that are codes where the readings around are elsewhere, degC.
CODES = (-127.0, 85.0, -999.0, -999.9, -9999.0, -32768.0)

# How far the readings around a code are from it at least, K.
MIN_DISTANCE_KELVIN = 15.0


def is_missing(field: str) -> bool:
    """Whether a text stands for a missing sample."""
    return field.lower() in _MISSING


def fault_codes(
    values: Float[np.ndarray, " samples"],
) -> Bool[np.ndarray, " samples"]:
    """The samples of a channel that are codes, not temperatures, degC."""
    with np.errstate(invalid="ignore"):
        codes = np.abs(values) >= OVERLOAD
        for code in CODES:
            is_code = np.isclose(values, code, rtol=0.0, atol=1e-6)
            if not is_code.any():
                continue
            others = np.where(is_code | codes | np.isnan(values), np.nan, values)
            codes |= is_code & _is_apart(others, code)
    return codes


def _is_apart(others: Float[np.ndarray, " samples"], code: float) -> Bool[np.ndarray, " samples"]:
    """Whether the nearest readings on both sides are far from a code, and are nearer to each other
    than to it, as they are not where a temperature passes through it. At an end the two nearest
    readings are compared."""
    (there,) = np.nonzero(~np.isnan(others))
    if not there.size:
        return np.full(others.shape, code < 0)  # a sensor that was never connected
    places = np.arange(others.size)
    before = np.searchsorted(there, places) - 1
    after = np.minimum(before + 1, there.size - 1)
    left = others[there[np.where(before < 0, np.minimum(1, there.size - 1), before)]]
    right = others[there[after]]
    last = before + 1 >= there.size
    right = np.where(last, others[there[max(there.size - 2, 0)]], right)
    nearest = np.minimum(np.abs(left - code), np.abs(right - code))
    return (nearest > MIN_DISTANCE_KELVIN) & (np.abs(left - right) < nearest)
