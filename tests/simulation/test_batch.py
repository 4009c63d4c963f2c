"""Many draws at once: the same as one by one, whatever the chunks, workers and precision."""

import diffrax
import numpy as np
import pytest

from jaxtwin import Experiment, JaxtwinError, Twin, load_rig, reduce_batch, simulate_batch
from jaxtwin.simulation import _draw_solver, build_time_grid
from jaxtwin.simulation._chunk_programs import prepare_chunk
from jaxtwin.simulation._compressed import compress
from jaxtwin.simulation._native_library import VARIABLE

TIME = np.arange(201.0)
DUTY = np.where(TIME < 100, 0.5, 0.78)[:, None] * np.ones(2)
DRAWS = {"R_E": np.array([1.7, 1.9, 2.4, 2.0, 1.8]), "R_ph": np.array([6.9e-5, 0.1, 0.6, 1.0, 0.3])}

# The largest difference to a single run, which takes other steps, K.
NEAR = 1e-4
ALL = ("cost", "final", "minimum", "maximum", "plate_range", "plate_std")


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin(load_rig("paper-2024"))


@pytest.fixture(scope="module")
def dual_cell() -> Twin:
    return Twin("dual-cell")


@pytest.fixture(scope="module")
def experiment(twin) -> Experiment:
    """With noise about what the twin itself does, so that there is a cost."""
    run = twin.simulate(Experiment(TIME, DUTY))
    noise = np.random.default_rng(0).normal(0, 0.1, run.temperatures.shape)
    return Experiment(TIME, DUTY, channels=run.channels, temperatures=run.temperatures + noise)


@pytest.fixture(scope="module")
def runs(twin, experiment):
    """One by one."""
    return [
        twin.with_values({name: values[k] for name, values in DRAWS.items()}).simulate(experiment)
        for k in range(5)
    ]


@pytest.fixture(scope="module")
def whole(twin, experiment):
    return simulate_batch(twin, experiment, DRAWS, chunk_size=2, workers=2)


def given(reduction: np.ndarray | None) -> np.ndarray:
    assert reduction is not None
    return reduction


def test_draws_are_what_single_runs_are(runs, whole):
    np.testing.assert_allclose(whole, [run.temperatures for run in runs], atol=NEAR)


@pytest.mark.slow
def test_reductions_are_those_of_the_whole_trajectories(twin, experiment, runs, whole):
    """Costs too, which the engine finds without the samples."""
    reduced = reduce_batch(twin, experiment, DRAWS, ALL, chunk_size=2)
    error = np.mean((whole - experiment.temperatures) ** 2, axis=1)
    np.testing.assert_allclose(given(reduced.cost), error, rtol=1e-9)
    np.testing.assert_allclose(given(reduced.final), whole[:, -1], atol=1e-9)
    np.testing.assert_allclose(given(reduced.minimum), whole.min(axis=1), atol=1e-9)
    np.testing.assert_allclose(given(reduced.maximum), whole.max(axis=1), atol=1e-9)
    plates = np.stack([run.states[-1, : len(twin.wiring.rig_elements)] for run in runs])
    np.testing.assert_allclose(given(reduced.plate_range), np.ptp(plates, axis=1), atol=NEAR)
    np.testing.assert_allclose(given(reduced.plate_std), plates.std(axis=1), atol=NEAR)
    assert not reduced.failed.any()
    assert set(reduced) == set(ALL)


@pytest.mark.slow
def test_a_chunk_of_another_size_gives_the_same(twin, experiment, whole):
    one_by_one = simulate_batch(twin, experiment, DRAWS, chunk_size=3, workers=1)
    np.testing.assert_allclose(one_by_one, whole, atol=1e-9)


@pytest.mark.slow
def test_float32_is_good_to_a_few_millikelvin_also_where_the_circuit_is_stiff(
    twin, experiment, whole
):
    """R_ph = 6.9e-5 K/W: rates from 1e-3 to 1e3 per second, which float32 alone cannot part."""
    single = simulate_batch(twin, experiment, DRAWS, precision="float32", chunk_size=2)
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, whole, atol=3e-3)


@pytest.mark.long
def test_losses_in_float32_change_a_batch_by_less_than_ten_microkelvin(dual_cell, monkeypatch):
    monkeypatch.setenv(VARIABLE, "off")  # so that both take the same steps
    # Single runs compute all losses in float64. Draws from thick still air to a strong draught.
    draws = {name: np.array([0.5, 1.0, 2.0]) * dual_cell.values[name] for name in ("h_A", "n_film")}
    batch = simulate_batch(dual_cell, Experiment(TIME, DUTY), draws)
    for k, temperatures in enumerate(batch):
        one = dual_cell.with_values({name: values[k] for name, values in draws.items()})
        assert np.abs(temperatures - one.simulate(Experiment(TIME, DUTY)).temperatures).max() < 1e-5


def test_a_failed_draw_leaves_the_others_alone(twin, experiment, whole):
    draws = {name: values.copy() for name, values in DRAWS.items()}
    draws["R_E"][2] = -1.0
    reduced = reduce_batch(twin, experiment, draws, ["final"], chunk_size=2)
    np.testing.assert_array_equal(reduced.failed, [False, False, True, False, False])
    assert np.isnan(given(reduced.final)[2]).all()
    np.testing.assert_allclose(
        given(reduced.final)[[0, 1, 3, 4]], whole[[0, 1, 3, 4], -1], atol=1e-9
    )


@pytest.mark.slow
def test_a_driver_without_delay_or_ahead_of_its_command_is_a_failed_draw(dual_cell):
    time = np.arange(21.0)
    drive = Experiment(time, np.full((21, 2), 0.5))
    draws = {"t_delay": np.array([0.5, 0.0, -3.0, 0.5]), "t_lag": np.array([1.0, 1.0, 1.0, -5.0])}
    reduced = reduce_batch(dual_cell, drive, draws, ["final", "maximum"])
    np.testing.assert_array_equal(reduced.failed, [False, True, True, True])
    assert np.isfinite(given(reduced.final)[0]).all()
    assert np.isnan(given(reduced.final)[1:]).all()
    assert np.isnan(given(reduced.maximum)[1:]).all()


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"draws": {}}, "draws: expected name -> draws.*, got none"),
        ({"draws": {"R_X": [1.0]}}, "expected some of the parameters C_esp, .* got 'R_X'"),
        (
            {"draws": {"R_E": []}},
            r"parameter R_E: .* at least one, got shape \(0,\)",
        ),
        ({"draws": {"R_E": [[1.0]]}}, r"parameter R_E: .* got shape \(1, 1\)"),
        ({"draws": {"R_E": ["a lot"]}}, r"parameter R_E: expected num.*, got \['a lot'\]"),
        (
            {"draws": {"R_E": [2.0, np.nan]}},
            "parameter R_E: expected finite numbers, got nan at draw 1",
        ),
        (
            {"draws": {"R_E": [2.0], "R_ph": [0.1, 0.2]}},
            r"expected the same number of draws for each, got R_E 1, R_ph 2",
        ),
        ({"chunk_size": -5}, "chunk_size: expected a whole number above 0.*, got -5"),
        ({"workers": 0}, "workers: expected a whole number above 0.*, got 0"),
    ],
)
def test_bad_input_is_refused_before_any_work(twin, asked, message):
    drive = Experiment(TIME, DUTY)
    given = {"draws": DRAWS} | asked
    with pytest.raises(JaxtwinError, match=message):
        simulate_batch(twin, drive, **given)


def test_several_values_of_a_parameter_that_is_not_drawn_are_refused(twin):
    several = twin.with_values({"R_pc": np.array([0.4, 0.5])})
    with pytest.raises(JaxtwinError, match=r"parameter R_pc: expected one value in the twin"):
        simulate_batch(several, Experiment(TIME, DUTY), DRAWS)


@pytest.mark.slow
def test_draws_with_stiff_cells_go_to_a_stiff_solver(twin, experiment, runs, monkeypatch):
    """With the limit at nothing every draw is one: `simulate` and `simulate_batch` then give what
    Kvaerno5 gives, to the error of both."""
    monkeypatch.setattr("jaxtwin.simulation._refinement.STABILITY_LIMIT", -1.0)
    two = {name: values[1:3] for name, values in DRAWS.items()}
    whole = simulate_batch(twin, experiment, two, chunk_size=2)
    final = reduce_batch(twin, experiment, two, ["final", "cost"], chunk_size=2)
    for k, run in enumerate(runs[1:3]):
        difference = np.abs(whole[k] - run.temperatures).max()
        assert 0 < difference < 1e-3
        np.testing.assert_allclose(given(final.final)[k], whole[k, -1], atol=1e-9)
    np.testing.assert_allclose(
        given(final.cost), np.mean((whole - experiment.temperatures) ** 2, axis=1), rtol=1e-9
    )


@pytest.mark.slow
def test_few_draws_that_need_shorter_steps_share_the_programs_of_all(monkeypatch):
    """One draw of 1024 is solved again, in a chunk as large as the others."""
    hard = {"R_E": 0.1, "R_ph": 1.3, "R_pc": 0.1, "R_Tfx2": 1.9, "C_esp": 110.0}
    twin = Twin("paper-2024", hard)
    calls: list[tuple[int, bool]] = []

    def counted(twin, draws, *rest):
        values = np.asarray(draws["R_E"])
        calls.append((values.size, bool((values == 0.1).all())))
        return prepare_chunk(twin, draws, *rest)

    monkeypatch.setattr(_draw_solver, "prepare_chunk", counted)
    monkeypatch.setenv(VARIABLE, "off")
    draws = np.full(1024, 2.0)
    draws[500] = 0.1
    drive = Experiment(np.arange(201.0), np.full((201, 2), 0.6))
    final = reduce_batch(twin, drive, {"R_E": draws}, ["final"], chunk_size=16).final
    assert {size for size, _ in calls} == {16}
    assert sum(is_again for _, is_again in calls) >= 1
    alone = twin.with_values({"R_E": 0.1}).simulate(drive)
    np.testing.assert_allclose(given(final)[500], alone.temperatures[-1], atol=1e-9)


def test_a_compressed_recording_has_fewer_rows_and_the_same_norm():
    """Of any temperatures that the steps can make, here a straight line."""
    long = Experiment(np.arange(1001.0), np.full((1001, 2), 0.5))
    grid = build_time_grid(long)
    recorded = np.random.default_rng(1).normal(40, 5, (1001, 3))
    compressed = compress(grid, recorded)
    assert len(compressed.target) < 500
    weights, rows = np.asarray(grid.weights), np.asarray(compressed.grid.weights)
    edges = np.concatenate([[0], np.cumsum(grid.sizes[grid.size])])

    def line(step_of, w):
        slope = np.full_like(edges, 0.02)
        before = np.maximum(step_of - 1, 0)
        data = [
            (0.02 * edges, slope)[k % 2][(step_of, step_of + 1, before)[k // 2]] for k in range(6)
        ]
        return np.sum(w * np.stack(data, axis=1), axis=1)

    full = line(np.asarray(grid.step_of), weights)
    np.testing.assert_allclose(full, 0.02 * long.time, atol=1e-9)
    combined = line(np.asarray(compressed.grid.step_of), rows)
    offset = 15.0
    expected = np.mean((full[:, None] + offset - recorded) ** 2, axis=0)
    errors = combined[:, None] + offset * compressed.ones[:, None] - compressed.target
    found = np.sum(errors**2, axis=0) / compressed.samples + compressed.beyond
    np.testing.assert_allclose(found, expected, rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("ambient", [None, 15.0 + 0.01 * TIME], ids=["compressed", "by samples"])
def test_missing_samples_count_nothing_in_the_cost(twin, experiment, ambient):
    """One channel misses some, all miss others; with a recorded ambient nothing is compressed."""
    recorded = np.array(experiment.temperatures)
    recorded[::7, 0] = np.nan
    recorded[20:30] = np.nan
    recorded[-4:, 1] = np.nan
    gappy = Experiment(
        experiment.time,
        experiment.duty,
        channels=experiment.channels,
        temperatures=recorded,
        ambient=ambient,
    )
    cost = reduce_batch(twin, gappy, DRAWS, ["cost"]).cost
    whole = simulate_batch(twin, gappy, DRAWS)
    np.testing.assert_allclose(given(cost), np.nanmean((whole - recorded) ** 2, axis=1), rtol=1e-9)


def test_a_cost_needs_a_sample_in_every_channel(twin, experiment):
    recorded = np.array(experiment.temperatures)
    recorded[:, 1] = np.nan
    bare = Experiment(
        experiment.time, experiment.duty, channels=experiment.channels, temperatures=recorded
    )
    with pytest.raises(JaxtwinError, match=r"got none in channel .*select"):
        reduce_batch(twin, bare, DRAWS, ["cost"])
    reduce_batch(twin, bare, DRAWS, ["final"])


def test_a_function_of_the_trajectory_is_a_reduction_beside_those_with_a_name(twin):
    short = Experiment(np.arange(61.0), np.full((61, 2), 0.5))
    whole = simulate_batch(twin, short, DRAWS)
    asked = {"hottest": lambda trajectory: trajectory.max(axis=0), "final": "final"}
    reduced = reduce_batch(twin, short, DRAWS, asked)
    np.testing.assert_allclose(reduced["hottest"], whole.max(axis=1), atol=1e-9)
    np.testing.assert_allclose(reduced["final"], whole[:, -1], atol=1e-9)


@pytest.mark.long
def test_a_diffrax_solver_runs_all_draws_side_by_side(twin):
    """Kvaerno5 at its own tolerance against the default solver; an invalid draw stays alone."""
    short = Experiment(np.arange(61.0), np.full((61, 2), 0.5))
    draws = {"R_E": np.array([1.9, -1.0, 2.1])}
    options = {"solver": diffrax.Kvaerno5(), "adjoint": diffrax.RecursiveCheckpointAdjoint()}
    whole = simulate_batch(twin, short, draws, **options)
    default = simulate_batch(twin, short, draws)
    assert np.isnan(whole[1]).all()
    np.testing.assert_allclose(whole[[0, 2]], default[[0, 2]], atol=1e-3)
