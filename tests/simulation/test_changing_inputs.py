"""Inputs that change at every sample: how many steps they take, and how exact these are.

The truth is SciPy's Radau on the authors' circuit (`Circuit`), with every input held between its
samples; for rigs with a lag, a delay or other inputs it is the default solver with steps an eighth
as long that end at every change.
"""

from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxtwin as jt
from jaxtwin._jax_settings import own_settings
from jaxtwin.simulation import build_time_grid
from jaxtwin.simulation._held_inputs import held_quadratics, mean_of, merged_changes, quadratic_at
from jaxtwin.simulation._input_levels import input_rates
from jaxtwin.simulation._simulate import run_exponential
from jaxtwin.simulation._time_grid import padded_time_grid, step_rule, time_grid

# The largest errors that benchmarks/results/speed.md states for a run and draws in C, K.
CHANNELS, DRAWS = 1e-3, 2e-4

RANDOM = np.random.default_rng(0)


def steps_of(duration: int, cells: int, interval: int = 1) -> tuple[np.ndarray, np.ndarray]:
    time = np.arange(0.0, duration + 1, interval)
    return time, np.where(time < duration / 2, 0.5, 0.8)[:, None] * np.ones(cells)


def rooms(time: np.ndarray) -> dict[str, np.ndarray]:
    drifting = 22 + 2 * np.sin(2 * np.pi * time / 5000)
    noisy = drifting + np.random.default_rng(1).normal(0, 0.1, len(time))
    is_open = (time > 0.4 * time[-1]) & (time < 0.6 * time[-1])
    return {
        "drifting": drifting,
        "noisy": noisy,
        "rounded": noisy.round(1),
        "door": drifting - 8 * is_open,
    }


def quantised_loop(samples: int, cells: int) -> np.ndarray:
    """What a PI controller with readings of some noise commands, in counts."""
    time = np.arange(samples)[:, None]
    noise = np.random.default_rng(2).normal(0, 0.01, (samples, cells))
    return np.round(255 * (0.5 + 0.3 * np.exp(-(time % 100) / 20) + noise)) / 255


def drives(duration: int, cells: int) -> Mapping[str, jt.Experiment]:
    time, duty = steps_of(duration, cells)
    signs = np.random.default_rng(3).choice([-0.4, 0.6], (len(time), cells))
    slow, slow_duty = steps_of(duration, cells, 60)
    found = {name: jt.Experiment(time, duty, ambient=room) for name, room in rooms(time).items()}
    return found | {
        "loop": jt.Experiment(time, quantised_loop(len(time), cells), ambient=rooms(time)["noisy"]),
        "PRBS": jt.Experiment(time, signs),
        "minutes": jt.Experiment(slow, slow_duty, ambient=rooms(slow)["noisy"]),
    }


def finest(twin: jt.Twin, experiment: jt.Experiment) -> np.ndarray:
    """The readings with steps an eighth as long after every change."""
    wiring = twin.wiring
    rule = step_rule(1 / 8, settling=0.0 if wiring.lag is None else 6.0)
    grid = build_time_grid(experiment, rule, wiring.inputs_and_effects)
    with own_settings():
        return np.asarray(run_exponential(twin, grid, None)[1]) - 273.15


def drawn(twin: jt.Twin, experiment: jt.Experiment) -> np.ndarray:
    """The readings of a draw of a batch with the twin's own values."""
    name = next(name for name, row in twin.rig.parameters.items() if row.free)
    return jt.simulate_batch(twin, experiment, {name: np.array([float(twin[name])])})[0]


@pytest.mark.slow
@pytest.mark.c_compiler
@pytest.mark.parametrize("name", drives(120, 2))
def test_what_changes_at_every_sample_is_radaus(name: str, circuits, twins):
    circuit, twin, experiment = circuits["startup"], twins["startup"], drives(120, 2)[name]
    air = {} if experiment.ambient is None else {"ambient": experiment.ambient}
    truth = circuit.solve(experiment.time, experiment.duty, **air)
    run = twin.simulate(experiment)
    nodes = np.abs(run.states - truth)
    assert nodes[:, :24].max() < CHANNELS
    assert np.abs(drawn(twin, experiment) - run.temperatures).max() < CHANNELS


@pytest.mark.slow
@pytest.mark.c_compiler
@pytest.mark.parametrize("rig", ["dual-cell", "single-cell"])
@pytest.mark.parametrize("name", drives(300, 1))
def test_lags_delays_and_films_keep_the_errors(name: str, rig: str):
    twin = jt.Twin(rig)
    experiment = drives(300, len(twin.wiring.cold))[name]
    truth = finest(twin, experiment)
    assert np.abs(twin.simulate(experiment).temperatures - truth).max() < CHANNELS
    # A reversal at every sample is as exact as before: 3e-4 K with the lag of `dual-cell`.
    assert np.abs(drawn(twin, experiment) - truth).max() < 2 * DRAWS


@pytest.mark.slow
@pytest.mark.c_compiler
@pytest.mark.parametrize(
    ("rig", "inputs"),
    [
        ("battery-pack", {"T_coolant": 20 + 2 * np.sin(np.arange(301) / 100)}),
        ("heated-box", {"fan": 0.8 + 0.2 * np.sin(np.arange(301) / 100)}),
        ("heated-box", {"lid": np.where(np.arange(301) < 200, "closed", "open")}),
    ],
)
def test_other_inputs_that_drift_keep_the_errors(rig: str, inputs: Mapping[str, np.ndarray]):
    twin = jt.Twin(rig)
    time, duty = steps_of(300, len(twin.wiring.cold))
    experiment = jt.Experiment(time, duty, inputs=inputs)
    truth = finest(twin, experiment)
    assert np.abs(twin.simulate(experiment).temperatures - truth).max() < DRAWS
    assert np.abs(drawn(twin, experiment) - truth).max() < DRAWS


@pytest.mark.parametrize("rig", ["paper-2024", "dual-cell", "single-cell"])
def test_a_slow_room_takes_few_steps_more_than_a_constant_one(rig: str):
    twin = jt.Twin(rig)
    time, duty = steps_of(1000, len(twin.wiring.cold))
    constant = time_grid(twin, jt.Experiment(time, duty, ambient=22.0))
    drifting = time_grid(twin, jt.Experiment(time, duty, ambient=rooms(time)["drifting"]))
    noisy = time_grid(twin, jt.Experiment(time, duty, ambient=rooms(time)["noisy"]))
    assert len(drifting.size) < 1.5 * len(constant.size)
    assert len(noisy.size) < 1.05 * len(time)


def test_other_values_have_the_same_steps():
    """Their shapes are those of the compiled programs."""
    twin = jt.Twin("single-cell")
    time, duty = steps_of(300, 1)
    experiment = jt.Experiment(time, duty, ambient=rooms(time)["noisy"])
    other = twin.with_values({"R_loss": 50.0, "C_load": 2.0})
    assert padded_time_grid(twin, experiment) is padded_time_grid(other, experiment)


def test_a_kelvin_of_the_room_moves_a_small_load_by_its_film():
    """At first the load follows with the conductance of its film over its heat capacity."""
    twin = jt.Twin("single-cell")
    of_duty, of_room = input_rates(twin.rig)
    film = 1 / (float(twin["R_loss"]) * float(twin["C_load"]))
    assert of_room == pytest.approx(film, rel=0.1)
    assert of_duty > 100 * of_room


def test_large_networks_have_the_rates_of_small_ones(monkeypatch: pytest.MonkeyPatch):
    """By sparse factors."""
    from jaxtwin.simulation import _input_levels

    rig = jt.load_rig("dual-cell")
    dense = input_rates.__wrapped__(rig)
    monkeypatch.setattr(_input_levels, "MAX_DENSE", 0)
    np.testing.assert_allclose(input_rates.__wrapped__(rig), dense, rtol=1e-9)


@given(
    st.lists(st.floats(0.1, 10.0), min_size=2, max_size=12),
    st.lists(st.floats(0.05, 4.0), min_size=1, max_size=12),
    st.integers(0, 2**32 - 1),
)
def test_a_quadratic_has_the_mean_of_what_is_held(intervals, sizes, seed: int):
    times = np.concatenate([[0.0], np.cumsum(intervals)])
    held = np.random.default_rng(seed).normal(300, 5, len(times))
    lengths = np.array(sizes)
    ends = np.cumsum(lengths)
    edges, integral = np.append(times, 1e3), np.zeros(len(times) + 1)
    integral[1:] = np.cumsum(held * np.diff(edges))
    expected = np.diff(np.interp(np.append(0.0, ends), edges, integral)) / lengths
    found = held_quadratics(times, held, lengths)
    np.testing.assert_allclose(mean_of(found), expected, rtol=1e-9)


def test_a_quadratic_is_itself_in_parts_of_a_step():
    values = np.array([[1.0, 2.0, 5.0], [3.0, 3.0, 3.0]])
    parts = np.array([[0.0, 0.5, 1.0], [0.1, 0.2, 0.3]])
    np.testing.assert_array_equal(quadratic_at(values, parts), [[1, 2, 5], [3, 3, 3]])


def test_a_straight_room_is_merged_and_a_step_is_not():
    times = np.arange(65.0)
    straight = 1e-5 * times[:, None]
    stays = np.zeros(65, bool)
    assert merged_changes(times, straight, stays, 0.0).tolist() == [0, 64]
    step = 1e-2 * (times[:, None] >= 20)
    kept = merged_changes(times, step, stays, 0.0)
    assert 20 in kept
    assert len(kept) < 10
    stays[33] = True
    assert 33 in merged_changes(times, straight, stays, 0.0)
    assert len(merged_changes(times, 1e-2 * RANDOM.normal(size=(65, 1)), stays, 0.0)) == 65
