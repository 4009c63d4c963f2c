"""Derivatives of reductions with respect to parameters."""

import numpy as np
import pytest

from jaxtwin import Experiment, Twin, reduce_batch
from jaxtwin.sensitivity_analysis._derivative_based import slopes_of


@pytest.mark.slow
def test_derivatives_of_the_energy_are_those_of_differences(monkeypatch):
    """Both by JAX, whose energy has a rule of its own."""
    monkeypatch.setenv("JAXTWIN_NATIVE", "off")
    time = np.arange(0.0, 40.5, 0.5)
    duty = np.where(time[:, None] < 20, [0.5, 0.8], [-0.2, 0.4])
    twin, experiment = Twin("dual-cell"), Experiment(time, duty)
    values, step = {"R_E": np.array([2.0])}, 1e-3
    (slope,) = slopes_of(twin, experiment, values, ["energy", "peak_power"])
    ends = reduce_batch(
        twin, experiment, {"R_E": [2.0 - step, 2.0 + step]}, ["energy", "peak_power"]
    )
    for name in ("energy", "peak_power"):
        by_differences = np.diff(ends[name])[0] / (2 * step)
        assert slope[name][0] == pytest.approx(by_differences, rel=1e-5)
        assert by_differences < 0
