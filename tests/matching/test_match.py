"""Matching on recordings made by the twin itself, whose truth is known."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from jaxtwin import Experiment, Twin, match, read_parameters, simulate
from jaxtwin.errors import MatchError, ParameterError, SimulationError
from jaxtwin.matching import Iteration

FREE = ["R_E", "R_pc", "R_Tez"]
TRUTH = {"R_E": 1.4, "R_pc": 0.25, "R_Tez": 6.0}
AMBIENT = (17.0, 21.0)


@pytest.fixture(scope="module")
def start() -> Twin:
    return Twin("paper-2024")


def recordings(noise: float, seed: int = 0) -> list[Experiment]:
    """Two runs of the true twin in different surroundings."""
    rng = np.random.default_rng(seed)
    made = []
    for number, ambient in enumerate(AMBIENT):
        drive = Experiment.schedule(
            "0:0.5,60:0.8", duration=150, step=3.0, cells=2, channels=("T11", "TAM", "T26")
        )
        run = simulate(Twin("paper-2024", TRUTH | {"T_amb": ambient}), drive)
        noisy = run.temperatures + noise * rng.standard_normal(run.temperatures.shape)
        made.append(
            Experiment(
                drive.time,
                drive.duty,
                channels=run.channels,
                temperatures=noisy,
                name=f"day {number + 1}",
            )
        )
    return made


@pytest.fixture(scope="module")
def clean(start: Twin):
    return match(start, recordings(0.0), free=[*FREE, "T_amb"])


@pytest.mark.slow
def test_the_truth_is_recovered_without_noise(clean):
    for name, value in TRUTH.items():
        assert clean[name].value == pytest.approx(value, rel=0.01)
    found = [values["T_amb"] for values in clean.recording_values.values()]
    np.testing.assert_allclose(found, AMBIENT, atol=0.01)
    assert clean.rmse < 1e-3
    assert clean.mean_fit_percent > 99.9
    assert clean.converged


@pytest.mark.slow
def test_the_history_begins_at_the_start_and_never_rises(clean, start: Twin):
    assert clean.history[0].values["R_E"] == pytest.approx(float(start.values["R_E"]))
    costs = [step.cost for step in clean.history]
    assert all(later <= earlier for earlier, later in pairwise(costs))
    assert clean.history[-1].rmse == pytest.approx(clean.rmse)


def test_a_saved_fit_makes_the_same_twin(clean, tmp_path):
    clean.save(tmp_path / "fit.toml")
    for recording, twin in clean.twins.items():
        values = read_parameters(tmp_path / "fit.toml", clean.twin.rig, recording)
        for name, value in values.items():
            assert value == pytest.approx(float(twin.values[name]), rel=1e-12)


def test_the_result_is_json_and_a_table(clean):
    data = json.loads(json.dumps(clean.to_dict(), allow_nan=False))
    assert data["recordings"]["day 2"]["T_amb"] == pytest.approx(21.0, abs=0.01)
    table = clean.summary()
    for word in (*FREE, "published", "day 1: T_amb", "status"):
        assert word in table


def test_the_match_s_own_steps_are_compared_with_those_of_simulate(clean):
    assert 0 <= clean.solver_gap < 1e-3
    assert "too long" not in clean.summary()
    assert "too long for these values: 0.02 K" in replace(clean, solver_gap=0.02).summary()


@pytest.mark.slow
def test_noise_moves_the_values_within_their_standard_errors(start: Twin):
    # 8 seeds x 3 parameters: each within 1.96 standard errors with probability 0.95, so fewer than
    # 19 of 24 has a probability of 1e-3 (binomial).
    inside = 0
    for seed in range(8):
        fit = match(start, recordings(0.1, seed), free=[*FREE, "T_amb"])
        assert fit.rmse == pytest.approx(0.1, rel=0.15)
        for name, value in TRUTH.items():
            row = fit[name]
            assert 0 < row.standard_error < 0.2 * value
            inside += abs(row.value - value) < 1.96 * row.standard_error
    assert inside >= 19


def test_bounds_hold_and_are_reported(start: Twin):
    fit = match(start, recordings(0.0), free=[*FREE, "T_amb"], bounds={"R_E": (1.6, 3.0)})
    row = fit["R_E"]
    assert row.value == 1.6
    assert row.at_bound
    assert np.isnan(row.standard_error)
    assert np.isnan(row.interval).all()
    (at_bound,) = [p for p in fit.to_dict()["parameters"] if p["name"] == "R_E"]
    assert at_bound["interval"] == [None, None]
    assert not fit["R_Tez"].at_bound


@pytest.mark.long
def test_further_starts_reach_the_same_optimum(start: Twin):
    shown: list[Iteration] = []
    fit = match(
        start,
        recordings(0.0),
        free=[*FREE, "T_amb"],
        starts=3,
        seed=1,
        on_progress=shown.append,
    )
    assert {iteration.start for iteration in shown} == {0, 1, 2}
    assert len(fit.optima) == 3
    assert [optimum.rmse for optimum in fit.optima] == sorted(
        optimum.rmse for optimum in fit.optima
    )
    assert fit.optima[0].rmse < 1e-3


@pytest.mark.slow
def test_optima_are_apart_by_what_their_twins_simulate(start: Twin):
    """Descents from two starts, stopped after a step: the root mean square over all channels and
    samples of what `simulate` gives for the values of each."""
    recorded = recordings(0.0)
    fit = match(start, recorded, free=["R_E", "R_pc"], starts=2, seed=1, max_iterations=1)
    best, other = (
        np.stack([simulate(start.with_values(o.values), e).temperatures for e in recorded])
        for o in fit.optima
    )
    assert fit.optima[0].apart == 0
    assert fit.optima[1].apart > 0.1
    assert fit.optima[1].apart == pytest.approx(np.sqrt(np.mean((other - best) ** 2)), rel=1e-4)


@pytest.mark.slow
def test_scopes_can_be_changed(start: Twin):
    fit = match(start, recordings(0.0), free=["R_E", "T_amb"], shared=["T_amb"], max_iterations=5)
    assert all(not values for values in fit.recording_values.values())
    fit = match(start, recordings(0.0), free=["R_E"], per_recording=["R_E"], max_iterations=5)
    assert set(fit.recording_values["day 1"]) == {"R_E"}
    assert fit["T_amb"].value == 15.0


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"free": []}, MatchError, "no free parameter"),
        ({"free": ["R_X"]}, ParameterError, "expected some of the parameters .* got R_X"),
        ({"free": ["R_tez"]}, ParameterError, r"got R_tez; did you mean 'R_Tez'\?"),
        ({"free": ["R_E"], "fixed": ["R_E"]}, MatchError, "in either free or fixed, got in both"),
        ({"free": ["R_E"], "bounds": {"R_E": (3.0, 4.0)}}, MatchError, "3 to 4, got 1.96"),
        ({"free": ["R_E"], "bounds": {"R_E": (float("nan"), 4.0)}}, MatchError, "R_E"),
        ({"free": ["R_E"], "starts": 0}, MatchError, "starts"),
        (
            {"free": ["R_E"], "bounds": {"R_pc": (0.1, 1.0)}},
            MatchError,
            "bounds: expected some of the free parameters R_E.*, got R_pc",
        ),
        (
            {"shared": ["R_E"], "fixed": ["R_E"]},
            MatchError,
            "in either shared or fixed, got in both",
        ),
        (
            {"shared": ["T_amb"], "per_recording": ["T_amb"]},
            MatchError,
            "in either shared or per_recording, got in both",
        ),
    ],
)
def test_bad_requests_say_what_is_allowed(start, options, error, words):
    with pytest.raises(error, match=words):
        match(start, recordings(0.0), **options)


def test_recordings_must_be_of_this_rig_and_long_enough(start: Twin):
    whole = recordings(0.0)[0]
    with pytest.raises(MatchError, match="none"):
        match(start, [])
    bare = Experiment(whole.time, whole.duty, channels=whole.channels)
    with pytest.raises(MatchError, match="expected recorded temperatures"):
        match(start, bare)
    short = whole.between(0, 5).select(["T11"])
    with pytest.raises(MatchError, match=r"the 3 unknowns.* got 2 samples"):
        match(start, short, free=FREE)
    other = Experiment(
        whole.time, whole.duty[:, :1], channels=whole.channels, temperatures=whole.temperatures
    )
    with pytest.raises(SimulationError, match="the 2 cells of paper-2024, got 1"):
        match(start, other, free=FREE)
