"""Draws: reproducible part by part, with the distribution that the paper states."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest, truncnorm

from jaxtwin.sensitivity_analysis import normal_draws

VALUES = {"R_E": 2.0, "R_pc": 0.3}


@given(start=st.integers(0, 3000), length=st.integers(1, 1500))
def test_a_part_is_the_same_as_that_part_of_the_whole(start: int, length: int):
    whole = normal_draws(VALUES, 0.25, seed=7, stop=4500)
    part = normal_draws(VALUES, 0.25, seed=7, stop=start + length, start=start)
    for name, values in part.items():
        np.testing.assert_array_equal(values, whole[name][start : start + length])


def test_draws_follow_the_truncated_normal_distribution():
    draws = normal_draws({"R_E": 2.0}, 0.5, seed=3, stop=20_000)["R_E"]
    # Mean 2, standard deviation 1, cut off at 0.
    assert kstest(draws, truncnorm(-2, np.inf, loc=2.0, scale=1.0).cdf).pvalue > 0.01
    assert draws.min() > 0


def test_parameters_are_drawn_independently():
    draws = normal_draws(VALUES, 0.25, seed=0, stop=20_000)
    # Three standard errors of a correlation of zero.
    assert abs(np.corrcoef(draws["R_E"], draws["R_pc"])[0, 1]) < 3 / np.sqrt(20_000)


def test_seeds_differ():
    first, second = (normal_draws(VALUES, 0.25, seed=seed, stop=5)["R_E"] for seed in (0, 1))
    assert not np.any(first == second)


def test_a_negative_value_stays_negative():
    assert normal_draws({"x": -3.0}, 0.9, seed=0, stop=5000)["x"].max() < 0


@pytest.mark.parametrize("seed", [0, 2**63])
def test_any_seed_gives_finite_draws(seed: int):
    assert np.isfinite(normal_draws(VALUES, 0.25, seed, 100)["R_pc"]).all()
