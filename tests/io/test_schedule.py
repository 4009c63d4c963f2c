"""Duty schedules in words: `Experiment.schedule`."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.errors import RecordingError
from jaxtwin.io import Experiment


def test_the_paper_schedule():
    """Fig. 6: 50 % from the start, 78 % from 500 s on, both cells, 1001 samples a second apart."""
    experiment = Experiment.schedule("0:0.5,500:0.78", duration=1000, cells=2)
    np.testing.assert_array_equal(experiment.time, np.arange(1001.0))
    np.testing.assert_array_equal(experiment.duty[:500], np.full((500, 2), 0.5))
    np.testing.assert_array_equal(experiment.duty[500:], np.full((501, 2), 0.78))
    np.testing.assert_array_equal(experiment.switch_times, [500])
    assert experiment.temperatures is None


def test_each_cell_can_have_its_own_duty_and_blanks_are_allowed():
    experiment = Experiment.schedule(" 0 : 0.5 / -0.3 , 2 : 1 ", duration=3, cells=2)
    np.testing.assert_array_equal(experiment.duty, [[0.5, -0.3], [0.5, -0.3], [1, 1], [1, 1]])


def test_before_the_first_time_the_power_is_zero():
    experiment = Experiment.schedule("2:0.5", duration=4)
    np.testing.assert_array_equal(experiment.duty[:, 0], [0, 0, 0.5, 0.5, 0.5])


def test_a_switch_or_an_end_between_samples_is_a_sample():
    experiment = Experiment.schedule("0:0.5,1.25:0.1", duration=2.5, channels=["T"], ambient=15)
    np.testing.assert_array_equal(experiment.time, [0, 1, 1.25, 2, 2.5])
    np.testing.assert_array_equal(experiment.switch_times, [1.25])
    assert (experiment.channels, experiment.ambient) == (("T",), 15)


@given(switch=st.integers(1, 99), step=st.sampled_from([0.1, 0.3, 0.7, 1e-3, 3.0]))
def test_a_switch_on_the_grid_adds_no_sample(switch, step):
    """Whether written as a decimal or computed, 0.3 s is the third sample of 0.1 s steps."""
    text = f"0:0.5,{switch * step:.6g}:0.6"
    experiment = Experiment.schedule(text, duration=100 * step, step=step)
    assert len(experiment.time) == 101
    np.testing.assert_allclose(experiment.switch_times, [switch * step], rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "entry: .* got ''"),
        ("0.5", "schedule entry: expected 'time:duty' .* got '0.5'"),
        ("0:0.5,,2:0.1", "entry: .* got ''"),
        ("0:half", "entry: .* got '0:half'"),
        ("0:1.2", "entry '0:1.2': expected duty cycles from -1 to 1"),
        ("0:nan", "entry '0:nan': expected duty cycles"),
        ("inf:0.5", "entry 'inf:0.5': expected a finite number as the time"),
        ("0:0.1/0.2/0.3", "one for each of the 2, got 3"),
        ("0:0.5,500:0.1,500:0.2", "expected increasing times"),
        ("-1:0.5", "from 0 s to before the end"),
        ("1000:0.5", "before the end at 1000 s"),
    ],
)
def test_a_wrong_entry_is_quoted(text, said):
    with pytest.raises(RecordingError, match=said):
        Experiment.schedule(text, duration=1000, cells=2)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"duration": 0}, "duration: .* got 0"),
        ({"duration": float("inf")}, "duration: expected a finite number.*, got inf"),
        ({"duration": 10, "step": 0}, "step: .* got 0 s"),
        ({"duration": 10, "step": 11}, "up to the duration 10 s"),
        ({"duration": 10, "step": float("nan")}, "step: expected a finite number.*, got nan"),
        ({"duration": 1e9, "step": 1e-3}, "at most 10000000 samples"),
        ({"duration": 10, "cells": 0}, "cells: expected a whole number above 0.*, got 0"),
        ({"duration": 10, "cells": 10**9}, "cells: expected at most 1000, got 1000000000"),
    ],
)
def test_a_grid_that_cannot_be_is_refused(arguments, said):
    with pytest.raises(RecordingError, match=said):
        Experiment.schedule("0:0.5", **arguments)


def test_a_room_in_words_is_held_or_reached_along_a_line():
    warming = Experiment.schedule("0:0.5", duration=100, ambient="0:20, ramp 50:25, 80:21")
    np.testing.assert_allclose(
        np.asarray(warming.ambient)[[0, 25, 50, 79, 80, 100]], [20, 22.5, 25, 25, 21, 21]
    )
    with pytest.raises(RecordingError, match=r"schedule: ambient: expected .* got '50:warm'"):
        Experiment.schedule("0:0.5", duration=100, ambient="0:20, 50:warm")
