"""What a diagnosis could say, before anything happened."""

import math
from functools import cache

import numpy as np
import pytest
from faulty_runs import bench, clean, recording

import jaxtwin as jt
from jaxtwin.diagnosis import Isolability
from jaxtwin.diagnosis._isolability import _planned
from jaxtwin.errors import ObserverError

NAMES = ("age H1", "weaken H1", "gain T1", "leak H1", "load H1", "loosen H1")


@cache
def both() -> Isolability:
    return jt.isolability(bench(), faults=NAMES)


@pytest.mark.slow
def test_faults_that_look_the_same_are_never_told_apart():
    assert ("age H1", "weaken H1") in both().ties
    matrix = both().separation
    assert math.isinf(matrix[0, 1])
    assert math.isinf(matrix[1, 0])
    assert np.isfinite(matrix[2, 0])  # a gain is seen at once
    assert "age H1 and weaken H1 are not told apart" in both().summary()


@pytest.mark.slow
def test_a_gain_is_found_at_once_and_a_resistance_later():
    times = dict(zip(both().names, both().detection, strict=True))
    assert times["gain T1"] < 5 < times["age H1"] < 200


@pytest.mark.slow
def test_the_smallest_size_that_is_found_is_found():
    """A diagnosis finds a fault somewhat above the size that is stated, and none far below it."""
    duty = jt.Experiment(np.arange(901.0), clean()[0], channels=bench().channels)
    usual = jt.isolability(bench(), duty=duty, faults=["load H1"], onset=500, duration=400)
    (smallest,) = usual.smallest
    assert 1.0 < smallest < 1.5
    larger = recording("load", "H1", 1 + 1.6 * (smallest - 1))
    assert jt.diagnose(bench(), larger, ["load H1"]).causes
    smaller = recording("load", "H1", 1 + 0.4 * (smallest - 1))
    assert not jt.diagnose(bench(), smaller, ["load H1"]).causes


@pytest.mark.slow
def test_it_says_which_channel_would_tell_a_pair_apart():
    """With the sensor of one heater alone, a fault there may be one of its neighbour."""
    names = ["weaken supply", "weaken H1"]
    one = jt.isolability(bench(), ["T1"], faults=names)
    assert one.ties == [("weaken supply", "weaken H1")]
    channel, time = one.separators[one.ties[0]]
    assert channel == "T2"
    assert time < 600
    assert jt.isolability(bench(), ["T1", "T2"], faults=names).ties == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"channels": ["T9"]}, "unknown channel 'T9'"),
        ({"faults": ["x"]}, "expected names of tclab"),
        ({"duration": 0}, "duration: expected a number above 0, in s, got 0"),
    ],
)
def test_what_cannot_be_said_is_refused_in_a_sentence(arguments: dict[str, object], words: str):
    with pytest.raises(ObserverError, match=words):
        jt.isolability(bench(), **arguments)  # pyright: ignore[reportArgumentType]
    short = jt.Experiment(np.arange(100.0), np.zeros((100, 2)), channels=bench().channels)
    with pytest.raises(ObserverError, match="goes on after the onset"):
        jt.isolability(bench(), duty=short)


def test_an_experiment_is_looked_at_until_the_end_of_the_duration():
    plan = jt.Experiment.schedule("0:0.5", duration=1000.0, cells=len(bench().rig.driven))
    assert _planned(bench(), plan, 400.0).duration == 400.0
    assert _planned(bench(), plan, 2000.0).duration == 1000.0
