"""Surroundings that change while a rig runs: against the authors' circuit solved by Radau, and
against the same ambient as if it had been recorded."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from diffrax import Kvaerno5
from scipy.integrate import solve_ivp

from jaxtwin import (
    Experiment,
    Twin,
    load_rig,
    match,
    match_many,
    reduce_batch,
    response,
    simulate_batch,
)
from jaxtwin.data import data_folder

# K/hour: a room that a sunny window heats drifts a tenth as fast.
RATE = 20.0


@pytest.fixture(scope="module")
def drifting(tmp_path_factory) -> Twin:
    """The paper's rig, start-up values, in a room that drifts."""
    text = load_rig_text().replace(
        '[ambient]\ntemperature = "T_amb"', '[ambient]\ntemperature = "T_amb"\ndrift = "rate"'
    )
    text = text.replace(
        "[parameters]\n",
        '[parameters]\nrate = { value = 20.0, unit = "K/hour", bounds = [-90.0, 90.0], '
        'scope = "recording" }\n',
    )
    file = tmp_path_factory.mktemp("rig") / "drifting.toml"
    file.write_text(text, encoding="utf-8")
    rig = load_rig(file)
    return Twin(rig, rig.parameter_sets["startup"])


def load_rig_text() -> str:
    return (data_folder() / "rigs/paper-2024.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def steps() -> Experiment:
    return Experiment.schedule("0:0.5,300:0.78", duration=600, cells=2)


def ramp(time: np.ndarray, rate: float = RATE) -> np.ndarray:
    return 15.0 + rate / 3600 * (time - time[0])


@pytest.mark.slow
def test_a_drifting_room_is_radaus(drifting: Twin, steps: Experiment, circuits):
    circuit, state, expected = circuits["startup"], circuits["startup"].start(), []
    for start, end, duty in ((0, 300, 0.5), (300, 600, 0.78)):
        solution = solve_ivp(
            lambda t, T, d=duty: circuit.rate(T, np.full(2, d), 273.15 + 15.0 + RATE / 3600 * t),
            (start, end),
            state,
            method="Radau",
            t_eval=np.arange(start, end + 1.0),
            rtol=1e-9,
            atol=1e-9,
        )
        expected.append(solution.y.T[:-1] - 273.15)
        state = solution.y[:, -1]
    expected = np.vstack([*expected, state - 273.15])
    run = drifting.simulate(steps)
    assert np.abs(run.states - expected).max() < 1e-3
    still = drifting.with_values({"rate": 0.0}).simulate(steps)
    assert np.abs(still.states - expected).max() > 1.0


@pytest.mark.slow
def test_a_diffrax_solver_sees_the_same_room(drifting: Twin, steps: Experiment):
    ours = drifting.simulate(steps).temperatures
    theirs = drifting.simulate(steps, solver=Kvaerno5()).temperatures
    np.testing.assert_allclose(ours, theirs, atol=1e-3)


@pytest.mark.slow
def test_a_recorded_room_takes_the_place_of_one_that_drifts(drifting: Twin, steps: Experiment):
    recorded = Experiment(steps.time, steps.duty, ambient=ramp(steps.time))
    still = drifting.with_values({"rate": 0.0})
    np.testing.assert_array_equal(
        drifting.simulate(recorded).temperatures, still.simulate(recorded).temperatures
    )
    # Held at the samples it is half a sample late: RATE / 7200 K; each run is right to 1e-3 K.
    difference = drifting.simulate(steps).temperatures - drifting.simulate(recorded).temperatures
    assert 0 < np.abs(difference).max() < RATE / 7200 + 1e-3


@pytest.mark.slow
def test_a_batch_gives_what_single_runs_give(drifting: Twin, steps: Experiment):
    rates = np.array([-20.0, 0.0, 25.0])
    runs = simulate_batch(drifting, steps, {"rate": rates})
    for rate, run in zip(rates, runs, strict=True):
        alone = drifting.with_values({"rate": rate}).simulate(steps)
        np.testing.assert_allclose(run, alone.temperatures, atol=1e-4)


@pytest.mark.slow
def test_costs_of_a_batch_know_of_the_drift(drifting: Twin, steps: Experiment):
    seen = drifting.simulate(steps)
    recorded = Experiment(
        steps.time, steps.duty, channels=seen.channels, temperatures=seen.temperatures
    )
    found = reduce_batch(drifting, recorded, {"rate": np.array([RATE, 0.0])}, ["cost"])
    assert found.cost is not None
    np.testing.assert_allclose(found.cost[0], 0.0, atol=1e-8)
    assert np.all(found.cost[1] > 0.01)


@pytest.mark.slow
def test_the_derivative_in_the_drift_is_that_of_differences(
    drifting: Twin, steps: Experiment, float64
):
    def final(rate):
        return response(drifting.with_values({"rate": rate}), steps)[-1]

    slope = jax.jacfwd(final)(jnp.asarray(RATE))
    apart = (final(jnp.asarray(RATE + 1.0)) - final(jnp.asarray(RATE - 1.0))) / 2
    np.testing.assert_allclose(slope, apart, rtol=1e-5)


@pytest.mark.slow
def test_a_match_finds_the_drift_of_each_recording():
    rng, rates = np.random.default_rng(3), (-1.5, 1.0)
    drive = Experiment.schedule(
        "0:0.5,600:0.8", duration=1200, step=4.0, cells=2, channels=("T11", "TAM", "T26")
    )
    runs = []
    for number, rate in enumerate(rates):
        seen = Twin("dual-cell", {"T_amb_drift": rate, "h_A": 18.0}).simulate(drive).temperatures
        runs.append(
            Experiment(
                drive.time,
                drive.duty,
                channels=drive.channels,
                name=f"day {number + 1}",
                temperatures=seen + 0.02 * rng.standard_normal(seen.shape),
            )
        )
    free = ["T_amb", "T_amb_drift", "h_A"]
    fit = match(Twin("dual-cell"), runs, free=free, events="none")
    labels = dict(zip(fit.uncertainty.labels, np.diag(fit.uncertainty.covariance), strict=True))
    for (name, values), rate in zip(fit.recording_values.items(), rates, strict=True):
        error = float(np.sqrt(labels[f"T_amb_drift[{name}]"]))
        assert abs(values["T_amb_drift"] - rate) < 4 * error
        assert error < 0.6
    (both,) = match_many(Twin("dual-cell"), [runs], free=free, events="none")
    assert both is not None
    assert both["T_amb_drift"].value == pytest.approx(fit["T_amb_drift"].value, rel=1e-3)
