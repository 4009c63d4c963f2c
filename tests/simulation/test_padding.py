"""Schedules are filled up to a few sizes: another recording runs through the programs that are
there, and nothing that is added changes a result.
"""

import jax
import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin._padded_rows import padded_count
from jaxtwin.simulation import TimeGrid, build_time_grid, solve_network, time_grid
from jaxtwin.simulation._time_grid import padded_time_grid


def session(samples: int, seed: int, **more) -> jt.Experiment:
    """A drive that changes at some samples."""
    rng = np.random.default_rng(seed)
    duty = rng.uniform(-0.5, 0.8, samples)
    # Some are held for one sample more: other steps than where all change, and other sizes.
    held = 1 + np.flatnonzero(rng.random(samples - 1) < 0.02)
    duty[held] = duty[held - 1]
    return jt.Experiment(np.arange(float(samples)), duty[:, None], name=f"session {seed}", **more)


@pytest.fixture(scope="module")
def twin() -> jt.Twin:
    return jt.Twin("single-cell")


def recorded(twin: jt.Twin, experiment: jt.Experiment) -> jt.Experiment:
    """What the rig with another contact would have shown."""
    run = jt.simulate(twin.with_values({"R_pc": 0.15}), experiment)
    return jt.Experiment(
        experiment.time,
        experiment.duty,
        temperatures=run.temperatures,
        channels=run.channels,
        name=experiment.name,
    )


def test_sizes_grow_by_an_eighth_at_most():
    counts = np.arange(1, 5000)
    sizes = np.array([padded_count(int(count)) for count in counts])
    assert np.all(sizes >= counts)
    assert np.all(sizes - counts <= np.maximum(7, counts / 8))
    assert len(set(sizes[(counts > 2048) & (counts <= 4096)])) == 8


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rig", "ambient"),
    [
        pytest.param("paper-2024", None, marks=pytest.mark.long),
        pytest.param("dual-cell", None, marks=pytest.mark.long),
        ("dual-cell", "recorded"),
    ],
)
def test_padding_a_grid_with_steps_of_zero_length_changes_nothing(rig, ambient, float64):
    """Values and forward derivatives, with a lagging driver and a delay in `dual-cell`."""
    twin = jt.Twin(rig)
    time = np.arange(61.0)
    air = None if ambient is None else 15 + np.sin(time / 9).round(1)
    duty = np.where(time < 23, 0.5, 0.8)[:, None] * np.ones(2)
    experiment = jt.Experiment(time, duty, ambient=air)
    exact, filled = time_grid(twin, experiment), padded_time_grid(twin, experiment)
    assert len(exact.size) < len(filled.size)
    assert len(exact.times) < len(filled.times)
    name = "t_delay" if "t_delay" in twin.values else "R_ph"

    @jax.jit
    def both(value: jax.Array, grid: TimeGrid) -> tuple[jax.Array, jax.Array]:
        def solve(value: jax.Array) -> jax.Array:
            system = twin.with_values({name: value}).system(lumped=True)
            readout = system.wiring.channel_weights
            return solve_network(system, grid, system.initial_temperature, readout)[1]

        return jax.jvp(solve, (value,), (jax.numpy.ones(()),))

    at = jax.numpy.asarray(float(twin.values[name]))
    for found, expected in zip(both(at, filled), both(at, exact), strict=True):
        scale = np.abs(np.asarray(expected)).max()
        np.testing.assert_allclose(found[: time.size], expected, atol=1e-12 * max(1, scale))
        assert np.isfinite(found).all()


@pytest.mark.slow
def test_reverse_derivatives_of_filled_schedules_are_finite(twin, float64):
    experiment = session(20, 1)
    assert len(build_time_grid(experiment).size) % 8

    def last(resistance: jax.Array) -> jax.Array:
        return jt.response(twin.with_values({"R_pc": resistance}), experiment)[-1, 0]

    at = jax.numpy.asarray(0.1)
    np.testing.assert_allclose(jax.grad(last)(at), jax.jacfwd(last)(at), rtol=1e-9)


def test_grids_of_held_and_changing_drives_have_equal_shapes(twin):
    """The steps after the start, and one size, or eleven."""
    changing = np.random.default_rng(0).uniform(-1, 1, 600)
    held = np.append(changing[:595], np.full(5, 0.3))
    grid, held_grid = (
        padded_time_grid(twin, jt.Experiment(np.arange(600.0), duty)) for duty in (changing, held)
    )
    assert len(set(grid.sizes)) == 3
    assert len(set(held_grid.sizes)) > 8
    assert [np.shape(leaf) for leaf in jax.tree.leaves(grid)] == [
        np.shape(leaf) for leaf in jax.tree.leaves(held_grid)
    ]


@pytest.mark.slow
def test_another_session_is_simulated_without_a_compilation(twin, compilations):
    jt.simulate(twin, session(116, 1))
    compilations()
    run = jt.simulate(twin, session(113, 2))
    assert compilations() == 0
    assert run.temperatures.shape == (113, 1)


@pytest.mark.slow
def test_draws_of_another_session_are_simulated_without_a_compilation(twin, compilations):
    draws = {"R_pc": np.array([0.1, 0.2, 0.3])}
    wanted = ("cost", "final", "minimum", "maximum", "plate_range")
    first, second = (recorded(twin, session(*what)) for what in ((116, 1), (114, 4)))
    jt.simulate_batch(twin, first, draws)
    jt.reduce_batch(twin, first, draws, wanted)
    compilations()
    temperatures = jt.simulate_batch(twin, second, draws)
    found = jt.reduce_batch(twin, second, draws, wanted)
    assert compilations() == 0
    assert temperatures.shape == (3, 114, 1)
    error = temperatures - second.temperatures
    assert found.cost is not None
    assert found.maximum is not None
    assert found.final is not None
    np.testing.assert_allclose(found.cost, np.mean(error**2, axis=1), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.maximum, temperatures.max(axis=1), rtol=1e-14)
    np.testing.assert_allclose(found.final, temperatures[:, -1], rtol=1e-14)


@pytest.mark.slow
def test_a_match_to_others_compiles_nothing_and_finds_the_same(twin, compilations):
    """Sessions of different lengths in one class are solved together."""
    sessions = [recorded(twin, session(*what)) for what in ((116, 1), (115, 2), (115, 3), (114, 4))]
    start = twin.with_values({"R_pc": 0.1})
    jt.match(start, sessions[:2], free=["R_pc"])
    compilations()
    fit = jt.match(start, sessions[2:], free=["R_pc"])
    assert compilations() == 0
    assert float(fit.twin.values["R_pc"]) == pytest.approx(0.15, rel=1e-4)
    assert {name: run.temperatures.shape for name, run in fit.runs.items()} == {
        "session 3": (115, 1),
        "session 4": (114, 1),
    }
    pairs = zip(fit.runs.values(), sessions[2:], strict=True)
    errors = np.concatenate([run.temperatures - session.temperatures for run, session in pairs])
    # Where there is a compiler the match is solved in C, a few 1e-6 K from `simulate`.
    assert fit.rmse == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-3, abs=5e-6)
