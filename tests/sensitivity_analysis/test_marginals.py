"""Distributions of parameters."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.stats import lognorm, norm, truncnorm, uniform

from jaxtwin.errors import ParameterError
from jaxtwin.sensitivity_analysis import AbstractMarginal, LogNormal, Normal, Uniform, normal_draws
from jaxtwin.sensitivity_analysis._sampling import uniform_draws

PAIRS = {
    "normal": (Normal(2.0, 0.5), norm(2.0, 0.5)),
    "cut off": (Normal(2.0, 1.0, 0.0, 3.0), truncnorm(-2, 1, loc=2.0, scale=1.0)),
    "uniform": (Uniform(-1.0, 3.0), uniform(-1.0, 4.0)),
    "log-normal": (LogNormal(2.0, 0.4), lognorm(0.4, scale=2.0)),
}


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
def test_quantiles_are_scipys(pair):
    ours, theirs = pair
    probability = np.linspace(0.001, 0.999, 50)
    np.testing.assert_allclose(ours.quantile(probability), theirs.ppf(probability), rtol=1e-10)


@given(st.floats(0, 1))
@example(0.0)
@example(1.0)
def test_every_probability_has_a_finite_quantile_inside_the_limits(probability: float):
    u = np.array([probability])
    for marginal, _ in PAIRS.values():
        assert np.isfinite(marginal.quantile(u)).all()
    assert 0.0 <= Normal(2.0, 1.0, 0.0, 3.0).quantile(u)[0] <= 3.0 + 1e-12


def test_a_normal_distribution_cut_off_at_0_gives_the_papers_draws():
    unit = uniform_draws(2, 5, 300)
    drawn = normal_draws({"R_E": 2.0, "R_pc": 0.3}, 0.25, 5, 300)
    for column, (name, value) in enumerate({"R_E": 2.0, "R_pc": 0.3}.items()):
        ours = Normal(value, 0.25 * value, low=0.0).quantile(unit[:, column])
        np.testing.assert_allclose(ours, drawn[name], rtol=1e-12)


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
def test_poincares_inequality_holds_for_the_identity(pair):
    """Equal for a normal distribution that is not cut off."""
    marginal, theirs = pair
    u = (np.arange(20_000) + 0.5) / 20_000
    values = marginal.quantile(u)
    bound = np.mean(marginal.poincare_weight(values) ** 2)
    assert theirs.var() <= bound * (1 + 1e-9)
    assert bound < 2 * theirs.var()


@pytest.mark.parametrize(
    "make",
    [
        lambda: Normal(1.0, 0.0),
        lambda: Normal(math.nan, 1.0),
        lambda: Normal(0.0, 1.0, 2.0, 1.0),
        lambda: Uniform(1.0, 1.0),
        lambda: Uniform(0.0, math.inf),
        lambda: LogNormal(0.0, 1.0),
        lambda: LogNormal(1.0, -1.0),
    ],
)
def test_what_is_no_distribution_is_refused(make):
    with pytest.raises(ParameterError, match="expected"):
        make()


def test_salib_knows_their_names():
    problems: dict[AbstractMarginal, str] = {
        Normal(2.0, 0.5): "norm", Normal(2.0, 0.5, low=0.0): "truncnorm",
        Uniform(0.0, 1.0): "unif", LogNormal(2.0, 0.5): "lognorm",
    }  # fmt: skip
    for marginal, name in problems.items():
        kind, numbers = marginal.to_salib()
        assert kind == name
        assert np.isfinite(numbers).all()
