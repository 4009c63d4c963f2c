"""Gaps in the times of a recording: held, split, a clock that was moved, or another recording."""

from dataclasses import replace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from jaxtwin import Experiment
from jaxtwin.errors import RecordingError
from jaxtwin.io._gaps import gap_sentences, separate_recordings

TIME = np.arange(600.0)
WARMING = 60.0 - 40.0 * np.exp(-TIME / 200.0)


def recording(time: np.ndarray, readings: np.ndarray, name: str = "r") -> Experiment:
    duty = np.full(time.shape, 0.5)
    return Experiment(time, duty, channels=("T",), temperatures=readings[:, None], name=name)


def test_over_a_short_gap_the_duty_is_held():
    rows = np.r_[0:300, 303:600]
    whole = recording(TIME[rows], WARMING[rows])
    np.testing.assert_array_equal(whole.elapsed, whole.time)
    assert gap_sentences(whole) == ["r: the duty is held over a gap of 4 s behind 299 s"]
    assert "the duty is held over a gap of 4 s behind 299 s" in repr(whole)
    assert separate_recordings(whole) == (whole,)


def test_a_logger_that_changes_its_rate_has_gaps_that_are_held():
    rows = np.r_[0:300, 300:600:10]
    (sentence,) = gap_sentences(recording(TIME[rows], WARMING[rows]))
    assert sentence == (
        "r: the duty is held over 29 gaps of up to 10 s, 290 s in all, the first behind 300 s"
    )


def test_a_duty_that_changes_in_a_gap_is_named():
    rows = np.r_[0:300, 303:600]
    whole = recording(TIME[rows], WARMING[rows])
    switched = replace(whole, duty=np.where(whole.time < 301, 0.5, 0.2))
    (sentence,) = gap_sentences(switched)
    assert "; it changes in 1 of them, up to 4 s, nobody knows when, and counts from" in sentence


@pytest.mark.parametrize("jump", [3600.0, 1e6, 3e7])
def test_readings_that_go_on_behind_a_long_gap_mean_a_moved_clock(jump: float):
    moved = TIME + jump * (TIME >= 300)
    whole = recording(moved, WARMING)
    np.testing.assert_allclose(whole.elapsed, TIME)
    (sentence,) = gap_sentences(whole)
    assert sentence.endswith("the clock was moved, and the gap counts as 1 s")
    assert f"nothing from 299 s to {300 + jump:.10g} s" in sentence


def test_summer_time_is_no_hour_of_held_duty():
    """An hour in a recording of three, while the rig warms: held, it would have come to rest."""
    time = np.arange(0.0, 10_800, 2.0)
    noise = np.random.default_rng(1).normal(0, 0.1, time.shape)
    readings = 60 - 40 * np.exp(-time / 4000) + noise
    moved = recording(time + 3600 * (time >= 2000), readings)
    np.testing.assert_allclose(moved.elapsed, time)
    # The same hour as a gap: the rig has gone on.
    (lost,) = np.nonzero((time < 2000) | (time >= 5600))
    np.testing.assert_allclose(recording(time[lost], readings[lost]).elapsed, time[lost])


@pytest.mark.parametrize("seed", range(20))
def test_an_hour_that_is_lost_at_rest_is_held(seed: int):
    """Noise alone has no rate."""
    time = np.arange(0.0, 10_800, 2.0)
    readings = 40 + np.random.default_rng(seed).normal(0, 0.1, time.shape)
    kept = (time < 2000) | (time >= 5600)
    whole = recording(time[kept], readings[kept])
    np.testing.assert_array_equal(whole.elapsed, whole.time)


def test_two_jumps_of_a_clock_are_two():
    moved = TIME + 1e6 * (TIME >= 200) + 1e6 * (TIME >= 400)
    np.testing.assert_allclose(recording(moved, WARMING).elapsed, TIME)


def test_behind_a_night_another_recording_begins():
    """The second day begins cold, where the first has ended hot."""
    time = np.append(TIME, TIME + 60_000.0)
    first, second = separate_recordings(recording(time, np.append(WARMING, WARMING)))
    assert (first.name, second.name) == ("r part 1", "r part 2")
    assert second.time[0] == 60_000
    # Where a recording is not divided, the duty is held as long as it may be.
    steps = np.diff(recording(time, np.append(WARMING, WARMING)).elapsed)
    assert steps.max() == pytest.approx(2 * 599)


def test_two_sessions_of_a_rig_that_has_come_to_rest_are_two_recordings():
    """The readings go on, at those of the room, but the room may be another one."""
    session = np.concatenate([WARMING, 20 + (WARMING[-1] - 20) * np.exp(-TIME / 60.0)])
    time = np.arange(1200.0)
    duty = np.tile(np.where(time < 600, 0.5, 0.0), 2)
    whole = Experiment(
        np.append(time, time + 80_000),
        duty,
        channels=["T"],
        temperatures=np.append(session, session)[:, None],
    )
    assert [part.time[0] for part in separate_recordings(whole)] == [0, 80_000]


def test_a_single_sample_behind_a_night_is_refused_and_not_dropped():
    time, readings = np.append(TIME, 1e5), np.append(WARMING, 20.0)
    with pytest.raises(RecordingError, match=r"r: expected at least two samples .* got 1 from 1"):
        separate_recordings(recording(time, readings.copy()))


def test_an_experiment_without_readings_was_made_and_has_no_clock():
    time = np.append(TIME, 1e6)
    made = Experiment(time, np.zeros(time.shape))
    np.testing.assert_array_equal(made.elapsed, time)
    assert gap_sentences(made) == []


def test_a_part_begins_with_the_recording_but_has_only_its_own_readings():
    rows = np.r_[0:1, 10:300, 310:600]
    whole = recording(TIME[rows], WARMING[rows])
    parts = whole.parts
    assert [part.name for part in parts] == ["r part 1", "r part 2", "r part 3"]
    assert [int(part.sampled.sum()) for part in parts] == [1, 290, 290]
    assert all(part.time[0] == 0 for part in parts)


@given(
    st.lists(st.floats(0.01, 1e7), min_size=2, max_size=30),
    st.lists(st.floats(-20, 200), min_size=31, max_size=31),
)
def test_no_reading_is_dropped_whatever_the_times(steps: list[float], readings: list[float]):
    time = np.append(0.0, np.cumsum(steps))
    whole = recording(time, np.array(readings[: len(time)]))
    assert np.all(np.diff(whole.elapsed) > 0)
    assert whole.elapsed[-1] <= whole.duration * (1 + 1e-12)
    try:
        parts, separate = whole.parts, separate_recordings(whole)
    except RecordingError:  # a single sample between two long gaps
        return
    assert sum(int(part.sampled.sum()) for part in parts) == len(time)
    assert sum(len(part.time) for part in separate) == len(time)


def test_missing_readings_on_both_sides_of_a_gap_say_nothing():
    readings = WARMING.copy()
    readings[290:310] = np.nan
    moved = replace(recording(TIME + 1e6 * (TIME >= 300), readings), name="m")
    np.testing.assert_allclose(np.diff(moved.elapsed)[299], 1.0, atol=1.0)
