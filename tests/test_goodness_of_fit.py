"""How near a simulation is to a recording, and how its residuals hang together."""

import numpy as np
import pytest

from jaxtwin._statistics import autocorrelation, fit_percent, fit_text, mean_fit_percent


def test_the_fit_of_a_channel_that_never_changes_is_no_number():
    """Its variance is 0, whatever rounding makes of its mean; the other channel's is by hand."""
    recorded = np.column_stack([np.full(7, 20.1), np.arange(7.0)])
    simulated = recorded + np.array([0.5, 1.0])
    fits = fit_percent(recorded, simulated)
    assert np.isnan(fits[0])
    assert fits[1] == pytest.approx(100 * (1 - np.sqrt(7 / 28)))


def test_the_mean_fit_is_of_the_channels_that_change():
    assert mean_fit_percent([50.0, np.nan, 70.0]) == 60.0
    assert np.isnan(mean_fit_percent([np.nan]))
    assert fit_text(np.nan, " %") == "constant"
    assert fit_text(69.16, " %") == "69.2 %"


def test_a_series_has_an_autocorrelation_of_1_at_lag_0_and_the_same_in_any_unit():
    kelvin = np.random.default_rng(0).normal(size=200)
    found = autocorrelation(kelvin, 3)
    assert found[0] == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(autocorrelation(1000 * kelvin, 3), found, atol=1e-12)
