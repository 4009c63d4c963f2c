"""The last value that is allowed is taken, and the next one is refused.

The limits are those that docstrings, error messages and docs/protocol.md state.
"""

import math
from functools import partial

import numpy as np
import pytest
from limits import Limit, check_limit

from jaxtwin import Experiment, JaxtwinError, plots
from jaxtwin._statistics import ljung_box
from jaxtwin.physics import ThermoelectricModule

TWO_SAMPLES = Experiment(np.array([0.0, 1.0, 2.0]), np.zeros((3, 1)))
PELTIER = partial(
    ThermoelectricModule.from_datasheet,
    maximum_voltage=15.0,
    maximum_current=6.0,
    hot_side_temperature=300.0,
)


def schedule(text: str = "0:0.5", **arguments: float) -> Experiment:
    return Experiment.schedule(text, **({"duration": 10.0} | arguments))  # pyright: ignore[reportArgumentType]


LIMITS: list[Limit] = [
    (schedule, {"duration": 1e-3, "step": 1e-3}, {"duration": 0.0}),
    (schedule, {"step": 10.0}, {"step": 10.001}),
    (schedule, {"step": 1e-3}, {"step": 0.0}),
    (schedule, {"cells": 1000, "duration": 1.0}, {"cells": 1001, "duration": 1.0}),
    (schedule, {"step": 1e-4}, {"step": 0.99e-6}),
    (schedule, {"text": "0:0.5,9.999:0.6"}, {"text": "0:0.5,10:0.6"}),
    (schedule, {"text": "0:0.5"}, {"text": "-0.001:0.5"}),
    (schedule, {"text": "0:0.5,1e-3:0.6"}, {"text": "0:0.5,0:0.6"}),
    (schedule, {"text": "0:1,5:-1"}, {"text": "0:1.001"}),
    (schedule, {"text": "0:-1"}, {"text": "0:-1.001"}),
    (TWO_SAMPLES.between, {"t0": 0.0, "t1": 1.001}, {"t0": 0.0, "t1": 1.0}),
    (TWO_SAMPLES.between, {"t0": 1.0, "t1": 3.0}, {"t0": 1.001, "t1": 3.0}),
    (PELTIER, {"maximum_temperature_difference": 299.9}, {"maximum_temperature_difference": 300.0}),
    (PELTIER, {"maximum_temperature_difference": 1e-3}, {"maximum_temperature_difference": 0.0}),
]


@pytest.mark.parametrize(("make", "allowed", "refused"), LIMITS)
def test_the_limit_is_allowed_and_what_is_beyond_is_refused(make, allowed, refused):
    check_limit(make, allowed, refused)


def test_ten_residuals_are_enough_for_a_test_of_whiteness():
    residuals = np.array([0.3, -0.1, 0.2, 0.5, -0.7, 0.1, 0.4, -0.2, -0.6, 0.2, math.nan])
    assert ljung_box(residuals).lags == 2  # a fifth of the samples
    with pytest.raises(ValueError, match="at least 10 samples, got 9"):
        ljung_box(residuals[1:])


def test_a_figure_is_an_inch_wide_at_least():
    with plots.style("paper", width=1.0):
        pass
    with (
        pytest.raises(JaxtwinError, match="at least 1, in inches"),
        plots.style("paper", width=0.999),
    ):
        pass
