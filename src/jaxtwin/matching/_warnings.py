"""What a reader should know about a matched parameter before believing it."""

import math
from typing import TYPE_CHECKING

from ._uncertainty import Uncertainty

if TYPE_CHECKING:
    from ._fit import FittedParameter

NEAR = 0.01
"""Of the range between the bounds (of their logarithms): this near to one counts as at it."""

FAR = 2.0
"""Standard deviations from the prior that are worth a word."""


def parameter_warnings(row: "FittedParameter", known: Uncertainty) -> tuple[str, ...]:
    """Short remarks on one parameter; none where all is well."""
    if not row.free:
        return ()
    labels = [one for one in known.labels if one == row.name or one.startswith(f"{row.name}[")]
    remarks = []
    if row.at_bound:
        remarks.append("at bound")
    elif near_bound(row):
        remarks.append("near bound")
    if row.prior_distance is not None and abs(row.prior_distance) > FAR:
        remarks.append(f"{row.prior_distance:+.1f} sd from prior")
    if any(label in known.insensitive for label in labels):
        remarks.append("no effect")
    elif row.prior_to_data_ratio < 1:
        remarks.append("not determined" if row.prior_spread is None else "prior only")
    elif math.isinf(row.standard_error):
        remarks.append("not determined")
    if any(label in pair[:2] for pair in known.collinear for label in labels):
        remarks.append("correlated")
    return tuple(remarks)


def near_bound(row: "FittedParameter") -> bool:
    """Whether a value lies within 1 % of the range from a bound, as the match measures it."""
    lower, value, upper = row.lower, row.value, row.upper
    if row.is_logarithmic:
        lower, value, upper = math.log(lower), math.log(value), math.log(upper)
    if not (math.isfinite(lower) and math.isfinite(upper)):
        return False
    return min(value - lower, upper - value) < NEAR * (upper - lower)
