"""Limits of draws and distributions: the last value that is allowed, and the next one."""

import pytest
from limits import Limit, check_limit

from jaxtwin.sensitivity_analysis import Morris, Normal, Uniform
from jaxtwin.sensitivity_analysis._sampling import checked_seed, checked_spread

LIMITS: list[Limit] = [
    (checked_seed, {"where": "seed", "seed": 2**128 - 1}, {"where": "seed", "seed": 2**128}),
    (checked_seed, {"where": "seed", "seed": 0}, {"where": "seed", "seed": -1}),
    (checked_spread, {"where": "spread", "spread": 0.999}, {"where": "spread", "spread": 1.0}),
    (checked_spread, {"where": "spread", "spread": 1e-3}, {"where": "spread", "spread": 0.0}),
    (Uniform, {"low": 1.0, "high": 1.001}, {"low": 1.0, "high": 1.0}),
    (Normal, {"mean": 0.0, "std": 1e-3}, {"mean": 0.0, "std": 0.0}),
    (Morris, {"levels": 2}, {"levels": 0}),
]


@pytest.mark.parametrize(("make", "allowed", "refused"), LIMITS)
def test_the_limit_is_allowed_and_what_is_beyond_is_refused(make, allowed, refused):
    check_limit(make, allowed, refused)
