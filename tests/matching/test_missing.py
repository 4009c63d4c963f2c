"""Missing samples in a match: the same as samples of weight 0, whatever stands in their place."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from jaxtwin import Experiment, Twin, match, simulate
from jaxtwin.errors import MatchError
from jaxtwin.io import read_recording, write_recording
from jaxtwin.matching import Fit, Huber, estimate_initial_conditions
from jaxtwin.matching._fit import solution_of
from jaxtwin.matching._match import default_solver
from jaxtwin.matching._problem import (
    ParameterChoice,
    SampleOptions,
    choose_unknowns,
    make_match_problem,
)
from jaxtwin.matching._reweighted_least_squares import reweighted_least_squares

FREE = ["R_E", "R_pc", "T_amb"]
TRUTH = {"R_E": 1.4, "R_pc": 0.25, "T_amb": 17.0}
CHANNELS = ("T11", "TAM", "T26")


@pytest.fixture(scope="module")
def start() -> Twin:
    return Twin("paper-2024")


@pytest.fixture(scope="module")
def whole(start: Twin) -> Experiment:
    """A run of the true twin with noise of 0.1 K, nothing missing."""
    drive = Experiment.schedule(
        "0:0.5,60:0.8", duration=150, step=3.0, cells=2, channels=CHANNELS, name="day"
    )
    exact = simulate(start.with_values(TRUTH), drive).temperatures
    noise = 0.1 * np.random.default_rng(0).standard_normal(exact.shape)
    return with_temperatures(drive, exact + noise)


def with_temperatures(experiment: Experiment, temperatures: np.ndarray) -> Experiment:
    return Experiment(
        experiment.time,
        experiment.duty,
        channels=CHANNELS,
        temperatures=temperatures,
        name="day",
    )


def with_holes(experiment: Experiment, holes: np.ndarray) -> Experiment:
    return with_temperatures(
        experiment, np.where(holes, np.nan, np.asarray(experiment.temperatures))
    )


def assert_same(fit: Fit, other: Fit) -> None:
    """Cost, values, standard errors and noise of two matches, all but exactly the same."""
    assert fit.cost == pytest.approx(other.cost, rel=1e-9)
    np.testing.assert_allclose(solution_of(fit).vector, solution_of(other).vector, rtol=1e-7)
    np.testing.assert_allclose(
        fit.uncertainty.covariance, other.uncertainty.covariance, rtol=1e-5, atol=1e-15
    )
    for mine, others in zip(fit.noise, other.noise, strict=True):
        assert mine.effective == pytest.approx(others.effective, rel=1e-6)


@pytest.mark.slow
@settings(max_examples=4)
@given(first=st.integers(0, 25), length=st.integers(1, 20), garbage=st.floats(-273.0, 9999.0))
def test_a_file_with_a_hole_matches_as_the_same_samples_masked(
    tmp_path_factory: pytest.TempPathFactory,
    start: Twin,
    whole: Experiment,
    first: int,
    length: int,
    garbage: float,
):
    span = slice(first, first + length)
    holes = np.zeros(whole.sampled.shape, bool)
    holes[span] = True
    folder: Path = tmp_path_factory.mktemp("holes")
    file = write_recording(with_holes(whole, holes), folder / "day.csv")
    filled = with_temperatures(whole, np.where(holes, garbage, np.asarray(whole.temperatures)))
    mask = {"day": [(float(whole.time[span][0]), float(whole.time[span][-1]) + 1e-6)]}
    if first + length >= len(whole.time):
        mask = {"day": [(float(whole.time[first]) - 1e-6, float(whole.time[-1]))]}
    missing = match(start, read_recording(file), free=FREE, loss=Huber(3.0))
    masked = match(start, filled, free=FREE, loss=Huber(3.0), masks=mask)
    assert_same(missing, masked)


@pytest.mark.slow
@settings(max_examples=5)
@given(
    seed=st.integers(0, 1000),
    share=st.floats(0.05, 0.6),
    garbage=npst.arrays(np.float64, (51, 3), elements=st.floats(-273.0, 9999.0)),
    loss=st.sampled_from([None, Huber(3.0)]),
)
def test_samples_of_weight_0_have_no_effect(
    start: Twin,
    whole: Experiment,
    seed: int,
    share: float,
    garbage: np.ndarray,
    loss: Huber | None,
):
    """Single channels miss samples here, which no mask can say."""
    holes = np.random.default_rng(seed).random((51, 3)) < share
    recording = with_holes(whole, holes)
    unknowns = choose_unknowns(start, (0,), ParameterChoice(FREE))
    missing = make_match_problem(
        start, {"day": recording}, unknowns, options=SampleOptions(loss=loss)
    )
    filled = with_temperatures(whole, np.where(holes, garbage, np.asarray(whole.temperatures)))
    weighed = replace(missing, experiments=(filled,))
    results = [
        reweighted_least_squares([problem], default_solver(problem), [unknowns.start()], 50)[0]
        for problem in (missing, weighed)
    ]
    (fit, known), (other, also_known) = results
    assert fit.cost == pytest.approx(other.cost, rel=1e-9)
    np.testing.assert_allclose(fit.vector, other.vector, rtol=1e-9)
    assert known.channel.effective == pytest.approx(also_known.channel.effective, rel=1e-9)


@pytest.mark.slow
def test_the_truth_is_recovered_from_what_is_left(start: Twin, whole: Experiment):
    """A third of all samples is missing at random, and one channel for a minute."""
    holes = np.random.default_rng(1).random((51, 3)) < 1 / 3
    holes[20:40, 1] = True
    fit = match(start, with_holes(whole, holes), free=FREE)
    for name, value in TRUTH.items():
        row = fit[name]
        assert abs(row.value - value) < 3 * row.standard_error < value
    there = ~holes
    error = (fit.runs["day"].temperatures - np.asarray(whole.temperatures))[there]
    assert fit.rmse == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-4)
    assert fit.rmse == pytest.approx(0.1, rel=0.25)
    assert np.all(fit.weights["day"] == there)
    assert np.isfinite(fit.mean_fit_percent)
    assert 0 <= fit.solver_gap < 1e-3


@pytest.mark.slow
def test_without_two_channels_at_the_same_time_both_noises_are_the_same(
    start: Twin, whole: Experiment
):
    """Deviations from a mean of one channel are nothing; the noise is that of what all share."""
    holes = np.arange(51)[:, None] % 3 != np.arange(3)
    fit = match(start, with_holes(whole, holes), free=FREE, loss=Huber(3.0))
    assert fit.noise[0] == fit.noise[1]
    for name, value in TRUTH.items():
        row = fit[name]
        assert abs(row.value - value) < 3 * row.standard_error < value


def test_only_samples_that_are_there_are_counted(start: Twin, whole: Experiment):
    holes = np.ones((51, 3), bool)
    holes[[0, 1], [0, 0]] = False
    with pytest.raises(MatchError, match=r"channel TAM: expected at least one sample.*select"):
        match(start, with_holes(whole, holes), free=FREE)
    with pytest.raises(MatchError, match=r"more samples than the 3 unknowns.* got 2 samples"):
        match(start, with_holes(whole, holes).select(["T11"]), free=FREE)


@pytest.mark.slow
def test_a_recordings_own_values_come_from_the_samples_that_are_there(
    start: Twin, whole: Experiment
):
    """The first readings and a whole channel are missing in the first minute."""
    holes = np.zeros((51, 3), bool)
    holes[0] = holes[:25, 1] = True
    true = start.with_values(TRUTH)
    gappy, complete = (
        estimate_initial_conditions(true, experiment).values["T_amb"]
        for experiment in (with_holes(whole, holes), whole)
    )
    assert gappy == pytest.approx(complete, abs=0.3)
    holes[:19] = True
    with pytest.raises(MatchError, match=r"expected at least 2 samples.* got 1"):
        estimate_initial_conditions(start, with_holes(whole, holes))
