"""The frontier between two aims: each point is a tuning, and the trade goes the right way."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin import Twin
from jaxtwin.control import PID, Frontier, frontier
from jaxtwin.errors import ControlError
from jaxtwin.plots import plot_frontier

START = PID(Kp=0.03, Ki=0.0004, limits=(0, 1))
SETTINGS: dict[str, Any] = {
    "duration": 150,
    "draws": {"R_E": [1.8, 2.1]},
    "sensitivity_limit": 1.6,
    "noise": False,
}


@pytest.fixture(scope="module")
def found(twin: Twin) -> Frontier:
    return frontier(START, twin, 24, weights=[100, 0, 20], rounds=5, **SETTINGS)


@pytest.mark.long
def test_more_weight_gives_a_more_even_plate_that_is_slower(found: Frontier):
    assert found.weights.tolist() == [0, 20, 100]
    plate_range = np.median(found.measure("largest_plate_range"), axis=1)
    error = np.median(found.measure("integral_absolute_error"), axis=1)
    assert np.all(np.diff(plate_range) < 0)
    assert np.all(np.diff(error) > 0)
    assert max(tuning.after.sensitivity_peak for tuning in found.tunings) <= 1.6 * (1 + 1e-3)
    table = found.to_dataframe()
    assert table.loc[20.0, "largest_plate_range"] == pytest.approx(plate_range[1])
    assert table.loc[20.0, "Kp"] == found.tunings[1].after.values[0]
    data = found.to_xarray()
    assert data["energy"].shape == (3, 2)
    assert data["energy"].attrs["units"] == "J"
    with pytest.raises(ControlError, match="unknown measure 'speed'"):
        found.measure("speed")


@pytest.mark.slow
def test_the_first_point_is_a_tuning_for_the_objective_alone(twin: Twin, found: Frontier):
    alone = jt.tune(START, twin, 24, starts=1, rounds=5, **SETTINGS)
    np.testing.assert_allclose(found.tunings[0].after.values, alone.after.values, rtol=1e-6)
    # The next search starts where this one ended.
    assert found.tunings[1].start is found.tunings[0].controller


@pytest.mark.slow
def test_dominated_points_of_a_frontier_are_drawn_hollow(found: Frontier):
    figure = plot_frontier(found, "largest_plate_range", ["integral_absolute_error", "energy"])
    trade, _ = figure.axes
    dots = [line for line in trade.lines if line.get_marker() == "o"]
    assert [dot.get_markerfacecolor() for dot in dots] == ["#0072b2"] * 3
    assert {text.get_text() for text in trade.texts} == {"0", "20", "100"}
    # Beside itself a measure has a single best value.
    (same,) = plot_frontier(found, "energy", ["energy"]).axes
    dots = [line for line in same.lines if line.get_marker() == "o"]
    assert sorted(str(dot.get_markerfacecolor()) for dot in dots) == ["#0072b2", "none", "none"]
    plt.close("all")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"against": "settling_time"}, "against: expected one of overshoot"),
        ({"against": "speed"}, "against: expected one of overshoot"),
        ({"weights": []}, r"weights: expected numbers of at least 0, got \[\]"),
        ({"weights": [-1.0, 2.0]}, "weights: expected numbers of at least 0"),
        ({"objective": "speed"}, "unknown measure 'speed'"),
        ({"rounds": 0}, "rounds: expected a whole number"),
    ],
)
def test_invalid_arguments_of_frontier_are_refused(
    twin: Twin, settings: dict[str, Any], message: str
):
    given: dict[str, Any] = {"duration": 150, "weights": [0, 1]} | settings
    with pytest.raises(ControlError, match=message):
        frontier(START, twin, 24, **given)
