"""Spans without a reading, against frames that are counted one by one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin import Twin, simulate_closed_loop, simulate_closed_loops
from jaxtwin.control import PID, scenario
from jaxtwin.control.loops._scenario import is_within, longest_silence, periodic_spans

PERIOD = 0.125
SPAN = st.tuples(st.integers(1, 480), st.integers(0, 200)).map(lambda s: (s[0], s[0] + s[1]))


@given(st.lists(SPAN, max_size=6), st.sampled_from([8, 16, 40]))
def test_the_longest_silence_is_that_of_frames_one_by_one(spans: list, interval: int):
    """Times are multiples of the time between two frames; every frame outside of the spans arrives,
    the first at 0."""
    times = np.arange(0, 481, interval)
    frames = np.arange(481)
    arrives = ~np.any([(frames >= a) & (frames < b) for a, b in spans] or [frames < 0], axis=0)
    table = np.reshape(np.array(spans, float), (-1, 2)) * PERIOD
    moments = frames * PERIOD
    np.testing.assert_array_equal(is_within(moments, table), ~arrives)
    expected = []
    for time in times:
        last, longest = 0, 0
        for frame in range(1, time + 1):
            if frame > time - interval:
                longest = max(longest, frame - last)
            last = frame if arrives[frame] else last
        expected.append(longest)
    found = longest_silence(times * PERIOD, table, PERIOD)
    # A silence of one period is none.
    np.testing.assert_allclose(np.maximum(found / PERIOD, 1), np.maximum(expected, 1))


@pytest.mark.slow
def test_a_stall_shorter_than_the_silence_leaves_a_slow_controller_on():
    """Of ten minutes, with a sample each 5 s: one second without readings, at a sample or between
    two, is as short for it as for a fast one. Four seconds are too long for both."""
    twin = Twin("single-cell")
    for interval in (1.0, 5.0):
        pid = PID(Kp=0.02, Ki=0.001, sample_time_s=interval, limits=(0, 1))
        for faults, is_on in (("stall=60/1", True), ("stall=61/1", True), ("stall=60.5/4", False)):
            loop = simulate_closed_loop(twin, pid, 30.0, duration=120, faults=faults, noise=False)
            assert bool(np.all(loop.duty[-1] != 0)) == is_on, (interval, faults)
            assert (loop.switched_off is None) == is_on
            if loop.switched_off is not None:
                assert np.all(loop.duty[loop.time >= loop.switched_off] == 0)
                assert np.any(loop.duty[loop.time < loop.switched_off] != 0)
                assert f"cells off from {loop.switched_off:g} s" in repr(loop)
                assert loop.to_xarray().attrs["switched_off_s"] == loop.switched_off


@pytest.mark.slow
def test_draws_of_a_loop_whose_cells_are_switched_off_have_failed():
    twin, pid = Twin("single-cell"), PID(Kp=0.02, Ki=0.001, limits=(0, 1))
    draws = {"R_E": [1.9, 2.0]}
    for faults, failed in (("", False), ("stall=10/5", True)):
        loops = simulate_closed_loops(twin, pid, 30.0, duration=20, draws=draws, faults=faults)
        np.testing.assert_array_equal(loops.failed, failed)


def test_a_channel_that_fails_and_a_lost_sample_are_silences():
    twin, pid = Twin("single-cell"), PID(Kp=0.02, sample_time_s=2.0, limits=(0, 1))
    failed = scenario(twin, pid, 30.0, duration=20, failed_channels={"T": 9.0}, noise=False)
    np.testing.assert_allclose(failed.silence[:5], 0)
    np.testing.assert_allclose(failed.silence[5:], np.arange(10, 21, 2) - 9 + 1 / 9)
    lost = scenario(twin, pid, 30.0, duration=20, faults="drop=0.999", seed=3, noise=False)
    before = 0.0
    for arrives, silence in zip(lost.arrives[1:], lost.silence[1:], strict=True):
        # The next frame comes a ninth of a second after the samples whose frames are lost.
        assert silence == pytest.approx(
            before + (1 / 9 if before else 0) if arrives else before + 2
        )
        before = 0.0 if arrives else silence
    assert not lost.arrives.all()


def test_ambient_and_reference_may_have_a_value_for_each_sample():
    """A sample each 2 s has two steps of the plant."""
    twin, pid = Twin("single-cell"), PID(Kp=0.02, sample_time_s=2.0, limits=(0, 1))
    room, target = np.linspace(15, 25, 11), np.linspace(25, 27, 11)
    found = scenario(twin, pid, target, duration=20, ambient=room)
    np.testing.assert_array_equal(found.ambient, np.column_stack([room, room]))
    np.testing.assert_array_equal(found.reference, target[:, None])


def test_an_interval_of_0_has_no_spans():
    assert len(periodic_spans(0.0, 1.0, 100.0)) == 0
    np.testing.assert_array_equal(periodic_spans(30.0, 5.0, 60.0), [[30, 35], [60, 65]])
