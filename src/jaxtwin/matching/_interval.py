"""The 95 % interval of a matched value, in the scale in which it was matched."""

import math

QUANTILE = 1.959963984540054
"""Of the standard normal distribution at 0.975."""

LARGE = 1e6
"""Numbers below this are written out."""


def interval_95(value: float, error: float, *, is_logarithmic: bool) -> tuple[float, float]:
    r"""Where a value lies with 95 % probability, in its own unit.

    A positive parameter is matched by its logarithm, in which the likelihood is nearly normal: its
    interval is $v e^{\pm 1.96 s}$, which is above 0 however large the error is. That of any other
    is $v \pm 1.96 s$. Bounds do not cut it: what lies beyond them says that they were felt.

    **Arguments:**

    - `value`: the matched value.
    - `error`: its standard error, of the logarithm where it was matched by it; infinite where
      nothing tells the value, NaN where there is none.

    **Returns:** lower and upper end, both NaN where there is no error.
    """
    if math.isnan(error):
        return math.nan, math.nan
    reach = QUANTILE * error
    if not is_logarithmic:
        return value - reach, value + reach
    try:
        return value * math.exp(-reach), value * math.exp(reach)
    except OverflowError:
        return 0.0, math.inf


def interval_text(interval: tuple[float, float]) -> str:
    """An interval for tables, with as many digits as tell its ends apart.

    `unknown` where nothing tells the value, `-` where there is no interval.
    """
    low, high = interval
    if math.isnan(low) or math.isnan(high):
        return "-"
    if math.isinf(high):
        return "unknown"
    largest, width = max(abs(low), abs(high)), high - low
    digits = 2 + (round(math.log10(largest / width)) if 0 < width < largest else 0)
    return f"{short_number(low, digits)} to {short_number(high, digits)}"


def short_number(value: float, digits: int = 4) -> str:
    """A number for tables, with this many significant digits: `0.84`, `140`, `1.6e-5`, `2e6`."""
    text = f"{value:.{digits}g}"
    if "e+" in text and abs(value) < LARGE:
        return f"{float(text):.0f}"
    return text.replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")
