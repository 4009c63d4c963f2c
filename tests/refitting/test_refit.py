"""Refits: what a session says after an earlier fit, and what the gate makes of it.

The rig is `tclab`, linear but for the delay of its sensors, in sessions of ten minutes. Its fit is
that of two simulated sessions, with a known noise of 0.15 K.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin.cli import run
from jaxtwin.control import PID
from jaxtwin.refitting._forgetting import MIN_DRIFT, session_prior
from jaxtwin.refitting._gate import check_likelihood
from jaxtwin.refitting._held_out import HeldOutReplay, split
from jaxtwin.refitting._sensor_errors import SENSOR_ERRORS, smallest

LENGTH, NOISE = 600, 0.15


def session(seed: int, name: str = "", **values: float) -> jt.Experiment:
    twin = jt.Twin("tclab", values)
    random = np.random.default_rng(seed)
    duty = np.repeat(random.uniform(0.1, 0.9, (LENGTH // 60 + 1, 2)), 60, axis=0)[: LENGTH + 1]
    plan = jt.Experiment(np.arange(LENGTH + 1.0), duty, channels=twin.channels)
    return jt.simulate(twin, plan).to_recording(noise=NOISE, seed=seed, name=name or f"s{seed}")


def with_readings(one: jt.Experiment, readings: np.ndarray) -> jt.Experiment:
    return jt.Experiment(
        one.time, one.duty, channels=one.channels, temperatures=readings, name=one.name
    )


@cache
def last() -> jt.Fit:
    return jt.match(jt.Twin("tclab"), [session(1), session(2)])


@cache
def changed() -> jt.refitting.Refit:
    """After heater 1 lost much of its contact with the room."""
    return jt.refit(last(), session(4, R_1=85.0))


@pytest.mark.slow
def test_the_prior_of_a_session_is_the_posterior_and_what_is_forgotten():
    """Kalman's prediction of a random walk: variances add, and twice the step is four times the
    variance."""
    fit = last()
    size = len([row for row in fit.parameters.values() if row.free and row.scope == "shared"])
    posterior = fit.uncertainty.vector_covariance[:size, :size]
    step = np.diag(fit.uncertainty.between_recordings[:size] ** 2)
    for factor in (0.0, 1.0, 2.0):
        prior = session_prior(fit, "", factor)
        np.testing.assert_allclose(prior.covariance, posterior + factor**2 * step, rtol=1e-12)
        least = MIN_DRIFT**2 * np.eye(size)
        np.testing.assert_allclose(prior.drift, factor**2 * step + least, rtol=1e-12)
    assert [row.name for row in prior.rows] == list(fit.uncertainty.labels[:size])
    values = [row.from_entry(mean) for row, mean in zip(prior.rows, prior.mean, strict=True)]
    np.testing.assert_allclose(values, [fit[row.name].value for row in prior.rows], rtol=1e-9)


def test_the_last_of_several_recordings_is_held_out_or_the_last_third_of_one():
    one, other = session(3), session(5)
    both = frozenset(one.channels)
    single = split([one], 60.0, both)
    assert single.since == (pytest.approx(400.0),)
    assert single.seen[0].time[-1] < 400.0
    several = split([one, other], 60.0, both)
    assert several.seen == (one,)
    assert several.held_out == (other,)
    assert several.since == (0.0,)
    with pytest.raises(jt.errors.MatchError, match="at least 120 s that are held out, got 67 s"):
        split([one.between(0, 201)], 60.0, both)


@pytest.mark.parametrize(("kept", "got"), [(10, 0), (0, 0), (29, 0)])
def test_readings_are_counted_and_not_the_time_that_is_held_out(kept: int, got: int):
    """200 s are held out; of 10 readings among them nothing follows."""
    one = session(3)
    readings = np.array(one.temperatures)
    readings[400 + kept :] = np.nan
    words = f"at least 30 readings of most of the 2 channels .* got them of {got}"
    with pytest.raises(jt.errors.MatchError, match=words):
        split([with_readings(one, readings)], 60.0, frozenset(one.channels))


def test_one_channel_of_two_does_not_show_that_a_twin_predicts_the_rig():
    one = session(3)
    readings = np.array(one.temperatures)
    readings[401:, 1] = np.nan
    with pytest.raises(jt.errors.MatchError, match=r"most of the 2 channels .* got them of 1"):
        split([with_readings(one, readings)], 60.0, frozenset(one.channels))


def held_out(log_likelihood: float, correlation: float = 1.0) -> HeldOutReplay:
    """A replay of 400 readings of which only the likelihood is known."""
    nothing = cast(Any, None)
    return HeldOutReplay(nothing, nothing, log_likelihood, 400, correlation)


def test_a_promotion_takes_a_ratio_of_probabilities_of_20():
    """By the definition of the Bayes factor; of readings that follow each other by twos, half
    count."""
    last = held_out(-100.0)
    assert not check_likelihood(last, held_out(-100.0 + 0.016)).passed
    assert not check_likelihood(last, held_out(-100.0 + math.log(19.0))).passed
    assert check_likelihood(last, held_out(-100.0 + math.log(21.0))).passed
    halved = check_likelihood(last, held_out(-100.0 + math.log(21.0), 2.0))
    assert not halved.passed
    assert halved.verdict == "keep"
    assert halved.value == pytest.approx(math.log(21.0) / 2)
    assert "as 200 independent ones, are 4.58 times more probable" in halved.sentence
    assert "a promotion takes 20 times" in halved.sentence
    assert check_likelihood(last, held_out(-104.0)).verdict == "reject"
    unknown = check_likelihood(last, held_out(math.nan))
    assert not unknown.passed
    assert unknown.verdict == "reject"


def test_the_size_of_an_error_is_the_minimum_of_its_cost_and_prior():
    """Of a parabola and a prior the minimum follows by hand: 0.3 x 100 / (100 + 1 / 0.1^2)."""
    of_gain = SENSOR_ERRORS[0]

    def costs(sizes: Sequence[float]) -> list[float]:
        return [50 * (size - 0.3) ** 2 for size in sizes]

    size, cost = smallest(costs, of_gain, costs([0.0])[0])
    assert size == pytest.approx(0.15)
    assert cost == pytest.approx(50 * 0.15**2 + 0.5 * 1.5**2)


@pytest.mark.slow
def test_a_clock_that_is_fast_is_found_with_its_rate():
    """The times of all readings are 5 % too large."""
    one = session(11)
    fast = jt.Experiment(
        1.05 * one.time, one.duty, channels=one.channels, temperatures=one.temperatures, name="c"
    )
    found = jt.refit(last(), fast)
    assert found.decision in ("rejected", "ask")
    assert "its clock ran 1.05 times as fast" in found.reason


@pytest.mark.slow
@pytest.mark.parametrize("offset", [2.0, -2.0])
def test_an_offset_of_all_readings_is_found_beside_a_recorded_room(offset: float):
    one = session(12)
    wrong = jt.Experiment(
        one.time,
        one.duty,
        channels=one.channels,
        temperatures=np.array(one.temperatures) + offset,
        ambient=23.0,
        name="o",
    )
    found = jt.refit(last(), wrong)
    assert found.decision in ("rejected", "ask")
    side = "high, or its room too low" if offset > 0 else "low, or its room too high"
    assert f"K too {side}" in found.reason


@pytest.mark.slow
def test_an_offset_without_a_recorded_room_is_another_room():
    """Nothing tells the two apart: readings, start and room move together, and so do the
    forecasts."""
    one = session(12)
    found = jt.refit(last(), with_readings(one, np.array(one.temperatures) + 2.0))
    assert found.decision == "unchanged"
    assert found.fit is not None
    rooms = [fit.recording_values for fit in (found.fit, jt.refit(last(), one).fit) if fit]
    moved = [next(iter(each.values()))["T_amb"] for each in rooms]
    assert moved[0] - moved[1] == pytest.approx(2.0, abs=0.3)


@pytest.mark.slow
def test_a_healthy_session_leaves_the_twin_as_it_is():
    found = jt.refit(last(), session(3))
    assert found.decision in ("unchanged", "promoted")
    assert found.changed == ()
    assert not found.is_alarm


@pytest.mark.slow
def test_a_changed_resistance_is_found_by_name_and_size_and_promoted():
    found = changed()
    assert found.decision == "promoted"
    assert found.changed == ("R_1",)
    assert found.fit is not None
    assert found.twin is found.fit
    truth = 85.0 / float(jt.Twin("tclab").values["R_1"])
    assert found.fit["R_1"].value / last()["R_1"].value == pytest.approx(truth, rel=0.15)
    assert found.reason.startswith("R_1 changed from")


@pytest.mark.slow
def test_a_small_change_of_one_value_is_not_taken_for_drift_of_many():
    """By error and distance alone it could be: 1.01 of 1.5, and 0.8 of what drift may be."""
    found = jt.refit(last(), session(4, R_1=63.0))
    assert found.decision == "promoted"
    assert found.changed == ("R_1",)
    assert found.fit is not None
    assert found.fit["R_1"].value == pytest.approx(63.0, rel=0.01)


@pytest.mark.slow
def test_a_refit_is_saved_with_its_prior_and_forgets_by_the_same_spread(tmp_path: Path):
    """One session says nothing of the spread between sessions: it is handed on."""
    found = changed().fit
    assert found is not None
    found.save(tmp_path / "refit.toml")
    loaded = jt.Fit.load(tmp_path / "refit.toml")
    for name in ("R_1", "C_2"):
        assert loaded[name].prior_value == pytest.approx(last()[name].value)
        place = found.uncertainty.labels.index(name)
        known = last().uncertainty.between_recordings[last().uncertainty.labels.index(name)]
        assert loaded.uncertainty.between_recordings[place] == known
    again = jt.refit(loaded, session(6, R_1=85.0))
    assert again.decision in ("unchanged", "promoted")
    assert again.changed == ()


def frozen() -> jt.Experiment:
    one = session(7)
    readings = np.array(one.temperatures)
    readings[250:, 0] = readings[250, 0]
    return with_readings(one, readings)


def exchanged() -> jt.Experiment:
    one = session(8)
    return with_readings(one, np.array(one.temperatures)[:, ::-1])


def other_counts() -> jt.Experiment:
    one = session(9)
    return jt.Experiment(
        one.time, 0.6 * one.duty, channels=one.channels, temperatures=one.temperatures, name="d"
    )


def another_rig() -> jt.Experiment:
    return session(10, C_1=5.0, C_2=1.0, R_1=100.0, R_2=35.0, P_2=1.4, tau_1=60.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("made", "check", "words"),
    [
        (frozen, "readings", "T1 does not change any more from 2"),
        (exchanged, "mistakes", "if its channels T1 and T2 were exchanged"),
        (other_counts, "mistakes", "if its duty were 1.7 times as large"),
        (another_rig, "changes", "another rig"),
    ],
)
def test_a_poisoned_session_is_rejected_with_the_reason(
    made: Callable[[], jt.Experiment], check: str, words: str
):
    found = jt.refit(last(), made())
    assert found.decision == "rejected"
    assert found.twin is last()
    first = next(one for one in found.failed if one.verdict == "reject")
    assert first.name == check
    assert words in found.reason
    assert found.is_alarm == (check == "readings")


@pytest.mark.slow
def test_a_loop_that_the_new_twin_does_not_bear_is_asked_about():
    """A gain of 3 is beyond what the lag of the sensor allows."""
    found = jt.refit(
        last(), session(4, R_1=85.0), controller=PID(Kp=3.0, Ki=0.1, sample_time_s=1.0)
    )
    assert found.decision == "ask"
    assert [check.name for check in found.failed] == ["loop"]
    assert "loop of the controller" in found.reason


@pytest.mark.slow
def test_recordings_that_a_fit_has_seen_are_refused():
    with pytest.raises(
        jt.errors.MatchError, match="has not seen, got 's1', which it was matched to"
    ):
        jt.refit(last(), session(1))
    with pytest.raises(
        jt.errors.MatchError, match="forgetting: expected a number of at least 0, got -1"
    ):
        jt.refit(last(), session(3), forgetting=-1)
    with pytest.raises(jt.errors.MatchError, match="window: expected a number above 0, in s"):
        jt.refit(last(), session(3), window=0)


@pytest.mark.slow
def test_the_command_keeps_a_store_and_judges_each_recording_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """A changed session is promoted, a frozen one is an alarm and changes nothing, and the next
    night there is nothing to do."""
    last().save(tmp_path / "fit.toml")
    sessions, store = tmp_path / "sessions", tmp_path / "twins.db"
    sessions.mkdir()
    assert run(["twins", "add", str(store), str(tmp_path / "fit.toml")]) == 0
    words = ["refit", str(store), "--recordings", str(sessions)]
    jt.write_recording(session(4, R_1=85.0), sessions / "a.csv")
    assert run(words) == 0
    assert "a.csv: promoted: R_1 changed from" in capsys.readouterr().out
    twins = jt.TwinStore(store)
    assert twins.aliases == {"champion": 2, "previous": 1}
    assert twins.version(2).parent == 1
    jt.write_recording(frozen(), sessions / "b.csv")
    (sessions / "c.csv").write_text("time_s,nothing\n0,1\n")
    assert run(words) == 5
    said = capsys.readouterr().out
    assert "b.csv: rejected:" in said
    assert "c.csv: rejected:" in said
    assert twins.aliases == {"champion": 2, "previous": 1}
    (sessions / "c.csv").unlink()
    assert run(words) == 0
    assert "no new recording; the champion is version 2" in capsys.readouterr().out
    assert run(["twins", "rollback", str(store), "--reason", "a test"]) == 0
    assert twins.aliases == {"champion": 1, "previous": 2}
