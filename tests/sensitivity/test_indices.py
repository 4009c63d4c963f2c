"""Correlations against SciPy, and Fisher's interval against a calculation by hand."""

import numpy as np
import pytest
from scipy.stats import pearsonr

from jaxtwin.sensitivity import pearson, pearson_interval


def test_pearson_equals_scipys():
    rng = np.random.default_rng(1)
    samples = rng.standard_normal((40, 3))
    outputs = samples @ rng.standard_normal((3, 2)) + rng.standard_normal((40, 2))
    ours = pearson(outputs, samples)
    for row in range(2):
        for column in range(3):
            theirs, _ = pearsonr(outputs[:, row], samples[:, column])
            assert ours[row, column] == pytest.approx(theirs, abs=1e-12)


def test_a_constant_has_no_correlation():
    assert pearson(np.ones((5, 1)), np.arange(5.0)[:, None]) == [[0.0]]


def test_fifty_draws_leave_the_uncertainty_that_the_docstring_states():
    # By hand: tanh(1.96 / sqrt(50 - 3)) = 0.278.
    low, high = pearson_interval(np.array(0.0), 50)
    assert (low, high) == (pytest.approx(-0.278, abs=1e-3), pytest.approx(0.278, abs=1e-3))


def test_interval_equals_scipys():
    rng = np.random.default_rng(2)
    x = rng.standard_normal(30)
    y = x + rng.standard_normal(30)
    result = pearsonr(x, y)
    ours = pearson_interval(pearson(y[:, None], x[:, None]), 30)[0, 0]
    np.testing.assert_allclose(ours, result.confidence_interval(0.95), atol=1e-9)
