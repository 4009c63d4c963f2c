"""Methods of global analysis on functions whose indices are known by hand, and beside SALib."""

import math

import numpy as np
import pytest
from scipy.stats import rankdata

from jaxtwin.errors import ParameterError, SimulationError
from jaxtwin.sensitivity_analysis import (
    AbstractMethod,
    DerivativeBased,
    Design,
    Inputs,
    LogNormal,
    Morris,
    Normal,
    OneAtATime,
    PartialRankCorrelation,
    Pearson,
    PolynomialChaos,
    Shapley,
    Sobol,
    Spearman,
    StandardisedRegression,
    Uniform,
    indices_of,
    pearson,
    pearson_interval,
)

ANGLES = Inputs({name: Uniform(-math.pi, math.pi) for name in ("x1", "x2", "x3")})
STANDARD = Inputs({name: Normal(0.0, 1.0) for name in ("x1", "x2", "x3")})
SQUARE = Inputs({name: Uniform(-1.0, 1.0) for name in ("x1", "x2", "x3")})


def ishigami(x: np.ndarray) -> np.ndarray:
    x1, x2, x3 = x.T
    return np.sin(x1) + 7 * np.sin(x2) ** 2 + 0.1 * x3**4 * np.sin(x1)


def ishigami_indices() -> tuple[np.ndarray, np.ndarray]:
    """First and total order, Ishigami and Homma 1990."""
    a, b = 7.0, 0.1
    first = 0.5 * (1 + b * math.pi**4 / 5) ** 2
    second = a**2 / 8
    third = b**2 * math.pi**8 * (1 / 18 - 1 / 50)
    both = np.array([[first, second, 0.0], [first + third, second, third]])
    return tuple(both / (first + second + third))


def linear(x: np.ndarray) -> np.ndarray:
    return x @ np.array([3.0, -2.0, 1.0])


def analysed(
    method: AbstractMethod, inputs: Inputs, function=ishigami, draws: int | None = None, seed=3
) -> tuple[dict[str, np.ndarray], Design]:
    """Indices of the function, and of a second output beside it, which are left out here."""
    draws = method.default_draws if draws is None else draws
    design = method.design(inputs, draws, seed, method.default_samples)
    outputs = np.column_stack([function(design.samples), design.samples[:, 0]])
    slopes = None
    if method.needs_slopes:
        steps = 1e-6 * np.eye(len(inputs.names))
        slopes = np.stack(
            [
                (function(design.samples + step) - function(design.samples - step)) / 2e-6
                for step in steps
            ],
            axis=-1,
        )
        slopes = np.stack([slopes, np.tile(np.eye(len(inputs.names))[0], (len(slopes), 1))], axis=1)
    found, _ = indices_of(method, design, outputs, slopes, seed)
    return {name: values[0] for name, values in found.items()}, design


def test_sobols_indices_of_ishigamis_function():
    found, _ = analysed(Sobol(second_order=True), ANGLES, draws=8192)
    first, total = ishigami_indices()
    np.testing.assert_allclose(found["S1"], first, atol=0.01)
    np.testing.assert_allclose(found["ST"], total, atol=0.01)
    # Its only interaction is that of the first and the third.
    assert found["S2"][0, 2] == pytest.approx(total[2], abs=0.01)
    assert np.abs(found["S2"][[0, 1], [1, 2]]).max() < 0.02
    assert np.isnan(found["S2"][np.tril_indices(3)]).all()
    # Sobol's sequence is better than its bootstrap says.
    for name, truth in (("S1", first), ("ST", total)):
        assert (np.abs(found[name] - truth) < found[f"{name}_conf"] + 1e-12).all()


@pytest.mark.salib
@pytest.mark.parametrize("second_order", [False, True])
def test_sobols_samples_and_indices_are_salibs(second_order: bool):
    from SALib.analyze import sobol as analyser
    from SALib.sample import sobol as sampler

    inputs = Inputs(
        {
            "a": Uniform(1.0, 4.0),
            "b": Normal(2.0, 0.5),
            "c": Normal(2.0, 1.0, low=0.0),
            "d": LogNormal(2.0, 0.3),
        }
    )
    method = Sobol(second_order=second_order)
    design = method.design(inputs, 64, 7, "sobol")
    theirs = sampler.sample(inputs.to_salib(), 64, calc_second_order=second_order, seed=7)
    np.testing.assert_allclose(design.samples, theirs, rtol=1e-9)
    outputs = np.exp(design.samples[:, :1]) * design.samples[:, 1:2] + design.samples[:, 2:] ** 2
    found, _ = indices_of(method, design, outputs, seed=7)
    names = ["S1", "S1_conf", "ST", "ST_conf"] + ["S2", "S2_conf"] * second_order
    assert set(found) == set(names)
    for output in range(2):
        expected = analyser.analyze(
            inputs.to_salib(), outputs[:, output], calc_second_order=second_order, seed=7
        )
        for name in names:
            np.testing.assert_allclose(found[name][output], expected[name], atol=1e-9)


@pytest.mark.salib
def test_elementary_effects_are_salibs():
    from SALib.analyze import morris as analyser

    method = Morris(levels=6)
    design = method.design(ANGLES, 30, 5, "random")
    outputs = ishigami(design.samples)
    found, _ = indices_of(method, design, outputs[:, None], seed=5)
    theirs = analyser.analyze(ANGLES.to_salib(), design.samples, outputs, num_levels=6, seed=1)
    for name in ("mu", "mu_star", "sigma"):
        np.testing.assert_allclose(found[name][0], theirs[name], atol=1e-9)
    # Resamples are others.
    np.testing.assert_allclose(found["mu_star_conf"][0], theirs["mu_star_conf"], rtol=0.3)


@pytest.mark.salib
def test_derivative_based_bounds_are_salibs():
    """SALib takes finite differences: here those of a function that is linear from each draw."""
    from SALib.analyze import dgsm as analyser

    method = DerivativeBased()
    design = method.design(ANGLES, 64, 5, "sobol")
    x = design.samples
    slopes = np.stack(
        [
            np.cos(x[:, 0]) * (1 + 0.1 * x[:, 2] ** 4),
            14 * np.sin(x[:, 1]) * np.cos(x[:, 1]),
            0.4 * x[:, 2] ** 3 * np.sin(x[:, 0]),
        ],
        axis=1,
    )
    found, _ = indices_of(method, design, ishigami(x)[:, None], slopes[:, None], seed=5)
    rows = np.repeat(x[:, None], 4, axis=1)
    values = np.repeat(ishigami(x)[:, None], 4, axis=1)
    for j in range(3):
        rows[:, j + 1, j] += 1.0
        values[:, j + 1] += slopes[:, j]
    theirs = analyser.analyze(ANGLES.to_salib(), rows.reshape(-1, 3), values.ravel(), seed=1)
    for name in ("vi", "vi_std", "dgsm"):
        np.testing.assert_allclose(found[name][0], theirs[name], rtol=1e-9)


def test_effects_of_a_linear_function_are_its_slopes():
    found, design = analysed(Morris(), SQUARE, linear, draws=5)
    # Over the whole range, which is 2.
    np.testing.assert_allclose(found["mu"], [6.0, -4.0, 2.0])
    np.testing.assert_allclose(found["mu_star"], [6.0, 4.0, 2.0])
    np.testing.assert_allclose(found["sigma"], 0.0, atol=1e-12)
    assert np.isin(np.round(3 * design.unit, 9), [0, 1, 2, 3]).all()
    moves = np.diff(design.unit.reshape(5, 4, 3), axis=1)
    assert (np.count_nonzero(moves, axis=2) == 1).all()
    assert (np.count_nonzero(moves, axis=1) == 1).all()


def test_the_samples_of_morris_lie_within_95_percent_of_a_normal_distribution():
    design = Morris().design(STANDARD, 20, 0, "random")
    assert np.abs(design.samples).max() == pytest.approx(1.959964, abs=1e-5)


def test_one_at_a_time_reaches_both_ends_of_each():
    found, design = analysed(OneAtATime(), SQUARE, lambda x: x[:, 0] ** 2 + 3 * x[:, 1], draws=1)
    assert len(design.unit) == 7
    np.testing.assert_allclose(found["low"], [0.9025, -2.85, 0.0], atol=1e-12)
    np.testing.assert_allclose(found["high"], [0.9025, 2.85, 0.0], atol=1e-12)
    np.testing.assert_allclose(found["swing"], [0.9025, 5.7, 0.0], atol=1e-12)


def test_regression_finds_a_linear_function():
    found, _ = analysed(StandardisedRegression(), STANDARD, linear, draws=400)
    np.testing.assert_allclose(found["SRC"], np.array([3, -2, 1]) / np.sqrt(14), atol=0.02)
    assert found["R2"] == pytest.approx(1.0)
    # A bootstrap of standardised coefficients, whose squares do not all vary.
    assert (found["SRC_conf"] < 0.1).all()


def test_partial_rank_correlations_are_those_of_residuals():
    method = PartialRankCorrelation()
    design = method.design(STANDARD, 200, 1, "random")
    outputs = np.exp(linear(design.samples)) + design.samples[:, 0] ** 2
    found, _ = indices_of(method, design, outputs[:, None])
    x, y = rankdata(design.samples, axis=0), rankdata(outputs)
    for j in range(3):
        others = np.column_stack([np.ones(200), np.delete(x, j, axis=1)])
        left = [
            column - others @ np.linalg.lstsq(others, column, rcond=None)[0]
            for column in (x[:, j], y)
        ]
        assert found["PRCC"][0, j] == pytest.approx(np.corrcoef(*left)[0, 1], abs=1e-9)


def test_correlations_are_those_of_the_functions():
    found, design = analysed(Pearson(), STANDARD, draws=300)
    outputs = ishigami(design.samples)[:, None]
    np.testing.assert_allclose(found["pearson"], pearson(outputs, design.samples)[0])
    low, high = pearson_interval(outputs, design.samples)[0].T
    np.testing.assert_allclose(found["pearson_low"], low)
    np.testing.assert_allclose(found["pearson_high"], high)
    assert set(analysed(Spearman(), STANDARD)[0]) == {"spearman", "spearman_low", "spearman_high"}


@pytest.mark.slow
def test_chaos_finds_ishigamis_indices_and_its_error():
    found, _ = analysed(PolynomialChaos(), ANGLES, draws=1024)
    first, total = ishigami_indices()
    assert found["loo_error"] < 1e-4
    np.testing.assert_allclose(found["S1"], first, atol=0.005)
    np.testing.assert_allclose(found["ST"], total, atol=0.005)
    assert found["S2"][0, 2] == pytest.approx(total[2], abs=0.005)


def test_chaos_of_a_polynomial_of_normal_parameters_is_exact():
    """x1 + x1 x2 + (x3^2 - 1): variances 1, 1 and 2."""
    found, _ = analysed(
        PolynomialChaos(),
        STANDARD,
        lambda x: x[:, 0] + x[:, 0] * x[:, 1] + x[:, 2] ** 2,
        draws=64,
    )
    np.testing.assert_allclose(found["S1"], [0.25, 0.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(found["ST"], [0.5, 0.25, 0.5], atol=1e-9)
    assert found["S2"][0, 1] == pytest.approx(0.25)
    assert found["loo_error"] == pytest.approx(0.0, abs=1e-9)


def test_chaos_says_where_it_does_not_hold():
    found, _ = analysed(PolynomialChaos(), ANGLES, lambda x: np.sin(20 * x[:, 0]), draws=64)
    assert found["loo_error"] > 0.5


def test_derivative_based_bounds_hold():
    found, _ = analysed(DerivativeBased(), ANGLES, draws=2048)
    assert (found["dgsm"] > ishigami_indices()[1]).all()
    # Exact where the function is linear in a normal parameter.
    found, _ = analysed(DerivativeBased(), STANDARD, linear, draws=2048)
    np.testing.assert_allclose(found["dgsm"], np.array([9, 4, 1]) / 14, rtol=0.01)


def test_shapley_effects_of_an_additive_function_are_its_first_indices():
    found, _ = analysed(Shapley(), STANDARD, linear, draws=4000)
    np.testing.assert_allclose(found["Sh"], np.array([9, 4, 1]) / 14, atol=0.03)
    assert found["Sh"].sum() == pytest.approx(1.0)


def test_shapley_effects_of_correlated_parameters():
    """Of x1 + x2 + x3, where the latter two have the correlation r: from Song and others 2016, the
    closed form for two correlated parameters with equal coefficients, 1 + r each."""
    r = 0.8
    correlation = np.array([[1, 0, 0], [0, 1, r], [0, r, 1]])
    inputs = Inputs(STANDARD.marginals, correlation)
    found, _ = analysed(Shapley(), inputs, lambda x: x.sum(axis=1), draws=4000)
    expected = np.array([1, 1 + r, 1 + r]) / (3 + 2 * r)
    np.testing.assert_allclose(found["Sh"], expected, atol=0.03)
    assert (np.abs(found["Sh"] - expected) < 2 * found["Sh_conf"]).all()
    # What does not act has a part through what does.
    found, _ = analysed(Shapley(), inputs, lambda x: x[:, 1], draws=4000)
    np.testing.assert_allclose(found["Sh"], [0.0, 1 - r**2 / 2, r**2 / 2], atol=0.03)


@pytest.mark.parametrize(
    "method", [Sobol(), Morris(), OneAtATime(), DerivativeBased(), PolynomialChaos()]
)
def test_correlated_parameters_are_refused_where_indices_have_no_meaning(method: AbstractMethod):
    inputs = Inputs(
        {"a": Normal(0.0, 1.0), "b": Normal(0.0, 1.0)}, np.array([[1.0, 0.5], [0.5, 1.0]])
    )
    with pytest.raises(ParameterError, match="independent parameters"):
        method.design(inputs, 8, 0, "random")
    with pytest.raises(ParameterError, match="SALib"):
        inputs.to_salib()


def test_correlated_samples_have_the_correlation():
    correlation = np.array([[1.0, -0.7], [-0.7, 1.0]])
    inputs = Inputs({"a": Normal(1.0, 2.0), "b": LogNormal(3.0, 0.2)}, correlation)
    samples = Pearson().design(inputs, 4096, 0, "sobol").samples
    found = np.corrcoef(samples[:, 0], np.log(samples[:, 1]))
    np.testing.assert_allclose(found, correlation, atol=0.01)


@pytest.mark.parametrize(
    "method",
    [Sobol(second_order=True), Morris(), Shapley(), Pearson(), StandardisedRegression()],
    ids=lambda method: method.name,
)
def test_a_failed_run_leaves_its_block_out_and_nothing_else(method: AbstractMethod):
    design = method.design(STANDARD, 32, 1, "random")
    good = np.column_stack([linear(design.samples), ishigami(design.samples)])
    spoiled = good.copy()
    spoiled[5 * design.block + design.block - 1, 1] = np.nan
    found, counted = indices_of(method, design, spoiled, seed=1)
    whole, _ = indices_of(method, design, good, seed=1)
    assert counted.tolist() == [32, 31]
    rest = np.delete(np.arange(32), 5)
    kept = design.of_blocks(np.arange(32) != 5)
    rows = (rest[:, None] * design.block + np.arange(design.block)).ravel()
    without, _ = indices_of(method, kept, good[rows], seed=1)
    for name, values in found.items():
        np.testing.assert_allclose(values[0], whole[name][0], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(values[1], without[name][1], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    "method",
    [
        Sobol(second_order=True), Morris(), OneAtATime(), Shapley(), Pearson(), Spearman(),
        StandardisedRegression(), PartialRankCorrelation(), PolynomialChaos(), DerivativeBased(),
    ],
    ids=lambda method: method.name,
)  # fmt: skip
def test_an_output_without_variance_has_no_index(method: AbstractMethod):
    design = method.design(STANDARD, 32, 1, "random")
    constant = 300.0 + 1e-13 * np.arange(len(design.unit))
    outputs = np.column_stack([linear(design.samples), constant, np.zeros(len(design.unit))])
    slopes = np.zeros((*outputs.shape, 3))
    slopes[:, 0] = [3.0, -2.0, 1.0]
    found, counted = indices_of(method, design, outputs, slopes, seed=1)
    for name, values in found.items():
        assert np.isnan(values[1:]).all(), name
        if name not in ("S2", "S2_conf"):
            assert np.isfinite(values[0]).all(), name
    assert (counted == design.blocks).all()


def test_indices_are_nan_where_all_runs_failed():
    design = Sobol().design(STANDARD, 8, 0, "sobol")
    found, counted = indices_of(Sobol(), design, np.full((len(design.unit), 1), np.nan))
    assert np.isnan(found["ST"]).all()
    assert counted.tolist() == [0]


def test_many_outputs_are_those_of_each_alone():
    design = Sobol().design(STANDARD, 16, 0, "sobol")
    outputs = linear(design.samples)[:, None] ** 2 + np.arange(70) * design.samples[:, :1]
    together, _ = indices_of(Sobol(), design, outputs)
    for column in (0, 63, 64, 69):
        alone, _ = indices_of(Sobol(), design, outputs[:, [column]])
        np.testing.assert_allclose(together["ST"][column], alone["ST"][0], rtol=1e-12)


def test_sobols_sequence_takes_powers_of_two():
    with pytest.raises(SimulationError, match=r"power of two.*64 or 128"):
        Sobol().design(STANDARD, 100, 0, "sobol")
    assert len(Sobol().design(STANDARD, 100, 0, "latin-hypercube").unit) == 500


@pytest.mark.parametrize("levels", [3, 0])
def test_levels_are_an_even_number(levels):
    with pytest.raises(SimulationError, match="levels"):
        Morris(levels)
