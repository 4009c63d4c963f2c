"""Correlations against SciPy."""

import numpy as np
import pytest
from scipy.stats import pearsonr, spearmanr

from jaxtwin.sensitivity_analysis import pearson, spearman


def test_correlations_equal_scipys():
    rng = np.random.default_rng(1)
    samples = rng.standard_normal((40, 3))
    outputs = samples @ rng.standard_normal((3, 2)) + rng.standard_normal((40, 2))
    outputs[5] = outputs[6]  # equal values share a rank
    for ours, theirs in ((pearson, pearsonr), (spearman, spearmanr)):
        for row in range(2):
            for column in range(3):
                expected, _ = theirs(outputs[:, row], samples[:, column])
                assert ours(outputs, samples)[row, column] == pytest.approx(expected, abs=1e-12)


def test_a_constant_has_no_correlation():
    """Also where its mean is another number by rounding."""
    for constant in (1.0, 0.1):
        assert pearson(np.full((7, 1), constant), np.arange(7.0)[:, None]) == [[0.0]]
        assert spearman(np.full((7, 1), constant), np.arange(7.0)[:, None]) == [[0.0]]
