"""Whoever waits for a validation hears of each recording that is predicted, and of each step."""

import numpy as np
import pytest

from jaxtwin import Experiment, Twin, leave_one_out, validate, validate_split
from jaxtwin.matching import Iteration
from jaxtwin.validation import Prediction

FREE = ["C_load", "T_amb", "T_start"]


@pytest.fixture(scope="module")
def days() -> list[Experiment]:
    """Two of one shape, so that they share compiled code."""
    days = []
    for seed, name in enumerate(("monday", "tuesday")):
        drive = Experiment.schedule("70:0.4", duration=140)
        noise = np.random.default_rng(seed).standard_normal((len(drive.time), 1))
        seen = Twin("single-cell").simulate(drive).temperatures + 0.05 * noise
        day = Experiment(drive.time, drive.duty, channels=("T",), temperatures=seen, name=name)
        days.append(day)
    return days


@pytest.mark.slow
def test_a_validation_tells_of_each_recording(days: list[Experiment]):
    told: list[object] = []
    validate(Twin("single-cell"), days, on_progress=told.append)
    assert [part.name for part in told if isinstance(part, Prediction)] == ["monday", "tuesday"]


@pytest.mark.slow
def test_a_split_tells_of_the_match_and_of_each_recording(days: list[Experiment]):
    told: list[object] = []
    validate_split(
        Twin("single-cell"),
        days,
        100,
        free=FREE,
        max_iterations=2,
        on_progress=told.append,
    )
    assert all(isinstance(part, Prediction) for part in told[-2:])
    assert all(isinstance(part, Iteration) for part in told[:-2])
    assert len(told) > 2


@pytest.mark.slow
def test_leave_one_out_tells_of_every_match(days: list[Experiment]):
    """The first iteration of a match has the number 0: two matches, two such."""
    told: list[object] = []
    leave_one_out(
        Twin("single-cell"),
        days,
        free=FREE,
        max_iterations=2,
        on_progress=told.append,
    )
    kinds = [type(part) for part in told]
    assert kinds.count(Prediction) == 2
    assert [part.number for part in told if isinstance(part, Iteration)].count(0) == 2
    assert kinds.index(Prediction) < len(told) - 1
    assert kinds[-1] is Prediction
