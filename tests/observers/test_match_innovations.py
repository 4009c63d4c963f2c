"""A match by the likelihood of innovations: derivatives, the true values, what is gained."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from small_rigs import bundled

from jaxtwin import Experiment, Fit, ProcessNoise, Twin, match, simulate
from jaxtwin.errors import ObserverError
from jaxtwin.matching._fit import solution_of
from jaxtwin.observers import match_innovations
from jaxtwin.observers._match_innovations import _Score
from jaxtwin.observers._observe import usual_noise

TRUE = {"R_1": 70.0}
FREE = ["C_1", "R_1", "R_2"]


def recording(rooms: np.ndarray | float, seed: int) -> Experiment:
    """Steps of both heaters; the recording says nothing of the room."""
    plan = Experiment.schedule(
        "0:0.6/0,120:0.2/0.5,300:0.4/0.4", duration=600, step=2, cells=2, ambient=23
    )
    plan = dataclasses.replace(plan, ambient=np.broadcast_to(rooms, plan.time.shape).copy())
    run = simulate(Twin("tclab").with_values(TRUE), plan)
    return dataclasses.replace(run.to_recording(noise=0.1, seed=seed), ambient=None)


@pytest.fixture(scope="module")
def exact() -> Fit:
    """A match where the twin is exact."""
    return match(Twin("tclab"), recording(23.0, 1), free=FREE)


def noise_of(fit: Fit, **levels: float) -> ProcessNoise:
    usual = usual_noise(fit, [recording(23.0, 1)])
    small = {"channel": 0.01, "common": 0.01, "reading": 0.1, "reading_time": 1e-3}
    return dataclasses.replace(usual, **{**small, **levels})


@pytest.mark.slow
@pytest.mark.parametrize("heat", [0.001, 0.3])
def test_the_derivative_is_that_of_central_differences(exact: Fit, heat: float):
    """Of capacities and resistances, with little and with much random heat, away from the
    maximum."""
    problem = solution_of(exact).problem
    score = _Score(problem, exact, noise_of(exact, heat=heat))
    vector = np.add(solution_of(exact).vector, [0.02, -0.03, 0.01])
    _, slope = score(vector)
    step = 1e-4 * np.eye(len(vector))
    central = [(score(vector + e)[0] - score(vector - e)[0]) / 2e-4 for e in step]
    np.testing.assert_allclose(slope, central, rtol=1e-6, atol=1e-5)


@pytest.mark.slow
def test_the_derivative_with_respect_to_the_drivers_delay_is_that_of_central_differences():
    delay = {"value": 3.3, "unit": "s", "bounds": [0.1, 20.0], "free": True}
    late = bundled("tclab", {"lag": "3 s", "delay": "t_delay"}, {"t_delay": delay})
    fit = match(late, recording(23.0, 1), free=["R_1", "t_delay"], max_iterations=1)
    score = _Score(solution_of(fit).problem, fit, noise_of(fit))
    vector = np.array(solution_of(fit).vector)
    _, slope = score(vector)
    step = 1e-4 * np.eye(len(vector))
    central = [(score(vector + e)[0] - score(vector - e)[0]) / 2e-4 for e in step]
    assert abs(slope[1]) > 0.1
    np.testing.assert_allclose(slope, central, rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_where_the_twin_is_exact_nothing_is_gained_and_the_true_values_are_inside(
    exact: Fit, tmp_path: Path
):
    found = match_innovations(exact, noise_of(exact))
    assert "nothing is gained: 3.9 may be chance" in found.summary()
    for name, value in {"C_1": 2.0, "R_1": 70.0, "R_2": 60.0}.items():
        low, high = found.parameters[name].interval
        assert low < value < high
        matched = exact.parameters[name]
        assert found.parameters[name].value == pytest.approx(matched.value, rel=0.02)
    found.save(tmp_path / "fit.toml")
    kept = Fit.load(tmp_path / "fit.toml")
    assert kept.status == found.status
    assert kept.uncertainty.standard_errors == pytest.approx(found.uncertainty.standard_errors)


@pytest.mark.slow
def test_a_fit_from_a_file_is_matched_as_the_fit_itself(exact: Fit, tmp_path: Path):
    exact.save(tmp_path / "fit.toml")
    kept = Fit.load(tmp_path / "fit.toml", experiments=[recording(23.0, 1)])
    noise = noise_of(exact)
    found, again = (match_innovations(fit, noise, max_iterations=1) for fit in (exact, kept))
    for name in FREE:
        assert again.parameters[name].value == pytest.approx(found.parameters[name].value, rel=1e-6)
        errors = [fit.parameters[name].standard_error for fit in (again, found)]
        assert errors[0] == pytest.approx(errors[1], rel=1e-3)


@pytest.mark.slow
def test_a_room_that_nobody_recorded_no_longer_pushes_its_error_into_the_values():
    """The room wanders by kelvins. A match of runs is sure of resistances that are a tenth wrong;
    the filter has a state for the room."""
    walk = np.cumsum(np.random.default_rng(5).normal(0.0, 0.15, 301))
    fit = match(Twin("tclab"), recording(23.0 + walk - walk[0], 2), free=FREE)
    found = match_innovations(fit, noise_of(fit, room=0.106))
    assert "more than the 3.9 of chance" in found.status
    for name, value in {"C_1": 2.0, "R_1": 70.0, "R_2": 60.0}.items():
        low, high = found.parameters[name].interval
        assert low < value < high
        assert high - low < 0.06 * value
    assert fit.parameters["R_1"].interval[1] < 64.0
    assert fit.parameters["R_2"].interval[1] < 54.0


def test_what_is_no_fit_or_no_noise_is_refused(exact: Fit):
    with pytest.raises(ObserverError, match="reading: expected"):
        match_innovations(exact, noise_of(exact, reading=-1.0))
