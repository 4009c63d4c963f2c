"""Limits of initial temperatures: the last value that is allowed, and the next one."""

from functools import partial

import pytest
from limits import Limit, check_limit

from jaxtwin import Twin
from jaxtwin.simulation._initial import checked_initial

LIMITS: list[Limit] = [
    (partial(checked_initial, Twin("single-cell")), {"initial": -273.15}, {"initial": -273.151}),
]


@pytest.mark.parametrize(("make", "allowed", "refused"), LIMITS)
def test_the_limit_is_allowed_and_what_is_beyond_is_refused(make, allowed, refused):
    check_limit(make, allowed, refused)
