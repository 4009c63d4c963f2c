"""Range and deviation over places, against numbers worked out by hand."""

import numpy as np
import pytest

from jaxtwin import Experiment
from jaxtwin.errors import SimulationError
from jaxtwin.simulation import Run, uniformity


def run(recorded: bool = True) -> Run:
    time = np.arange(3.0)
    seen = np.array([[20.0, 20.0], [24.0, 20.0], [21.0, 27.0]])
    experiment = Experiment(
        time,
        np.zeros((3, 1)),
        channels=("T1", "T2"),
        temperatures=seen + np.array([1.0, 0.0]) if recorded else None,
    )
    states = np.array([[20.0, 22.0, 26.0, 90.0, 10.0, 35.0]] * 3)
    nodes = ("V11", "V12", "V13", "P1.TC", "P1.SINK", "block")
    return Run(experiment, ("T1", "T2"), seen, nodes, states, "rig", elements=3)


def test_range_and_standard_deviation_over_the_channels():
    even = run().uniformity
    np.testing.assert_array_equal(even.range, [0.0, 4.0, 6.0])
    np.testing.assert_array_equal(even.std, [0.0, 2.0, 3.0])
    assert (even.mean_range, even.largest_range) == (pytest.approx(10 / 3), 6.0)
    assert even.mean_std == pytest.approx(5 / 3)


def test_a_time_with_a_missing_sample_has_no_uniformity_and_counts_nothing():
    """Two places of three are another quantity."""
    seen = np.array([[20.0, 20.0, 20.0], [24.0, np.nan, 20.0], [21.0, 27.0, 24.0]])
    even = uniformity(np.arange(3.0), seen, ("a", "b", "c"))
    np.testing.assert_array_equal(even.range, [0.0, np.nan, 6.0])
    assert (even.mean_range, even.largest_range) == (3.0, 6.0)
    none = uniformity(np.arange(3.0), np.full((3, 2), np.nan), ("a", "b"))
    assert np.isnan([none.mean_range, none.mean_std, none.largest_range]).all()


def test_recorded_stands_beside_simulated():
    np.testing.assert_array_equal(run().recorded_uniformity.range, [1.0, 5.0, 5.0])
    labelled = run().to_xarray()
    np.testing.assert_array_equal(labelled["channel_range"], [0.0, 4.0, 6.0])
    np.testing.assert_array_equal(labelled["recorded_range"], [1.0, 5.0, 5.0])
    np.testing.assert_array_equal(labelled["plate_range"], [6.0] * 3)
    assert labelled["channel_std"].attrs["units"] == "K"


def test_the_plate_is_its_elements_without_cells_sinks_and_bodies():
    even = run().plate_uniformity
    assert even.places == ("V11", "V12", "V13")
    np.testing.assert_array_equal(even.range, [6.0] * 3)


def test_without_a_recording_there_is_nothing_beside():
    with pytest.raises(SimulationError, match="expected recorded temperatures"):
        run(recorded=False).recorded_uniformity  # noqa: B018
    assert "recorded_range" not in run(recorded=False).to_xarray()


def test_a_common_change_of_all_places_does_not_count():
    temperatures = np.random.default_rng(0).standard_normal((5, 4))
    still = uniformity(np.arange(5.0), temperatures, ("a", "b", "c", "d"))
    rising = uniformity(np.arange(5.0), temperatures + np.arange(5.0)[:, None], still.places)
    np.testing.assert_allclose(rising.range, still.range)
    np.testing.assert_allclose(rising.std, still.std)
