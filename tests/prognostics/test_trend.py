"""The trend of sessions: estimates against closed forms, and how often its intervals are right."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import linregress

from jaxtwin.prognostics import Trend, random_effects_trend

TIMES = np.array([0.0, 4.0, 9.0, 15.0, 20.0])
VALUES = np.array([0.1, -0.2, 0.5, 0.4, 0.9])


def test_equal_errors_give_the_line_of_least_squares_and_its_errors():
    """With errors that are negligible, the spread is the residual standard deviation of an ordinary
    regression, and the slope has its standard error."""
    found = random_effects_trend(TIMES, VALUES, np.full(5, 1e-9))
    known: Any = linregress(TIMES, VALUES)
    assert found.slope == pytest.approx(known.slope)
    assert found.slope_error == pytest.approx(known.stderr)
    assert found.p_value == pytest.approx(known.pvalue)
    residuals = VALUES - known.intercept - known.slope * TIMES
    assert found.spread == pytest.approx(np.sqrt(residuals @ residuals / 3))


def test_sessions_that_agree_have_no_spread_and_the_errors_of_weighted_least_squares():
    errors = np.array([1.0, 2.0, 1.0, 0.5, 1.0])
    found = random_effects_trend(TIMES, VALUES, errors)
    design = np.stack([np.ones(5), TIMES], axis=1) / errors[:, None]
    covariance = np.linalg.inv(design.T @ design)
    level, slope = covariance @ design.T @ (VALUES / errors)
    assert found.spread == 0.0
    assert found.spread_interval[0] == 0.0
    assert found.slope == pytest.approx(slope)
    assert found.slope_error == pytest.approx(np.sqrt(covariance[1, 1]))
    assert found.line(0.0) == pytest.approx(level)
    assert found.line_error(0.0) == pytest.approx(np.sqrt(covariance[0, 0]))


@pytest.mark.slow
@pytest.mark.parametrize(("count", "spread"), [(3, 0.1), (5, 0.0), (5, 0.1), (10, 0.3)])
def test_intervals_contain_slope_and_spread_as_often_as_they_say(count: int, spread: float):
    """95 % of 200 simulated series each, whose count has a standard deviation of 3.1. Without a
    spread they are wider than they need be, as that of any estimate at the edge of its range."""
    random = np.random.default_rng(1)
    slopes = spreads = 0
    for _ in range(200):
        times = np.sort(random.uniform(0.0, 30.0, count))
        errors = random.uniform(0.03, 0.1, count)
        values = 0.5 + 0.01 * times + random.normal(0.0, spread, count)
        found = random_effects_trend(times, values + random.normal(0.0, errors), errors)
        slopes += abs(found.slope - 0.01) <= found.reach * found.slope_error
        low, high = found.spread_interval
        spreads += low <= spread <= high
    assert slopes >= 181
    assert spreads >= 181


def test_the_probability_of_passing_is_that_of_drawn_lines():
    """Lines are drawn with level and slope from their joint Student's distribution."""
    trend = Trend(8.0, 0.2, 0.1, 0.02, 0.01, 3, 0.0, (0.0, 1.0))
    random, count = np.random.default_rng(0), 400_000
    level, slope = random.normal(size=(2, count)) * np.sqrt(3 / random.chisquare(3, count))
    level, slope = 0.2 + 0.1 * level, 0.02 + 0.01 * slope
    path = [level + slope * (time - 8.0) for time in np.linspace(20.0, 35.0, 7)]
    for limit in (0.3, 0.5, 0.8):
        above = trend.probability_of_passing(limit, 20.0, 15.0, is_upward=True)
        below = trend.probability_of_passing(limit, 20.0, 15.0, is_upward=False)
        assert above == pytest.approx(np.mean(np.max(path, axis=0) > limit), abs=0.004)
        assert below == pytest.approx(np.mean(np.min(path, axis=0) < limit), abs=0.004)


@settings(max_examples=20, deadline=None)
@given(
    st.lists(st.tuples(st.floats(-1e3, 1e3), st.floats(1e-3, 10.0)), min_size=3, max_size=8),
    st.floats(-1e3, 1e3),
)
def test_a_longer_time_is_never_safer(sessions: list[tuple[float, float]], limit: float):
    values, errors = np.array(sessions).T
    found = random_effects_trend(np.arange(len(values), dtype=float), values, errors)
    assert found.spread_interval[0] <= found.spread + 1e-12
    assert found.spread <= found.spread_interval[1] + 1e-12
    chances = [
        found.probability_of_passing(limit, 5.0, within, is_upward=True)
        for within in (0.0, 1.0, 10.0)
    ]
    assert 0.0 <= chances[0] <= chances[1] + 1e-3 <= chances[2] + 2e-3 <= 1.0 + 2e-3
