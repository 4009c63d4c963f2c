"""Run lengths of Page's sums, and what the tails of short ones say of long ones."""

import numpy as np
import pytest

from jaxtwin.monitoring._calibrate import BLOCK_SECONDS, block_maxima, tail_of
from jaxtwin.monitoring._thresholds import alarms_of_sum, mean_run_length


@pytest.mark.parametrize(("limit", "published"), [(4.0, 168.0), (5.0, 465.0)])
def test_run_lengths_of_two_sided_sums_are_those_of_the_handbooks(limit: float, published: float):
    # Montgomery, Introduction to Statistical Quality Control, table of two-sided sums with k = 0.5.
    assert mean_run_length(limit) == pytest.approx(published, rel=0.01)


def test_the_textbook_threshold_alarms_every_47_seconds_at_10_hertz():
    assert mean_run_length(5.0) / 10 == pytest.approx(46.5, abs=0.5)


def test_counted_alarms_agree_with_the_chain():
    noise = np.random.default_rng(0).normal(size=200_000)
    counted = len(noise) / alarms_of_sum(noise, 4.0)
    assert counted == pytest.approx(mean_run_length(4.0), rel=0.1)


def test_the_tail_of_hours_gives_the_run_length_of_days():
    # Ten hours at 1 Hz are looked at; the exact mean run length at h = 12 is six days.
    random = np.random.default_rng(1)
    maxima = [block_maxima(np.arange(36_000.0), _sums(random.normal(size=36_000)))]
    tail = tail_of(maxima, "simulations")
    assert tail is not None
    exact = mean_run_length(12.0)
    assert exact > 5 * 86_400
    assert 1 / 4 < tail.seconds(12.0) / exact < 4
    assert np.exp(tail.spread) > 1.2  # and the tail says that it does not know it exactly


def test_the_threshold_for_a_time_is_passed_once_in_it():
    maxima = [np.random.default_rng(2).exponential(2.0, 5000)]
    tail = tail_of(maxima, "recordings")
    assert tail is not None
    assert tail.hours == pytest.approx(5000 * BLOCK_SECONDS / 3600)
    assert tail.scale == pytest.approx(2.0, rel=0.1)
    limit = tail.threshold(500 * BLOCK_SECONDS)
    assert np.sum(maxima[0] > limit) == pytest.approx(10, abs=6)
    assert tail.seconds(limit) == pytest.approx(500 * BLOCK_SECONDS)


def test_the_tail_is_that_of_the_rigs_that_differ_most():
    """One rig of twenty has peaks three times as high: above what a fifth of the blocks pass, most
    peaks are still those of the others."""
    random = np.random.default_rng(3)
    scale = np.repeat([3.0, 1.0], [500, 9500])
    tail = tail_of([scale * random.exponential(1.0, 10_000)], "recordings")
    assert tail is not None
    assert tail.scale == pytest.approx(3.0, rel=0.25)
    once = 20 * 10_000 * BLOCK_SECONDS
    assert tail.threshold(once) == pytest.approx(3.0 * np.log(500 * 20), rel=0.15)


def test_too_few_blocks_have_no_tail():
    assert tail_of([np.ones(3)], "recordings") is None
    assert tail_of([], "recordings") is None


def test_the_maxima_of_blocks_leave_out_an_incomplete_one():
    time = np.arange(0.0, 130.0)
    assert block_maxima(time, time).tolist() == [59.0, 119.0]


def _sums(noise: np.ndarray) -> np.ndarray:
    """The larger of both sums after each innovation."""
    found, up, down = np.empty(len(noise)), 0.0, 0.0
    for place, x in enumerate(noise.tolist()):
        up, down = max(0.0, up + x - 0.5), max(0.0, down - x - 0.5)
        found[place] = max(up, down)
    return found
