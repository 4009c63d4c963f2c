"""Matches and predictions of recordings whose temperatures at the start are given."""

from pathlib import Path

import numpy as np
import pytest

from jaxtwin import Experiment, Fit, Twin, match, simulate, validate
from jaxtwin.errors import MatchError, SimulationError

TRUTH = Twin("single-cell", {"C_load": 24.0, "T_amb": 20.0, "T_start": 16.0, "T_sink": 16.0})
WARM = 45.0


def warm(schedule: str, seed: int, initial: float | str | np.ndarray) -> Experiment:
    """Four minutes that begin as given, not as the parameters say, with noise of 0.05 K."""
    drive = Experiment.schedule(schedule, duration=240)
    seen = simulate(TRUTH, drive, initial=initial).temperatures
    seen = seen + 0.05 * np.random.default_rng(seed).standard_normal(seen.shape)
    return Experiment(
        drive.time, drive.duty, channels=("T",), temperatures=seen, ambient=20.0, name=f"day {seed}"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "initial",
    [pytest.param(WARM, marks=pytest.mark.long), "steady", np.array([45.0, 40.0, 30.0, 28.0])],
)
def test_a_match_from_given_temperatures_finds_the_truth(
    initial: float | str | np.ndarray, tmp_path: Path
):
    """Loaded again with its recording, it has the same run and band."""
    seen = warm("0:0.3,60:0.6,150:-0.3", 1, initial)
    fit = match(Twin("single-cell", TRUTH.values), seen, free=["C_load"], initial=initial)
    assert fit["C_load"].value == pytest.approx(24.0, rel=0.02)
    assert fit.rmse == pytest.approx(0.05, rel=0.15)
    fit.save(tmp_path / "fit.toml")
    loaded = Fit.load(tmp_path / "fit.toml", experiments=seen)
    (here,), (there,) = fit.runs.values(), loaded.runs.values()
    np.testing.assert_allclose(there.temperatures, here.temperatures, atol=1e-9)
    (prediction,) = validate(
        fit, warm("0:0.5,60:0,150:0.3", 2, initial), initial=initial
    ).predictions
    assert not {"T_start", "T_sink"} & {*prediction.estimated}
    assert prediction.run.rmse < 0.1
    assert prediction.band is not None
    assert prediction.band.coverage[0] > 0.9


@pytest.mark.slow
def test_parameters_of_the_start_are_held_where_the_start_is_given():
    seen = warm("0:0.3", 1, WARM)
    fit = match(TRUTH, seen, initial=WARM, max_iterations=1)
    assert not fit["T_start"].free
    assert not fit["T_sink"].free
    with pytest.raises(MatchError, match="T_start: expected in either free or fixed"):
        match(TRUTH, seen, initial=WARM, free=["T_start"])


def test_invalid_temperatures_at_the_start_are_refused():
    seen = warm("0:0.3", 1, WARM)
    with pytest.raises(SimulationError, match="initial: expected None"):
        match(TRUTH, seen, initial="warm")
    with pytest.raises(SimulationError, match="initial: expected None"):
        validate(TRUTH, seen, initial=[1.0, 2.0])
