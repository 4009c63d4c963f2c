"""Weights of elements in the mean over a zone."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.rig._zone_means import mean_weights


@given(st.lists(st.floats(1, 9), min_size=1, max_size=6), st.data())
def test_the_mean_over_a_range_is_that_of_the_interpolated_temperature(sizes, data):
    """Against `numpy.interp` and the trapezoidal rule, exact for piecewise linear functions."""
    edges = np.concatenate([[0.0], np.cumsum(sizes)])
    low = data.draw(st.floats(0, 0.9)) * edges[-1]
    high = low + data.draw(st.floats(0.1, 1)) * (edges[-1] - low)
    temperatures = np.arange(len(sizes)) ** 2 - 3.0
    centres = (edges[1:] + edges[:-1]) / 2
    x = np.unique([low, high, *centres[(centres > low) & (centres < high)]])
    mean = np.trapezoid(np.interp(x, centres, temperatures), x) / (high - low)
    weights = mean_weights(edges, np.array(low), np.array(high))
    assert weights @ temperatures == pytest.approx(mean, abs=1e-9)
    assert weights.sum() == pytest.approx(1)
    assert weights.min() >= 0
