"""Intervals as a person reads them: in the scale of the match, with digits that tell the ends."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import lognorm, norm

from jaxtwin._number_text import interval_text, short_number
from jaxtwin.matching._fitted_parameters import interval_95


@given(st.floats(1e-6, 1e6), st.floats(1e-4, 20))
def test_ends_are_the_quantiles_of_a_lognormal_distribution(value, error):
    """scipy's; the lower end is above 0 however large the error is."""
    low, high = interval_95(value, error, is_logarithmic=True)
    assert (low, high) == pytest.approx(lognorm.interval(0.95, error, scale=value), rel=1e-9)
    assert 0 < low < value < high


@given(st.floats(-100, 100), st.floats(1e-4, 20))
def test_ends_are_the_quantiles_of_a_normal_distribution(value, error):
    """scipy's."""
    found = interval_95(value, error, is_logarithmic=False)
    assert found == pytest.approx(norm.interval(0.95, value, error), rel=1e-9, abs=1e-9)


def test_an_undetermined_value_has_an_unbounded_interval_and_a_held_one_none():
    assert interval_95(2.0, math.inf, is_logarithmic=True) == (0.0, math.inf)
    assert interval_95(2.0, 1e4, is_logarithmic=True) == (0.0, math.inf)  # beyond a float
    assert interval_95(2.0, math.inf, is_logarithmic=False) == (-math.inf, math.inf)
    assert all(map(math.isnan, interval_95(2.0, math.nan, is_logarithmic=True)))
    assert interval_text((0.0, math.inf)) == "unknown"
    assert interval_text((math.nan, math.nan)) == "-"


@pytest.mark.parametrize(
    ("interval", "text"),
    [
        ((3.14159e-7, 0.84), "3.1e-7 to 0.84"),
        ((1.02, 141.0), "1 to 140"),
        ((14.234, 15.111), "14.2 to 15.1"),
        ((0.61234, 0.61301), "0.61234 to 0.61301"),
        ((16.93, 19.48), "16.9 to 19.5"),
        ((-0.5, 0.3), "-0.5 to 0.3"),
        ((2.0, 2.0), "2 to 2"),
    ],
)
def test_an_interval_has_enough_digits_to_tell_its_ends_apart(interval, text):
    assert interval_text(interval) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.605e-5, "1.605e-5"),
        (6812345.0, "6.812e6"),
        (2e10, "2e10"),
        (0.5, "0.5"),
        (-43210.0, "-43210"),
        (np.inf, "inf"),
    ],
)
def test_powers_of_ten_are_short(value, text):
    assert short_number(value) == text
