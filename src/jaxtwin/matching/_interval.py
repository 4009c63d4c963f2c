"""The 95 % interval of a matched value, in the scale in which it was matched."""

import math

QUANTILE = 1.959963984540054
"""Of the standard normal distribution at 0.975."""


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
