"""Profile likelihoods on a rig without priors: their scale, and how often they hold the truth."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from jaxtwin import Experiment, Fit, Twin, load_rig, match_many, profile, simulate

FREE = ["T_amb", "T_start"]
TRUTH = {"T_amb": 20.0, "T_start": 26.0}
NOISE = 0.1
TIMES = 200
SEEDS = 60


@cache
def bare() -> Twin:
    """The single cell with nothing known beforehand: its cost is eq. (11), in K^2."""
    rig = load_rig("single-cell")
    table = {
        name: replace(row, prior_value=None, prior_spread=None)
        for name, row in rig.parameters.items()
    }
    assert rig.common_error is None
    return Twin(replace(rig, parameters=table))


@cache
def cooling() -> Experiment:
    """Switched off: the readings are linear in the temperatures of the room and of the start."""
    return Experiment.schedule("0:0", duration=2.0 * (TIMES - 1), step=2.0, channels=("T",))


@cache
def clean() -> np.ndarray:
    return simulate(bare().with_values(TRUTH), cooling()).temperatures


def noise(seed: int, rho: float) -> np.ndarray:
    """First order autoregression of the standard deviation `NOISE`."""
    white = np.random.default_rng(seed).standard_normal(TIMES + 100)
    return NOISE * np.sqrt(1 - rho**2) * lfilter([1.0], [1.0, -rho], white)[100:]


def recording(seed: int, rho: float) -> Experiment:
    drive = cooling()
    seen = clean() + noise(seed, rho)[:, None]
    return Experiment(drive.time, drive.duty, channels=("T",), temperatures=seen, name="cooling")


@cache
def fits(rho: float) -> tuple[Fit, ...]:
    sets = [[recording(seed, rho)] for seed in range(SEEDS)]
    found = match_many(bare(), sets, free=FREE, shared=FREE)
    return tuple(fit for fit in found if fit is not None)


def known_error(name: str, rho: float) -> float:
    """Standard error of ordinary least squares in noise that is known, from two differences."""
    truth = bare().with_values(TRUTH)
    moved = [truth.with_values({name: TRUTH[name] + 0.5}) for name in FREE]
    slopes = np.column_stack(
        [(simulate(twin, cooling()).temperatures - clean()) / 0.5 for twin in moved]
    )
    lags = np.abs(np.subtract.outer(np.arange(TIMES), np.arange(TIMES)))
    inverse = np.linalg.inv(slopes.T @ slopes)
    covariance = inverse @ slopes.T @ (NOISE**2 * rho**lags) @ slopes @ inverse
    return float(np.sqrt(np.diag(covariance)[FREE.index(name)]))


@pytest.mark.slow
@pytest.mark.parametrize("rho", [pytest.param(0.0, marks=pytest.mark.long), 0.8])
def test_the_excess_at_three_standard_errors_is_nine(rho: float):
    """A parabola of the curvature 1 / se^2, by hand; in K^2 it would be a hundredth of that."""
    fit = fits(rho)[0]
    row = fit["T_start"]
    steps = np.array([-3.0, -1.0, 1.0, 3.0])
    found = profile(fit, "T_start", row.value + steps * row.standard_error)
    np.testing.assert_allclose(found.excess, steps**2, rtol=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("rho", [pytest.param(0.0, marks=pytest.mark.long), 0.8])
def test_the_interval_holds_the_truth_in_95_of_100_and_is_no_wider_than_needed(rho: float):
    """Of 60 intervals of 95 %, 51 or more hold the truth but for one study in a thousand."""
    intervals = np.array([profile(fit, "T_start", points=5).interval for fit in fits(rho)])
    assert len(intervals) == SEEDS
    inside = (intervals[:, 0] < TRUTH["T_start"]) & (TRUTH["T_start"] < intervals[:, 1])
    assert inside.sum() >= 51
    width = np.median(np.diff(intervals))
    assert width == pytest.approx(2 * 1.96 * known_error("T_start", rho), rel=0.15)


@pytest.mark.slow
def test_a_parameter_at_its_bound_has_an_interval_on_the_other_side():
    """The room is held too warm by its bound: what is inside it is measured by the same noise."""
    (fit,) = match_many(
        bare().with_values({"T_amb": 22.0}),
        [[recording(0, 0.0)]],
        free=FREE,
        shared=FREE,
        bounds={"T_amb": (21.0, 30.0)},
    )
    assert fit is not None
    assert fit["T_amb"].at_bound
    found = profile(fit, "T_amb", [21.0, 21.1, 21.2, 21.4, 22.0])
    assert found.interval[0] == 21.0
    assert 21.0 < found.interval[1] < 22.0
