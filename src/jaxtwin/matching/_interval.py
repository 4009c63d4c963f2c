"""The 95 % interval of a matched value, on the scale of the match."""

import math

QUANTILE = 1.959963984540054
"""The 0.975 quantile of the standard normal distribution."""


def interval_95(value: float, error: float, *, is_logarithmic: bool) -> tuple[float, float]:
    r"""Computes the 95 % interval of a value, in its own unit.

    A positive parameter is matched by its logarithm, in which the likelihood is nearly normal. Its
    interval is $v e^{\pm 1.96 s}$, which is positive for any error. The interval of any other
    parameter is $v \pm 1.96 s$. Bounds do not cut the interval.

    **Arguments:**

    - `value`: the matched value.
    - `error`: its standard error, of the logarithm if it was matched by it; infinite for an
      undetermined value, NaN if there is none.

    **Returns:** lower and upper end, both NaN if there is no error.
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
