"""A history in a fixed amount of memory says of each interval what a list of all samples says."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtwin.observers import Estimate
from jaxtwin.serve import History
from jaxtwin.serve._history import LEVELS

START = 1_700_000_000.0


def filled(times: np.ndarray, readings: np.ndarray) -> History:
    history = History(1, 1)
    for time, reading in zip(times, readings, strict=True):
        one = np.array([reading])
        history.add(time, one, one + 1.0, np.array([0.5]), np.array([0.25]))
    return history


@settings(max_examples=60)
@given(
    steps=st.lists(st.floats(0.01, 40.0), min_size=1, max_size=60),
    span=st.floats(1.0, 3000.0),
    points=st.integers(2, 50),
    seed=st.integers(0, 99),
)
def test_intervals_hold_the_extremes_and_the_mean_of_their_samples(
    steps: list[float], span: float, points: int, seed: int
) -> None:
    times = START + np.cumsum(steps)
    readings = np.random.default_rng(seed).normal(30.0, 5.0, len(times))
    readings[:: 7 + seed % 5] = np.nan  # failed channels
    found = filled(times, readings).over(span, points)
    assert len(found["time"]) <= points
    assert np.all(np.diff(found["time"]) > 0)
    last = len(found["time"]) - 1
    for place, begin in enumerate(found["time"]):
        inside = (times >= begin) & (times < begin + found["width"])
        # The first interval may be cut off at its beginning.
        if place in (0, last):
            inside &= times >= max(times[-1] - span, times[0]) - found["width"]
        values = readings[inside & np.isfinite(readings)]
        low, high, mean = (found[name][0][place] for name in ("low", "high", "mean"))
        if not len(values):
            assert low is None
            continue
        if place not in (0, last):
            np.testing.assert_allclose(
                [low, high, mean], [values.min(), values.max(), values.mean()], atol=0.006
            )
        assert low <= mean + 0.006 <= high + 0.012


def test_a_history_of_nothing_is_empty() -> None:
    found = History(2, 1).over(300.0)
    assert found["time"] == []
    assert found["mean"] == [[], []]
    assert found["duty"] == [[]]


def test_memory_does_not_grow_and_a_week_is_answered_in_few_points() -> None:
    history = History(15, 2)
    sizes = [level._low.nbytes for level in history._levels]
    ones, duty = np.ones(15), np.zeros(2)
    week = 7 * 86_400.0
    for time in START + np.arange(0.0, week, 400.0):
        history.add(time, ones, ones, ones, duty)
    assert [level._low.nbytes for level in history._levels] == sizes
    found = history.over(week)
    assert 400 < len(found["time"]) <= 600
    assert found["time"][-1] - found["time"][0] > 0.98 * week
    recent = history.over(300.0)
    assert recent["width"] == LEVELS[0][0]


def test_a_clock_that_steps_back_spoils_nothing() -> None:
    history = filled(np.array([START + 1e5, START + 1e5 + 1, START]), np.array([1.0, 2.0, 3.0]))
    assert history.over(10.0)["mean"] == [[1.0, 2.0]]


def estimated(*values: float) -> Estimate:
    """Parameters with bands of a tenth to both sides."""
    mean = np.array(values)
    return Estimate(mean, 0.9 * mean, 1.1 * mean)


def test_parameters_are_kept_with_their_bands_at_the_end_of_each_interval() -> None:
    history, one, duty = History(1, 1), np.ones(1), np.zeros(1)
    history.follow(["R_1", "P_2"])
    for second in range(30):
        known = None if second == 0 else estimated(60.0 + second, 1.0e-5)
        history.add(START + second, one, one, one, duty, known)
    found = history.over(100.0)
    assert found["parameter"] == [[None, *range(61, 90)], [None] + 29 * [1e-5]]
    assert found["parameter_lower"][0][1] == 54.9
    assert found["parameter_upper"][0][-1] == 97.9
    coarse = history.over(100.0, points=4)
    assert coarse["width"] == 10.0
    assert coarse["parameter"][0][0] == 69.0


def test_a_twin_with_other_uncertain_parameters_goes_on_with_those_that_it_shares() -> None:
    history, one, duty = History(1, 1), np.ones(1), np.zeros(1)
    history.follow(["R_1", "P_2"])
    history.add(START, one, one, one, duty, estimated(60.0, 0.75))
    history.follow(["P_2", "C_1", "R_2"])
    history.add(START + 1, one, one, one, duty, estimated(0.8, 2.0, 3.0))
    assert history.over(10.0)["parameter"] == [[0.75, 0.8], [None, 2.0], [None, 3.0]]
    history.follow([])
    assert history.over(10.0)["parameter"] == []
