"""Numbers and intervals as tables and pictures show them."""

import math

# Numbers below this are written out, without a power of ten.
LARGE = 1e6


def interval_text(interval: tuple[float, float]) -> str:
    """An interval for tables, with enough digits to distinguish its ends.

    The text is `unknown` for an undetermined value, and `-` if there is no interval.
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
