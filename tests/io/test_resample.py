"""The rule of the grid, by hand."""

import numpy as np

from jaxtwin.io._session import BinMeans, ZeroOrderHold

GRID = np.array([10.0, 11.0, 12.0, 13.0])


def bin_means(time: np.ndarray, values: np.ndarray, run: list[int] | None = None) -> np.ndarray:
    """In one block, and sample by sample in the opposite order."""
    whole, parts = BinMeans(GRID, 1.0, values.shape[1]), BinMeans(GRID, 1.0, values.shape[1])
    runs = np.array(run or [1] * len(time))
    whole.add(time, values, runs)
    for k in reversed(range(len(time))):
        parts.add(time[k : k + 1], values[k : k + 1], runs[k : k + 1])
    found = whole.result()
    np.testing.assert_array_equal(parts.result(), found)
    return found


def zero_order_hold(
    time: np.ndarray, values: np.ndarray, when: np.ndarray, longest: float
) -> tuple[np.ndarray, np.ndarray]:
    """In one block, and sample by sample."""
    whole, parts = ZeroOrderHold(when, values.shape[1]), ZeroOrderHold(when, values.shape[1])
    whole.add(time, values)
    for k in range(len(time)):
        parts.add(time[k : k + 1], values[k : k + 1])
    held, there = whole.result(longest)
    for found, expected in zip(parts.result(longest), (held, there), strict=True):
        np.testing.assert_array_equal(found, expected)
    return held, there


def test_a_grid_time_is_the_mean_within_half_a_step_and_nothing_is_filled_in() -> None:
    time = np.array([9.4, 9.5, 10.0, 10.49, 10.5, 12.9])
    values = np.array([[100.0], [1.0], [2.0], [3.0], [7.0], [9.0]])
    means = bin_means(time, values)
    np.testing.assert_array_equal(means[:, 0], [2.0, 7.0, np.nan, 9.0])


def test_a_reading_that_lacks_one_channel_counts_in_the_others() -> None:
    values = np.array([[1.0, np.nan], [3.0, 5.0], [np.nan, 7.0]])
    means = bin_means(np.array([10.0, 10.1, 12.0]), values)
    np.testing.assert_array_equal(means[:, 0], [2.0, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(means[:, 1], [5.0, np.nan, 7.0, np.nan])


def test_a_value_is_held_until_the_next_and_for_at_most_the_longest_hold() -> None:
    time, values = np.array([10.0, 10.9]), np.array([[0.5], [0.78]])
    duty, there = zero_order_hold(time, values, GRID + 0.5, longest=2.0)
    assert duty[:, 0].tolist()[:2] == [0.5, 0.78]
    assert there.tolist() == [True, True, True, False]


def test_no_value_is_held_before_the_first() -> None:
    _, there = zero_order_hold(np.array([11.0]), np.array([[0.5]]), np.array([10.9, 11.0]), 5.0)
    assert there.tolist() == [False, True]


def test_a_mean_is_never_taken_across_two_runs() -> None:
    values = np.array([[1.0], [3.0], [5.0], [7.0]])
    means = bin_means(np.array([10.0, 10.4, 11.0, 11.4]), values, [1, 2, 2, 2])
    np.testing.assert_array_equal(means[:, 0], [np.nan, 6.0, np.nan, np.nan])
