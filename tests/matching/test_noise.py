"""What residuals are like: against processes whose statistics are known."""

import numpy as np
import pytest

from jaxtwin.matching._camera_error import camera_shapes, detect_events
from jaxtwin.matching._noise_model import estimate_noise
from jaxtwin.rig import CommonError

ERROR = CommonError(
    offset=0.1, drift=0.2, drift_time=100.0, jump=0.5, relaxation=(10.0, 40.0), detect=True
)


def test_independent_residuals_count_one_by_one():
    noise = estimate_noise([np.random.default_rng(0).normal(0, 0.3, (5000, 4))])
    assert noise.standard_deviation == pytest.approx(0.3, rel=0.02)
    assert noise.autocorrelation_time == pytest.approx(1.0, abs=0.1)


def test_a_first_order_process_counts_as_its_theory_says():
    # The sum of autocorrelations of x_k = a x_{k-1} + e_k is (1 + a) / (1 - a).
    rng, a = np.random.default_rng(1), 0.8
    steps = rng.normal(size=(20000, 3))
    series = np.zeros_like(steps)
    for k in range(1, len(steps)):
        series[k] = a * series[k - 1] + steps[k]
    noise = estimate_noise([series])
    assert noise.standard_deviation == pytest.approx(1 / np.sqrt(1 - a**2), rel=0.05)
    assert noise.autocorrelation_time == pytest.approx((1 + a) / (1 - a), rel=0.15)


def test_corrections_are_found_and_steps_of_the_plate_are_not():
    rng, time = np.random.default_rng(3), np.arange(1000.0)
    common = 0.08 * rng.standard_normal(1000) + 0.3 * np.sin(time / 150)
    common += np.where(time > 500, 2 * (1 - np.exp(-np.maximum(time - 500, 0) / 60)), 0)
    for event, jump in ((170, 0.8), (330, 1.0), (620, -0.7)):
        common += np.where(time >= event, jump * np.exp(-np.maximum(time - event, 0) / 30), 0)
    found = detect_events(time, common, np.ones(len(time), bool))
    assert len(found) == 3
    np.testing.assert_allclose(found, [170, 330, 620], atol=2)


def test_faint_corrections_are_found_where_clear_ones_come_at_equal_intervals():
    # As the two-cell rig's camera does, every 163.4 s; two of six jumps are hardly above the noise.
    rng, time = np.random.default_rng(4), np.arange(950.0)
    common = 0.08 * rng.standard_normal(950) + 0.2 * np.sin(time / 150)
    events = 14 + 163.4 * np.arange(6)
    for event, jump in zip(events, (2.0, 0.3, 1.0, 1.0, 0.3, 1.2), strict=True):
        common += np.where(time >= event, jump * np.exp(-np.maximum(time - event, 0) / 30), 0)
    found = detect_events(time, common, np.ones(len(time), bool))
    assert len(found) == 6
    np.testing.assert_allclose(found, events, atol=6)


def test_corrections_beside_short_holes_are_found_and_long_holes_give_none():
    """A camera is often not read behind its shutter; what lies in a hole lies between its edges."""
    rng, time = np.random.default_rng(3), np.arange(1000.0)
    common = 0.08 * rng.standard_normal(1000)
    for event in (170, 330):
        common += np.where(time >= event, np.exp(-np.maximum(time - event, 0) / 30), 0)
    counted = ~(((time >= 168) & (time < 171)) | ((time > 400) & (time < 960)))
    between = np.interp(time, time[counted], common[counted])
    found = detect_events(time, between, counted)
    np.testing.assert_allclose(found, [170, 330], atol=2)
    assert detect_events(time, between, np.zeros(1000, bool)) == ()


def test_no_correction_is_found_in_noise():
    time = np.arange(1000.0)
    count = sum(
        len(detect_events(time, rng.standard_normal(1000), np.ones(1000, bool)))
        for rng in map(np.random.default_rng, range(20))
    )
    assert count <= 10


def test_shapes_begin_at_their_correction_and_fade():
    time = np.arange(300.0)
    shapes, spreads = camera_shapes(ERROR, time, (100.0,), 64)
    none, _ = camera_shapes(ERROR, time, (), 64)
    used = np.flatnonzero(np.abs(shapes - none).max(axis=0) > 0)
    assert len(used) == 2
    for column, value in zip(shapes[:, used].T, (np.exp(-5.0), np.exp(-1.25)), strict=True):
        assert np.all(column[:100] == 0)
        assert column[100] == 1.0
        assert column[150] == pytest.approx(value)
    assert set(spreads[used]) == {0.5}
