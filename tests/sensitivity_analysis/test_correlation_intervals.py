"""95 % intervals of correlations: against SciPy's bootstrap where variables are normal, and by how
often they hold a correlation that is known where one has heavy tails."""

import numpy as np
import pytest
from scipy.stats import bootstrap, pearsonr, rankdata, spearmanr

from jaxtwin.sensitivity_analysis import pearson, pearson_interval, spearman_interval


@pytest.mark.parametrize(
    ("ours", "theirs"), [(pearson_interval, pearsonr), (spearman_interval, spearmanr)]
)
@pytest.mark.parametrize("bent", [False, True])
def test_lengths_are_those_of_scipys_bias_corrected_and_accelerated_bootstrap(ours, theirs, bent):
    """On light tails; `bent` is a dependence that is not monotonic, on which the influence of a
    draw on the others' ranks counts. Pearson's interval also has its trend and may be longer."""
    rng = np.random.default_rng(2)
    x = rng.standard_normal(300)
    y = (np.abs(x + 0.7) if bent else 0.6 * x) + 0.8 * rng.standard_normal(300)
    low, high = ours(y[:, None], x[:, None])[0, 0]

    def statistic(x, y, axis):
        if theirs is spearmanr:
            x, y = rankdata(x, axis=axis), rankdata(y, axis=axis)
        x, y = x - x.mean(axis, keepdims=True), y - y.mean(axis, keepdims=True)
        return (x * y).sum(axis) / np.sqrt((x**2).sum(axis) * (y**2).sum(axis))

    expected = bootstrap(
        (x, y), statistic, paired=True, vectorized=True, n_resamples=2000, rng=rng, method="BCa"
    ).confidence_interval
    length = expected.high - expected.low
    assert (low, high) == pytest.approx((expected.low, expected.high), abs=0.25 * length)
    assert 0.9 < (high - low) / length < (1.1 if theirs is spearmanr else 1.3)


@pytest.mark.slow
@pytest.mark.parametrize(("spread", "share"), [(0.5, 0.7), (1.0, 0.3), (1.0, 0.7)])
def test_heavy_tails_are_covered_as_promised(spread, share):
    """exp(s (a x + b e)) with normal x and e, a² + b² = 1: its correlation with x is
    a s / sqrt(exp(s²) - 1), that of the ranks 6 / pi arcsin(a / 2). Of 200 samples of 500 draws,
    95 % +- 3 standard errors, 4.6 %, must hold them."""
    rng = np.random.default_rng(11)
    x, e = rng.standard_normal((2, 500, 200))
    y = np.exp(spread * (share * x + np.sqrt(1 - share**2) * e))
    truth = share * spread / np.sqrt(np.expm1(spread**2))
    rank_truth = 6 / np.pi * np.arcsin(share / 2)
    inside = np.zeros((2, 200), dtype=bool)
    for number in range(200):
        sample = y[:, [number]], x[:, [number]]
        for row, (interval, value) in enumerate(
            ((pearson_interval, truth), (spearman_interval, rank_truth))
        ):
            low, high = interval(*sample)[0, 0]
            inside[row, number] = low <= value <= high
    assert (np.abs(inside.mean(axis=1) - 0.95) < 0.046).all()


def test_few_draws_leave_an_honest_interval():
    """Below four draws anything may be; of 400 independent normal pairs of twelve draws, 95 % +- 3
    standard errors, 3.3 %, must hold 0."""
    y, x = np.random.default_rng(3).standard_normal((2, 400, 12, 1))
    for interval in (pearson_interval, spearman_interval):
        assert interval(y[0, :3], x[0, :3]).tolist() == [[[-1.0, 1.0]]]
        low, high = np.array([interval(*pair)[0, 0] for pair in zip(y, x, strict=True)]).T
        assert np.mean((low <= 0) & (high >= 0)) == pytest.approx(0.95, abs=0.033)


def test_the_correlation_with_a_constant_has_the_interval_from_minus_1_to_1():
    for interval in (pearson_interval, spearman_interval):
        assert interval(np.full((9, 1), 0.1), np.arange(9.0)[:, None]).tolist() == [[[-1.0, 1.0]]]


def test_the_interval_holds_the_correlation_itself():
    """Also where it is 1, and in the order low, high."""
    rng = np.random.default_rng(4)
    x = rng.standard_normal((60, 2))
    y = np.column_stack([3 * x[:, 0], np.exp(2 * x[:, 1])])
    low, high = np.moveaxis(pearson_interval(y, x), -1, 0)
    index = pearson(y, x)
    assert ((low <= index + 1e-9) & (index - 1e-9 <= high) & (low <= high)).all()
    assert low[0, 0] == pytest.approx(1.0, abs=1e-6)
