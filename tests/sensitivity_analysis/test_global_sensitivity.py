"""Global analyses of a twin, on a short recording made by the twin itself."""

import jax.numpy as jnp
import numpy as np
import pandas
import pytest
import xarray
from jaxtyping import Array
from small_results import COVARIANCE, correlated_fit, fit, recordings

import jaxtwin as jt
from jaxtwin import Experiment, Twin
from jaxtwin.errors import ParameterError, SimulationError
from jaxtwin.sensitivity_analysis import (
    GlobalSensitivity,
    LogNormal,
    Normal,
    Sobol,
    StandardisedRegression,
    Uniform,
)
from jaxtwin.sensitivity_analysis._inputs import resolve_inputs

NAMES = ["R_E", "R_pc", "R_Tez"]
TIMES = [10.0, 50.0, 100.0]


def rise(trajectory: Array) -> Array:
    """Of both channels, at their last sample."""
    return trajectory[-1] - trajectory[0]


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("paper-2024")


@pytest.fixture(scope="module")
def recording(twin: Twin) -> Experiment:
    drive = Experiment.schedule("0:0.8", duration=100, step=2.0, cells=2, channels=("T11", "TAM"))
    run = jt.simulate(twin.with_values({"R_E": 1.5}), drive)
    return Experiment(
        drive.time, drive.duty, channels=run.channels, temperatures=run.temperatures, name="made"
    )


@pytest.fixture(scope="module")
def result(twin: Twin, recording: Experiment) -> GlobalSensitivity:
    return jt.global_sensitivity(
        twin, recording, method=Sobol(second_order=True), draws=16, seed=5, names=NAMES,
        outputs={
            "cost": "cost", "uniformity": "uniformity", "plate_std": "plate_std",
            "temperature": "temperature", "rise": rise,
        },
        times=TIMES,
    )  # fmt: skip


@pytest.mark.slow
def test_all_outputs_are_those_of_single_runs(
    twin: Twin, recording: Experiment, result: GlobalSensitivity
):
    assert result.labels == (
        "cost T11", "cost TAM", "uniformity", "plate_std",
        *(f"temperature {channel} at {time:g} s" for channel in ("T11", "TAM") for time in TIMES),
        "rise[0]", "rise[1]", "cost mean",
    )  # fmt: skip
    assert recording.temperatures is not None
    assert len(result.samples) == 16 * 8
    for run in (0, 77):
        values = dict(zip(NAMES, result.samples[run], strict=True))
        single = jt.simulate(twin.with_values(values), recording)
        there = single.temperatures
        cost = np.mean((there - recording.temperatures) ** 2, axis=0)
        at = [there[np.searchsorted(recording.time, TIMES), column] for column in (0, 1)]
        ends = [*cost, np.ptp(there, axis=1).mean(), *at[0], *at[1], *(there[-1] - there[0])]
        found = np.delete(result.values[run], 3)
        np.testing.assert_allclose(found, [*ends, cost.mean()], rtol=1e-5)
    assert not result.failed.any()
    assert (result.counted == 16).all()


@pytest.mark.slow
@pytest.mark.salib
def test_indices_are_salibs_on_the_same_runs(result: GlobalSensitivity):
    from SALib.analyze import sobol as analyser

    for row in (0, 4, len(result.outputs) - 1):
        theirs = analyser.analyze(result.problem, result.values[:, row], seed=5)
        for name in ("S1", "S1_conf", "ST", "ST_conf", "S2", "S2_conf"):
            np.testing.assert_allclose(result[name][row], theirs[name], atol=1e-4)


def test_the_table_has_a_row_for_each_output_and_parameter(result: GlobalSensitivity):
    table = result.to_dataframe()
    assert table.shape == (len(result.outputs) * 3, 4)
    assert list(table.columns) == ["S1", "S1_conf", "ST", "ST_conf"]
    assert table.loc[("cost TAM", "R_pc"), "ST"] == result["ST"][1, 1]
    pairs = result.pairs_to_dataframe()
    assert pairs.loc[("cost T11", "R_E", "R_Tez"), "S2"] == result["S2"][0, 0, 2]
    assert isinstance(pairs, pandas.DataFrame)
    assert len(pairs) == len(table)


def test_the_strongest_comes_first(result: GlobalSensitivity):
    assert result.ranking()[0] == NAMES[result["ST"][-1].argmax()]
    assert result.ranking("rise[1]")[0] == NAMES[result["ST"][result.row("rise[1]")].argmax()]
    with pytest.raises(ParameterError, match=r"expected one of cost T11.*got 'T11'"):
        result.ranking("T11")
    with pytest.raises(ParameterError, match=r"expected one of S1.*got 'mu'"):
        result["mu"]
    with pytest.raises(ParameterError, match="did you mean 'rise\\[1\\]'"):
        result.ranking("rsie[1]")
    with pytest.raises(ParameterError, match="did you mean 'S1_conf'"):
        result["S1conf"]


def test_labels_and_saved_file(result: GlobalSensitivity, tmp_path):
    result.save(tmp_path / "s.nc")
    with xarray.open_dataset(tmp_path / "s.nc", engine="scipy") as saved:
        np.testing.assert_array_equal(saved["ST"].values, result["ST"])
        assert saved.sizes["run"] == 128
        assert saved["time"].values[5] == 50.0
    numbers = result.to_dict()
    assert numbers["indices"]["S2"]["cost T11"][2] == [None] * 3
    assert numbers["ranking"] == list(result.ranking())
    assert "128 runs, 13 outputs, strongest" in repr(result)
    assert "cost mean" in result._repr_html_()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_numbers(twin: Twin, recording: Experiment):
    options = {"method": "morris", "draws": 5, "names": NAMES}
    first, again, other = (
        jt.global_sensitivity(twin, recording, seed=seed, **options) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first["mu_star"], again["mu_star"])
    assert not np.array_equal(first.samples, other.samples)


@pytest.mark.slow
def test_a_start_value_has_no_index_and_a_failed_draw_spoils_its_block_alone(
    twin: Twin, recording: Experiment
):
    """A part of the range of a resistance is below 0; the first sample is the start."""
    inputs = {"R_E": Uniform(1.0, 3.0), "R_Tfx1": Uniform(-0.05, 1.0)}
    found = jt.global_sensitivity(
        twin, recording, method="sobol", draws=64, inputs=inputs,
        outputs=["temperature"], times=[0.0, 100.0],
    )  # fmt: skip
    is_bad = found.samples[:, 1] <= 0
    np.testing.assert_array_equal(found.failed, is_bad)
    blocks = is_bad.reshape(64, 4).any(axis=1)
    assert 0 < blocks.sum() < 20
    assert (found.counted == 64 - blocks.sum()).all()
    assert f"({blocks.sum()} of 64 blocks of runs incomplete, left out)" in repr(found)
    starts = [row for row, output in enumerate(found.outputs) if output.time == 0]
    assert np.isnan(found["ST"][starts]).all()
    assert np.isfinite(np.delete(found["ST"], starts, axis=0)).all()


@pytest.mark.slow
def test_pearson_of_the_papers_draws_is_the_papers(twin: Twin, recording: Experiment):
    papers = jt.sensitivity(twin, recording, draws=40, seed=3, names=NAMES)
    found = jt.global_sensitivity(twin, recording, method="pearson", draws=40, seed=3, names=NAMES)
    np.testing.assert_allclose(found.samples, papers.samples, rtol=1e-12)
    np.testing.assert_allclose(found["pearson"], papers.correlation, rtol=1e-8)
    np.testing.assert_allclose(found["pearson_low"], papers.interval[..., 0], rtol=1e-6)
    spearman = jt.global_sensitivity(
        twin, recording, method="spearman", draws=40, seed=3, names=NAMES
    )
    np.testing.assert_allclose(spearman["spearman"], papers.rank_correlation, rtol=1e-8)


@pytest.mark.slow
def test_derivatives_are_those_of_the_outputs(twin: Twin, recording: Experiment):
    """Bounds from derivatives and from differences along each parameter."""
    options = {"names": NAMES, "outputs": ["final", "cost"], "seed": 2}
    found = jt.global_sensitivity(twin, recording, method="dgsm", draws=8, **options)
    step = 1e-4
    squares = []
    for column, name in enumerate(NAMES):
        ends = []
        for sign in (-1, 1):
            draws = {other: found.samples[:, j] for j, other in enumerate(NAMES)}
            draws[name] = draws[name] * (1 + sign * step)
            reduced = jt.reduce_batch(twin, recording, draws, ["final", "cost"])
            columns = [reduced["final"], reduced["cost"], reduced["cost"].mean(axis=1)[:, None]]
            ends.append(np.concatenate(columns, axis=1))
        difference = (ends[1] - ends[0]) / (2 * step * found.samples[:, [column]])
        squares.append(np.mean(difference**2, axis=0))
    np.testing.assert_allclose(found["vi"], np.stack(squares, axis=1), rtol=1e-3)
    # Of a normal parameter cut off at 0, the bound has its standard deviation before that.
    deviation = 0.25 * np.array([twin.values[name] for name in NAMES])
    expected = found["vi"] * deviation**2 / found.values.var(axis=0)[:, None]
    np.testing.assert_allclose(found["dgsm"], expected, rtol=1e-9)


@pytest.mark.slow
def test_a_twin_of_each_recording_has_the_same_relative_draws():
    twins = list(fit().twins.values())
    other = [twins[0], twins[1].with_values({"R_E": 2 * float(twins[1].values["R_E"])})]
    found = jt.global_sensitivity(
        other, recordings(), method="oat", names=["R_E", "R_pc"], outputs=["final"]
    )
    assert found.labels[0] == "final T11 (synthetic-A)"
    middle = jt.simulate(other[1].with_values({}), recordings()[1]).temperatures[-1]
    np.testing.assert_allclose(found.values[0, len(middle) :], middle, rtol=1e-4)


@pytest.mark.slow
def test_the_posterior_of_a_fit_is_drawn_with_its_correlation():
    known = correlated_fit()
    inputs = resolve_inputs("posterior", known, known.twin, None, 0.25)
    assert inputs.names == ("R_E", "R_pc")
    logarithms = np.log(StandardisedRegression().design(inputs, 4096, 0, "sobol").samples)
    np.testing.assert_allclose(np.cov(logarithms, rowvar=False), COVARIANCE, rtol=0.02)
    middle = [np.log(known.twin.values[name]) for name in inputs.names]
    np.testing.assert_allclose(logarithms.mean(axis=0), middle, atol=1e-3)
    (single,) = resolve_inputs("posterior", known, known.twin, ["R_pc"], 0.25).names
    assert single == "R_pc"
    with pytest.raises(ParameterError, match="expected some of R_E, R_pc, got R_Th"):
        resolve_inputs("posterior", known, known.twin, ["R_Th"], 0.25)
    with pytest.raises(ParameterError, match="independent"):
        jt.global_sensitivity(known, method="sobol", inputs="posterior")
    with pytest.raises(ParameterError, match="expected a fit, got a twin"):
        jt.global_sensitivity(known.twin, recordings()[0], method="shapley", inputs="posterior")


@pytest.mark.slow
def test_shapley_effects_of_a_posterior_are_those_of_its_covariance():
    """Of b1 ln R_E + b2 ln R_pc: the closed form of Song and others 2016 for two correlated normal
    variables. The effects of any output sum to 1."""
    known = correlated_fit()
    s1, s2, r = 0.2, 0.1, 0.8
    b1, b2 = 1.0, 3.0

    def logarithms(draws: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {"sum": b1 * np.log(draws["R_E"]) + b2 * np.log(draws["R_pc"])}

    options = {"method": "shapley", "inputs": "posterior", "seed": 4}
    found = jt.global_sensitivity(known, model=logarithms, draws=16_000, **options)
    assert found.names == ("R_E", "R_pc")
    first, second, both = (b1 * s1) ** 2, (b2 * s2) ** 2, r * b1 * b2 * s1 * s2
    one = first * (1 - r**2 / 2) + both + second * r**2 / 2
    np.testing.assert_allclose(found["Sh"][0, 0], one / (first + second + 2 * both), atol=0.02)
    np.testing.assert_allclose(found["Sh"].sum(axis=1), 1.0, rtol=1e-12)
    drawn = np.cov(np.log(found.samples), rowvar=False)
    np.testing.assert_allclose(drawn, COVARIANCE, rtol=0.05)
    simulated = jt.global_sensitivity(known, outputs=["cost", "final"], draws=32, **options)
    np.testing.assert_allclose(simulated["Sh"].sum(axis=1), 1.0, rtol=1e-9)


@pytest.mark.slow
def test_partial_rank_correlations_of_a_posterior_are_those_of_its_draws():
    """By the inverse of the correlation of the ranks, of which the method makes no use."""
    known = correlated_fit()
    found = jt.global_sensitivity(
        known, method="prcc", inputs="posterior", outputs=["final"], draws=512, seed=4
    )
    np.testing.assert_allclose(np.cov(np.log(found.samples), rowvar=False), COVARIANCE, rtol=0.05)
    for row, values in enumerate(found.values.T):
        ranks = np.column_stack([found.samples, values]).argsort(axis=0).argsort(axis=0)
        inverse = np.linalg.inv(np.corrcoef(ranks, rowvar=False))
        expected = -inverse[:2, 2] / np.sqrt(np.diag(inverse)[:2] * inverse[2, 2])
        np.testing.assert_allclose(found["PRCC"][row], expected, atol=1e-9)


@pytest.mark.slow
def test_energy_and_peak_power_are_outputs():
    """Of a resistive heater by hand: V^2 / R for 40 % of 20 s, and 80 % of 10 s."""
    drive = Experiment.schedule("0:0.4,20:0.8", duration=30, cells=1, name="heated")
    found = jt.global_sensitivity(
        Twin("printer-bed"), drive, method="sobol", draws=64, names=["R_tracks", "R_pc"],
        outputs=["energy", "peak_power"], seed=1,
    )  # fmt: skip
    assert found.labels == ("energy", "peak_power")
    assert [output.unit for output in found.outputs] == ["J", "W"]
    power = 12.0**2 / (found.samples[:, 0] + 0.01 + 0.05)
    np.testing.assert_allclose(found.values, np.outer(power, [16.0, 0.8]), rtol=1e-9)
    # A contact does not change what a resistance draws.
    np.testing.assert_allclose(found["ST"][:, 1], 0.0, atol=1e-12)
    assert np.all(found["ST"][:, 0] > 0.5)


@pytest.mark.slow
def test_priors_are_those_of_the_rig():
    drive = Experiment.schedule("0:0.5", duration=20, step=2.0, cells=2, channels=("T11",))
    twin = Twin("dual-cell")
    rows = twin.rig.parameters
    names = [name for name, row in rows.items() if row.free and row.standard_deviation is not None][
        :3
    ]
    found = jt.global_sensitivity(
        twin, drive, method="oat", inputs="priors", names=names, outputs=["final"]
    )
    for name, marginal in found.design.inputs.marginals.items():
        deviation = rows[name].standard_deviation
        assert isinstance(marginal, LogNormal if rows[name].is_logarithmic else Normal)
        assert deviation == (
            marginal.spread if isinstance(marginal, LogNormal) else marginal.std  # pyright: ignore
        )
    with pytest.raises(ParameterError, match="expected priors in the rig file"):
        jt.global_sensitivity(
            Twin("paper-2024"), drive, method="oat", inputs="priors", outputs=["final"]
        )


@pytest.mark.slow
def test_bounds_are_those_of_the_rig(twin: Twin, recording: Experiment):
    found = jt.global_sensitivity(
        twin, recording, method="oat", inputs="bounds", names=["R_pc"], outputs=["final"]
    )
    assert found.problem["bounds"] == [[2e-6, 2.0]]
    assert found.problem["dists"] == ["unif"]
    with pytest.raises(ParameterError, match="alpha: expected two bounds"):
        jt.global_sensitivity(twin, recording, method="oat", inputs="bounds", names=["alpha"])


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"method": "sobol", "outputs": []}, SimulationError, "got none"),
        ({"method": "sobol", "draws": 100}, SimulationError, "64 or 128"),
        ({"method": "morris", "draws": 2}, SimulationError, "at least 3"),
        ({"method": "oat", "inputs": {"R_X": Uniform(0.0, 1.0)}}, ParameterError, "R_X"),
        ({"method": "oat", "times": [1e6]}, SimulationError, "some from 0 to 100 s"),
        ({"method": "dgsm", "outputs": ["plate_std"]}, SimulationError, "derivatives"),
    ],
)
def test_bad_requests_say_what_is_allowed(twin, recording, options, error, words):
    with pytest.raises(error, match=words):
        jt.global_sensitivity(twin, recording, **{"names": NAMES, "draws": 8, **options})


@pytest.mark.slow
def test_a_users_function_of_a_trajectory(twin: Twin, recording: Experiment):
    """A settling time, NaN where it is not reached, spoils that output alone."""

    def reaches(trajectory: Array) -> Array:
        is_hot = trajectory[:, 1] > 30.0
        return jnp.where(is_hot.any(), 2.0 * jnp.argmax(is_hot), jnp.nan)

    found = jt.global_sensitivity(
        twin, recording, method="src", draws=64, names=["R_E"],
        outputs={"final": "final", "settling": reaches},
    )  # fmt: skip
    hot = found.values[:, 1] > 30.0
    assert 0 < np.isnan(found.values[:, 2]).sum() < 64
    assert (np.isnan(found.values[:, 2]) <= ~hot).all()
    assert found.counted.tolist() == [64, 64, int(np.isfinite(found.values[:, 2]).sum())]
