"""Limits of controllers and loops: the last value that is allowed, and the next one."""

from functools import partial

import numpy as np
import pytest
from limits import Limit, check_limit

from jaxtwin import Twin
from jaxtwin.control import PID, StateSpace
from jaxtwin.control.controllers._controller import check_non_negative, checked_deviations
from jaxtwin.control.loops._disturbances import Draught, HeatInput, disturbance_tables

FIRST_ORDER = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])


def pid(**arguments: object) -> PID:
    return PID(0.1, **arguments)  # pyright: ignore[reportArgumentType]


def heated(start: float, end: float, film: float | None = None) -> object:
    elements = ("V11",)
    disturbance = (
        HeatInput(elements, start, end, 1.0)
        if film is None
        else Draught(elements, start, end, film)
    )
    return disturbance_tables("loop", Twin("paper-2024"), [disturbance], np.arange(3.0))


LIMITS: list[Limit] = [
    (pid, {"limits": (-1.0, 1.0)}, {"limits": (-1.001, 1.0)}),
    (pid, {"limits": (0.0, 1.0)}, {"limits": (0.0, 1.001)}),
    (pid, {"limits": (0.499, 0.5)}, {"limits": (0.5, 0.5)}),
    (pid, {"sample_time_s": 1e-3}, {"sample_time_s": 0.0}),
    (partial(check_non_negative, "c"), {"Ki": 0.0}, {"Ki": -1e-9}),
    (partial(checked_deviations, "c", "d", size=1), {"value": 1e-9}, {"value": 0.0}),
    (heated, {"start": 1.0, "end": 1.001}, {"start": 1.0, "end": 1.0}),
    (heated, {"start": 0.0, "end": 1.0, "film": 0.0}, {"start": 0.0, "end": 1.0, "film": -1e-3}),
    (FIRST_ORDER.discretise, {"sample_time_s": 1e-3}, {"sample_time_s": 0.0}),
]


@pytest.mark.parametrize(("make", "allowed", "refused"), LIMITS)
def test_the_limit_is_allowed_and_what_is_beyond_is_refused(make, allowed, refused):
    check_limit(make, allowed, refused)
