"""Limits of schedules that are compared: the last value that is allowed, and the next one."""

import math
from functools import partial

import pytest
from limits import Limit, check_limit

from jaxtwin import Twin
from jaxtwin.experiment_design._schedules import make_schedules
from jaxtwin.experiment_design._search import Hottest

DESIGN = partial(make_schedules, Twin("single-cell"), levels=3, interval=1.0)


def design(duration: float, hold: float, bounds: tuple[float, float] = (-1.0, 1.0)) -> object:
    return DESIGN(duration=duration, hold=hold, bounds=bounds)


LIMITS: list[Limit] = [
    (design, {"duration": 60, "hold": 60}, {"duration": 60, "hold": 61}),
    (design, {"duration": 60, "hold": 1}, {"duration": 60, "hold": 0}),
    (design, {"duration": 3600, "hold": 60}, {"duration": 3660, "hold": 60}),
    (
        design,
        {"duration": 60, "hold": 60, "bounds": (-1.0, 1.0)},
        {"duration": 60, "hold": 60, "bounds": (-1.001, 1.0)},
    ),
    (
        design,
        {"duration": 60, "hold": 60, "bounds": (0.0, 1.0)},
        {"duration": 60, "hold": 60, "bounds": (0.0, 1.001)},
    ),
]


@pytest.mark.parametrize(("make", "allowed", "refused"), LIMITS)
def test_the_limit_is_allowed_and_what_is_beyond_is_refused(make, allowed, refused):
    check_limit(make, allowed, refused)


def test_only_cells_have_a_side_that_may_not_be_hotter_than_solder():
    assert Hottest.of(Twin("single-cell"), 5.0).side == pytest.approx(133.0)
    assert Hottest.of(Twin("tclab"), 5.0).side == math.inf
