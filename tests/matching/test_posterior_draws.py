"""Draws of what a match leaves open have its mean, its covariance and its bounds."""

from typing import Any

import numpy as np
import pytest
from small_results import fit

from jaxtwin import MatchError
from jaxtwin.matching import posterior_draws


def test_draws_have_the_spread_of_the_match():
    """That of the shared parameters, with what differs between recordings; all are logarithms."""
    matched = fit()
    draws = posterior_draws(matched, 4000, seed=1)
    assert set(draws) == {"R_E", "R_pc"}  # the room's temperature belongs to a recording
    for name, values in draws.items():
        row, place = matched[name], matched.uncertainty.labels.index(name)
        variance = matched.uncertainty.vector_covariance[place, place]
        variance = np.nan_to_num(variance + matched.uncertainty.between_recordings[place] ** 2)
        inside = (values > row.lower) & (values < row.upper)
        if inside.all():
            assert np.log(values).mean() == pytest.approx(
                np.log(row.value), abs=4 * np.sqrt(variance / 4000) + 1e-9
            )
            assert np.log(values).std() == pytest.approx(np.sqrt(variance), rel=0.05, abs=1e-9)
        assert np.all((row.lower <= values) & (values <= row.upper))
    again = posterior_draws(matched, 4000, seed=1)
    np.testing.assert_array_equal(again["R_pc"], draws["R_pc"])
    assert not np.array_equal(posterior_draws(matched, 4000, seed=2)["R_pc"], draws["R_pc"])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"draws": 0}, "draws: expected a whole number"),
        ({"draws": 2, "seed": -1}, "seed: expected a whole number"),
        ({"draws": 2, "group": "Monday"}, "group: expected one of"),
    ],
)
def test_what_does_not_fit_is_refused(settings: dict[str, Any], message: str):
    with pytest.raises(MatchError, match=message):
        posterior_draws(fit(), **settings)
