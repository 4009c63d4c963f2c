"""Refits: what a session says after an earlier fit, and what the gate makes of it.

The rig is `tclab`, linear but for the delay of its sensors, in sessions of ten minutes. Its fit is
that of two simulated sessions, with a known noise of 0.15 K.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin.cli import run
from jaxtwin.control import PID
from jaxtwin.refitting._forgetting import LEAST_DRIFT, session_prior
from jaxtwin.refitting._held_out import split

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
def changed() -> jt.Refit:
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
        least = LEAST_DRIFT**2 * np.eye(size)
        np.testing.assert_allclose(prior.drift, factor**2 * step + least, rtol=1e-12)
    assert [row.name for row in prior.rows] == list(fit.uncertainty.labels[:size])
    values = [row.from_entry(mean) for row, mean in zip(prior.rows, prior.mean, strict=True)]
    np.testing.assert_allclose(values, [fit[row.name].value for row in prior.rows], rtol=1e-9)


def test_the_last_of_several_recordings_is_held_out_or_the_last_third_of_one():
    one, other = session(3), session(5)
    single = split([one], 60.0)
    assert single.since == (pytest.approx(400.0),)
    assert single.seen[0].time[-1] < 400.0
    several = split([one, other], 60.0)
    assert several.seen == (one,)
    assert several.held_out == (other,)
    assert several.since == (0.0,)
    with pytest.raises(jt.MatchError, match="at least 120 s that are held out, got 67 s"):
        split([one.between(0, 201)], 60.0)


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
    with pytest.raises(jt.MatchError, match="has not seen, got 's1', which it was matched to"):
        jt.refit(last(), session(1))
    with pytest.raises(jt.MatchError, match="forgetting: expected a number above 0, got -1"):
        jt.refit(last(), session(3), forgetting=-1)
    with pytest.raises(jt.MatchError, match="window: expected a number of seconds above 0"):
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
