"""Measures of loops whose answers are known beforehand."""

from dataclasses import replace

import numpy as np
import pytest

from jaxtwin.control import MEASURES, ClosedLoop


def loop(output: np.ndarray, reference: np.ndarray, duty: np.ndarray) -> ClosedLoop:
    times = len(output)
    nodes = np.stack([output, output + PLATE_RANGE, np.full(times, 50.0)], axis=1)
    return ClosedLoop(
        time=np.arange(times, dtype=float),
        reference=reference[:, None],
        output=output[:, None],
        measurement=output[:, None],
        temperatures=output[:, None],
        nodes=nodes,
        duty=duty[:, None],
        power=10 * duty[:, None],
        energy=10 * np.r_[0.0, np.cumsum(duty[:-1])],
        peak_power=np.array(11.0),
        limits=(-1.0, 1.0),
        elements=2,
        sides=(2,),
    )


OUTPUT = np.array([20, 20, 25, 29, 32, 31, 30.2, 29.9, 30, 30, 30])
PLATE_RANGE = np.array([0, 1, 2, 3, 6, 5, 4, 3, 3, 2, 1.5])
REFERENCE = np.array([20.0] + [30.0] * 10)
DUTY = np.array([0, 1, 1, 0.5, 0, 0.25, 0.5, 0.5, 0.5, 0.5, 0.5])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("settling_time", 5.0),
        ("overshoot", 2.0),
        ("integral_absolute_error", 10 + 5 + 1 + 2 + 1 + 0.2 + 0.1),
        ("integral_squared_error", 100 + 25 + 1 + 4 + 1 + 0.04 + 0.01),
        ("integral_time_absolute_error", 0 + 5 + 2 + 6 + 4 + 5 * 0.2 + 6 * 0.1),
        ("plate_range_at_rest", (2 + 1.5) / 2),
        ("largest_plate_range", 6.0),
        ("energy", 10 * DUTY[:-1].sum()),
        ("peak_power", 11.0),
        ("hottest_cell_side", 50.0),
        ("saturation_share", 0.2),
        ("total_variation", 1 + 0.5 + 0.5 + 0.25 + 0.25),
    ],
)
def test_a_measure_is_its_definition(name: str, expected: float, float64: None):
    found = MEASURES[name][0](loop(OUTPUT, REFERENCE, DUTY))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_the_settling_time_is_infinite_if_an_output_never_settles(float64: None):
    settling = MEASURES["settling_time"][0]
    assert settling(loop(OUTPUT, REFERENCE + 5, DUTY)) == np.inf
    assert settling(loop(REFERENCE, REFERENCE, DUTY)) == 0


def test_the_settling_time_of_a_change_within_the_band_is_0(float64: None):
    """The output was outside of the band at 5 s; the reference moves by 0.2 K at 10 s."""
    moved = np.append(REFERENCE[:-1], REFERENCE[-1] + 0.2)
    assert MEASURES["settling_time"][0](loop(OUTPUT, moved, DUTY)) == 0


def test_the_overshoot_counts_in_the_direction_of_the_change(float64: None):
    found = MEASURES["overshoot"][0](loop(-OUTPUT, -REFERENCE, DUTY))
    np.testing.assert_allclose(found, 2.0)


@pytest.mark.parametrize(
    ("limits", "share"), [((-1.0, 1.0), 0.2), ((-0.5, 0.5), 0.7), ((0.0, 1.0), 0.4)]
)
def test_a_loop_saturates_at_the_limits_of_its_controller(limits, share):
    """Of ten seconds, two are at full duty, seven at 0.5 and more, and two at 0."""
    made = loop(OUTPUT, REFERENCE, np.clip(DUTY, *limits))
    made = replace(made, limits=limits)
    measure, _ = MEASURES["saturation_share"]
    assert measure(made) == pytest.approx(share)
