"""Draws of what a match leaves open have its mean, its covariance and its bounds."""

from typing import Any

import numpy as np
import pytest
from small_results import fit, recordings

from jaxtwin import match
from jaxtwin.errors import MatchError
from jaxtwin.matching import posterior_draws


@pytest.mark.slow
def test_draws_have_the_spread_of_the_match():
    """That of the shared parameters, with what differs between recordings; all are logarithms. A
    minute says something of the plate's resistance and nothing of the heat exchanger's mass."""
    twin = fit().twin
    matched = match(twin, recordings(), free=["R_Tez", "C_esp", "T_amb"], max_iterations=15)
    draws = posterior_draws(matched, 4000, seed=1)
    assert set(draws) == {"R_Tez", "C_esp"}  # the room's temperature belongs to a recording
    place = matched.uncertainty.labels.index("R_Tez")
    variance = (
        matched.uncertainty.vector_covariance[place, place]
        + matched.uncertainty.between_recordings[place] ** 2
    )
    logarithms = np.log(draws["R_Tez"])
    centre = np.log(matched["R_Tez"].value)
    assert logarithms.mean() == pytest.approx(centre, abs=4 * np.sqrt(variance / 4000))
    assert logarithms.std() == pytest.approx(np.sqrt(variance), rel=0.05)
    for name, values in draws.items():
        assert np.all((matched[name].lower <= values) & (values <= matched[name].upper))
    again = posterior_draws(matched, 4000, seed=1)
    np.testing.assert_array_equal(again["R_Tez"], draws["R_Tez"])
    assert not np.array_equal(posterior_draws(matched, 4000, seed=2)["R_Tez"], draws["R_Tez"])


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
