"""Prediction bands hold what they promise on recordings that the match has not seen."""

import numpy as np
import pytest

from jaxtwin import Experiment, Fit, Twin, match, prediction_band, simulate
from jaxtwin.errors import MatchError
from jaxtwin.matching import estimate_initial_conditions

FREE = ["C_load", "R_loss", "R_ph", "T_amb", "T_start", "T_sink"]
ROOM, NOISE = 15.5, 0.1
LENGTH = 400


def session(seed: int, warm: bool) -> Experiment:
    """A session of a rig whose load differs by 5 % from day to day, driven from the start on; one
    that begins warm has a load and a sink that have not cooled down from the one before."""
    rng = np.random.default_rng(seed)
    above = rng.uniform(2.0, 6.0) * np.array([1.0, 0.5]) if warm else np.zeros(2)
    room = ROOM + 0.3 * rng.standard_normal()
    values = {
        "C_load": 24.0 * np.exp(0.05 * rng.standard_normal()),
        "T_amb": room,
        "T_start": room + above[0],
        "T_sink": room + above[1],
    }
    levels = rng.uniform(-0.3, 0.5, 4)
    steps = zip((0, 90, 180, 290), levels, strict=True)
    schedule = ",".join(f"{start}:{level:.3f}" for start, level in steps)
    drive = Experiment.schedule(schedule, duration=LENGTH)
    read = simulate(Twin("single-cell", values), drive).temperatures
    read = read + NOISE * rng.standard_normal(read.shape)
    return Experiment(drive.time, drive.duty, channels=("T",), temperatures=read, name=f"{seed}")


@pytest.fixture(scope="module")
def fit() -> Fit:
    return match(Twin("single-cell"), [session(seed, False) for seed in range(4)], free=FREE)


@pytest.fixture(scope="module")
def unseen() -> list[Experiment]:
    return [session(100 + number, number % 2 == 1) for number in range(10)]


@pytest.mark.slow
def test_a_band_holds_95_percent_of_readings_that_were_not_matched(
    fit: Fit, unseen: list[Experiment]
):
    """Cold starts and warm ones; the first minute, from which the start is estimated, apart."""
    inside = []
    for session in unseen:
        band = prediction_band(fit, experiment=session)
        late = session.time >= 60
        assert session.temperatures is not None
        held = (band.lower <= session.temperatures) & (session.temperatures <= band.upper)
        inside.append(held[late].mean())
    assert np.mean(inside) >= 0.9
    assert np.mean(inside[1::2]) >= 0.88


@pytest.mark.slow
def test_the_mean_width_of_a_band_is_below_5_kelvin(fit: Fit, unseen: list[Experiment]):
    """A load that is 5 % off moves a reading by a kelvin, not by ten."""
    band = prediction_band(fit, experiment=unseen[0])
    assert np.mean(band.upper - band.lower) < 5.0


@pytest.mark.slow
def test_a_warm_load_is_not_taken_for_a_warm_room(fit: Fit, unseen: list[Experiment]):
    """The room is known from the matched sessions to a kelvin; the load is 2 to 6 K warmer."""
    for session in unseen[1::2]:
        found = estimate_initial_conditions(fit, session)
        assert found.values["T_amb"] == pytest.approx(ROOM, abs=1.5)
        assert session.temperatures is not None
        assert found.values["T_start"] == pytest.approx(session.temperatures[0, 0], abs=1.0)


@pytest.mark.slow
def test_what_the_first_minute_does_not_show_is_said(fit: Fit, unseen: list[Experiment]):
    """Driven from the start on, the load says little of its room and its sink."""
    warnings = [w for session in unseen for w in estimate_initial_conditions(fit, session).warnings]
    assert any(": the first 60 s hardly show it, " in warning for warning in warnings)


@pytest.mark.slow
def test_a_recording_of_the_match_needs_no_estimate(fit: Fit):
    """Its own values were matched: the band is as wide as the noise of a reading asks for."""
    (session, *_) = fit.experiments
    band = prediction_band(fit, session.name)
    assert session.temperatures is not None
    held = (band.lower <= session.temperatures) & (session.temperatures <= band.upper)
    assert 0.9 <= held.mean() <= 1.0


@pytest.mark.slow
def test_a_band_follows_the_twin(fit: Fit):
    """The middle is the fitted run itself, however wide its parameters' intervals are."""
    (session, *_) = fit.experiments
    band = prediction_band(fit, session.name)
    np.testing.assert_allclose(band.middle, fit.runs[session.name].temperatures, atol=1e-9)
    narrow = prediction_band(fit, session.name, level=0.5)
    ratio = (narrow.upper - narrow.lower) / (band.upper - band.lower)
    np.testing.assert_allclose(ratio, 0.6745 / 1.9600, rtol=1e-4)


@pytest.mark.slow
def test_bands_that_cannot_be_drawn_say_why(fit: Fit, unseen: list[Experiment]):
    with pytest.raises(MatchError, match="recording: expected one of 0, 1, 2, 3, got 'monday'"):
        prediction_band(fit, "monday")
    with pytest.raises(MatchError, match=r"level: expected a number between 0 and 1, got 2\.0"):
        prediction_band(fit, level=2.0)
    with pytest.raises(MatchError, match=r"warm_up = 1 s: expected at least .* got 1"):
        prediction_band(fit, experiment=unseen[0], warm_up=1.0)
