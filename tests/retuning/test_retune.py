"""Retuning: what is tried, what is decided, and what a band allows.

The rig is `tclab`, two heaters.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from tuned_board import DESIGN, LENGTH, REFERENCES, fit, pid, text

import jaxtwin as jt
from jaxtwin._jax_settings import own_settings
from jaxtwin.control import PID, Decision
from jaxtwin.errors import ControlError
from jaxtwin.retuning import (
    LoopBand,
    LoopWatch,
    Retuned,
    TrialScenario,
    keep_retuned,
    pair_of,
    usual_scenarios,
)
from jaxtwin.retuning._loop_band import MIN_REST, PATIENCE, WINDOW

STEPS = TrialScenario("steps", "the references")
HALF = TrialScenario("half", "half the voltage", faults=(("weaken", "supply", 0.7),))


@cache
def accepted() -> Retuned:
    return jt.retune(fit(), pid(), REFERENCES, duration=LENGTH, scenarios=[STEPS, HALF], draws=4)


@pytest.mark.slow
def test_a_sluggish_controller_is_replaced_and_the_trial_says_why():
    found = accepted()
    assert found.decision == "accepted", found.summary()
    assert found.controller is found.candidate
    assert [trial.scenario.name for trial in found.trials] == ["steps", "half"]
    assert all(trial.candidate.cost < trial.present.cost for trial in found.trials)
    assert found.sensitivity_peak <= 2.002
    assert found.controller.limits == pid().limits
    assert "all 2 scenarios were passed" in found.reason
    lines = found.summary().splitlines()
    assert lines[0] == f"accepted: {found.reason}"
    assert len(found.to_dict()["scenarios"]) == len(found.to_dataframe()) == 2


def test_a_controller_that_is_tuned_already_stays():
    first = accepted()
    again = jt.retune(
        fit(), first.controller, REFERENCES, duration=LENGTH, scenarios=[STEPS], draws=4
    )
    assert again.decision == "unchanged"
    assert again.controller is again.present


def test_a_fragile_controller_is_replaced_though_it_is_as_quick():
    found = jt.retune(
        fit(), pid(0.6), REFERENCES, duration=LENGTH, scenarios=[STEPS], draws=4, allowance=1.0
    )
    assert found.decision == "accepted"
    assert found.reason.startswith("the sensitivity peak is up to")
    assert found.sensitivity_peak <= 2.002


def test_a_candidate_that_becomes_too_hot_is_rejected_and_kept():
    """The limit of the rig lies below the references."""
    one = fit()
    limits = one.twin.rig.limits
    assert limits is not None
    cold = replace(one.twin.rig, limits=replace(limits, temperature=273.15 + 33))
    found = jt.retune(
        replace(one, twin=jt.Twin(cold, dict(one.twin.values))),
        pid(),
        REFERENCES,
        duration=LENGTH,
        scenarios=[STEPS],
        draws=4,
    )
    assert found.decision == "rejected"
    assert found.reason.startswith("steps: the limits of temperature are kept in 0 % of the draws")
    assert found.candidate is not None
    assert found.controller is found.present


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"objective": {"energy": -1.0}}, "energy: expected a weight of at least 0"),
        ({"objective": "speed"}, "objective"),
        ({"references": 300.0}, "can hold"),
        ({"scenarios": []}, "at least one"),
        ({"allowance": -0.1}, "allowance"),
        ({"draws": 0}, "draws"),
    ],
)
def test_what_is_impossible_is_refused(more: Mapping[str, Any], message: str):
    given = {"references": REFERENCES, "duration": LENGTH, "scenarios": [STEPS], "draws": 2}
    with pytest.raises(ControlError, match=message):
        jt.retune(fit(), pid(), **{**given, **more})


def test_a_room_in_which_no_duty_holds_the_references_is_not_tried():
    cold = TrialScenario("cold", "a room of -40 degC", {"ambient": -40.0, "initial": -40.0})
    found = jt.retune(fit(), pid(), REFERENCES, duration=LENGTH, scenarios=[STEPS, cold], draws=4)
    assert [trial.is_tried for trial in found.trials] == [True, False]
    assert "all 1 scenarios" in found.reason
    assert "not tried cold: references: expected" in found.summary()


def test_a_scenario_that_is_none_is_refused_and_not_passed():
    wrong = TrialScenario("wrong", "a channel that is not there", {"failed_channels": {"T9": 1.0}})
    with pytest.raises(ControlError, match="T9"):
        jt.retune(fit(), pid(), REFERENCES, duration=LENGTH, scenarios=[STEPS, wrong], draws=2)


def test_nothing_is_tuned_on_a_match_that_has_not_converged():
    one = replace(fit(), converged=False)
    found = jt.retune(one, pid(), REFERENCES, duration=LENGTH, scenarios=[STEPS], draws=2)
    assert found.decision == "rejected"
    assert found.reason.startswith("the match of the twin has not converged")
    assert found.candidate is None
    assert len(found.to_dataframe()) == 0


def test_a_band_that_is_none_is_refused(tmp_path: Path):
    store = jt.TwinStore(tmp_path / "twins.db")
    one = store.add(fit(), reason="by hand", controller=text(pid()), trial={"band": {"rest": 1}})
    with pytest.raises(ControlError, match=r"twins.db@1: trial.band: expected"):
        pair_of(one, fit().twin.rig)


def test_the_usual_scenarios_are_those_that_a_rig_can_have():
    names = {one.name for one in usual_scenarios(jt.Twin("tclab"), pid(), 600.0)}
    assert {"steps", "warm room", "cold room", "twice the delay", "saturated supply"} <= names
    assert {"gain -30 %", "gain +30 %", "sensor lost", "age H1"} <= names
    assert "door" not in names  # without a plate
    single = {one.name for one in usual_scenarios(jt.Twin("single-cell"), PID(0.1), 600.0)}
    assert {"hand", "door", "loosen P1", "block P1"} <= single
    assert "sensor lost" not in single


def test_all_scenarios_have_equations_of_one_form():
    """So that they share the programs of their loops."""
    twin = jt.Twin("single-cell")
    with own_settings():
        forms = {
            jax.tree.structure(one.fault(twin)(twin.system()))
            for one in usual_scenarios(twin, PID(0.1), 600.0)
        }
    assert len(forms) == 1


def band() -> LoopBand:
    """Of an error that falls from 10 K by a tenth each second, and of one that stays at 0.2 K."""
    time = np.arange(400.0)
    error = np.where(time < 200, 10 * np.exp(-time / 10), 10 * np.exp(-(time - 200) / 10)) + 0.2
    reference = np.where(time < 200, 30.0, 40.0)[:, None]
    return LoopBand.of(time, reference, 10.0, error[None])


def test_a_band_contains_the_loops_that_it_was_made_of():
    made = band()
    assert made.rest == pytest.approx(0.2, abs=0.01)
    assert made.largest_step == 10.0
    assert made.after_step[-1] == pytest.approx(0.0, abs=0.01)
    assert made.allowed(0.0, 10.0) >= 10.0
    assert made.allowed(1e9, 10.0) == pytest.approx(0.3, abs=0.02)
    assert made.allowed(0.0, 0.0) == pytest.approx(0.3, abs=0.02)
    # A step of twice the size takes twice as long.
    assert made.allowed(200.0, 20.0) > 1.9 * (made.allowed(100.0, 10.0) - 0.3)
    assert LoopBand.of_dict(made.to_dict()) == made
    assert LoopBand(0.0, (0.0,), 0.0).allowed(0.0, 0.0) == MIN_REST


def seen(watch: LoopWatch, error: np.ndarray, since: float = 0.0) -> list[str]:
    return [
        watch.update(Decision(since + at, np.array([30.0]), np.array([30.0 - one]), np.zeros(1)))
        for at, one in enumerate(error)
    ]


def test_a_loop_that_swings_is_worse_than_its_band_and_one_at_rest_is_not():
    watch = LoopWatch(band())
    quiet = 0.2 * np.ones(100)
    assert not any(seen(watch, quiet))
    assert watch.is_at_rest
    assert watch.time == pytest.approx(99.0)
    swinging = 1.0 * np.sin(np.arange(300) / 5)
    said = seen(watch, swinging, 100.0)
    first = next(number for number, text in enumerate(said) if text)
    assert first <= WINDOW + PATIENCE + 1
    assert "above the 0.3 K of its trial" in said[first]
    assert not watch.is_at_rest


def test_an_error_after_a_step_is_worse_only_if_it_stays():
    quick, slow = LoopWatch(band()), LoopWatch(band())
    time = np.arange(300.0)
    assert not any(seen(quick, 10 * np.exp(-time / 10)))
    assert any(seen(slow, 10 * np.exp(-time / 200)))


def test_an_accepted_controller_is_kept_as_a_pair_that_can_be_rolled_back(tmp_path: Path):
    store = jt.TwinStore(tmp_path / "twins.db")
    first = store.add(fit(), reason="first", aliases=["champion"], controller=text(pid()))
    kept = keep_retuned(store, first, accepted(), DESIGN)
    assert kept is not None
    assert (kept.parent, kept.reason) == (first.number, accepted().reason)
    assert kept.aliases == ("challenger",)
    pair = pair_of(kept, fit().twin.rig)
    assert pair is not None
    assert pair.design == DESIGN
    assert pair.band == accepted().band
    candidate = accepted().candidate
    assert isinstance(pair.controller, PID)
    assert isinstance(candidate, PID)
    np.testing.assert_allclose(pair.controller.Kp, candidate.Kp, rtol=1e-12)
    assert [one["name"] for one in kept.trial["scenarios"]] == ["steps", "half"]
    store.promote(reason="all scenarios were passed")
    back = pair_of(store.rollback(reason="the loop swings"), fit().twin.rig)
    assert back is not None
    assert back.controller == pid().for_rig(fit().twin.rig)


def test_a_rejected_candidate_is_kept_with_its_reason(tmp_path: Path):
    store = jt.TwinStore(tmp_path / "twins.db")
    first = store.add(fit(), reason="first", aliases=["champion"])
    assert pair_of(first, fit().twin.rig) is None
    found = replace(accepted(), decision="rejected", reason="door: too hot")
    assert keep_retuned(store, first, found, DESIGN) is None
    (tag,) = store.version(1).tags.values()
    assert tag.startswith('rejected: door: too hot; from, to: {"Kp')
    assert store.aliases == {"champion": 1}
