"""The schedule that tells faults apart soonest, beside all schedules and by hand."""

import itertools
import math

import numpy as np
import pytest
from faulty_runs import bench

import jaxtwin as jt
from jaxtwin.experiment_design import DiagnosisDesign
from jaxtwin.experiment_design._diagnosis_design import (
    EvidenceProblem,
    SeparationEvidence,
    _crossing,
)
from jaxtwin.experiment_design._schedules import make_schedules

PAIR = ["loosen H1", "age H1"]


@pytest.mark.slow
def test_of_all_schedules_the_best_is_found():
    """Four of two cells, two levels and a single step."""
    design = jt.design_experiment(
        bench(), purpose="diagnosis", faults=PAIR, duration=120, hold=120, levels=2
    )
    schedules = make_schedules(
        bench(), duration=120, hold=120, bounds=(0.0, 1.0), levels=2, interval=1.0
    )
    problem = EvidenceProblem(bench(), PAIR, None, schedules)
    counts = [
        np.array([pair]) for pair in itertools.product([0, bench().rig.driver.counts], repeat=2)
    ]
    every = problem.evaluate(schedules, counts)
    assert design.best.separation == pytest.approx(min(one.separation for one in every))
    assert design.best.separation <= min(one.separation for one in design.references.values())
    # Without any duty there is no heat, and nothing that these faults change.
    assert every[0].odds[-1] == pytest.approx(0.0, abs=1e-6)
    assert math.isinf(every[0].separation)


@pytest.mark.slow
def test_the_time_is_that_of_isolability():
    """The same duty, with the onset at the start, of which a sample is left out."""
    schedules = make_schedules(
        bench(), duration=240, hold=120, bounds=(0.0, 1.0), levels=2, interval=1.0
    )
    counts = np.array([[1, 0], [0, 1]]) * bench().rig.driver.counts
    (found,) = EvidenceProblem(bench(), PAIR, None, schedules).evaluate(schedules, [counts])
    duty = schedules.experiment(counts)
    known = jt.isolability(bench(), duty=duty, faults=PAIR, onset=0.0, duration=240)
    later = max(known.separation[0, 1], known.separation[1, 0])
    assert later - 1 <= found.separation <= later + 1e-9


@pytest.mark.slow
def test_faults_that_look_alike_are_told_apart_by_nothing():
    """V² / R: a weak supply of a heater, and a higher resistance of it."""
    design = jt.design_experiment(
        bench(), purpose="diagnosis", faults=["age H1", "weaken H1"], duration=60, hold=60, levels=2
    )
    assert math.isinf(design.best.separation)
    assert set(design.best.hardest) == {"age H1", "weaken H1"}
    assert "not until the end" in design.summary()
    assert design.to_dict()["separation_s"]["designed"] is None
    assert [step.number for step in design.history] == [0]  # nothing to search for


def test_what_is_known_at_the_end_counts_where_nothing_is_told_apart():
    time = np.array([10.0, 20.0])
    little, more = (
        SeparationEvidence(time, np.array([0.0, odds]), math.inf, ("a", "b"), 0.0, 0.0)
        for odds in (0.1, 1.0)
    )
    told = SeparationEvidence(time, np.array([1.0, 9.0]), 15.0, ("a", "b"), 0.0, 0.0)
    assert told.objective == 15.0
    assert told.objective < 20.0 < more.objective < little.objective


def test_between_two_samples_the_time_is_that_of_a_line():
    """The time from which one cause is twenty times as likely as the other: no tie any more."""
    enough = math.log(20)
    time = np.array([10.0, 20.0, 30.0])
    assert _crossing(time, np.array([0.0, 0.0, 2 * enough])) == 25.0
    assert _crossing(time, np.array([2 * enough, 3 * enough, 4 * enough])) == 5.0
    assert _crossing(time, np.zeros(3)) == math.inf


@pytest.mark.slow
def test_a_schedule_that_gets_too_hot_is_left_out():
    """tclab at full duty of both heaters passes 50 °C; its limit is 85 °C."""
    design = jt.design_experiment(
        bench(), purpose="diagnosis", faults=PAIR, duration=120, hold=60, levels=3, margin=45
    )
    assert design.best.is_allowed
    assert design.best.highest_reading <= 40.0
    with pytest.raises(jt.errors.MatchError, match="expected a schedule whose readings stay below"):
        jt.design_experiment(
            bench(), purpose="diagnosis", faults=PAIR, duration=60, hold=60, margin=80
        )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"purpose": "diagnosis", "faults": ["age H1"]}, "two or more that are to be told apart"),
        ({"purpose": "diagnosis", "faults": PAIR, "names": ["R_1"]}, "names: expected none"),
        ({"purpose": "diagnosis", "faults": PAIR, "criterion": "A"}, "criterion: expected none"),
        ({"purpose": "diagnosis", "faults": ["age H1", "age H9"]}, "age H9"),
        ({"faults": PAIR}, 'add purpose="diagnosis"'),
    ],
)
def test_what_cannot_be_done_is_refused_in_one_sentence(options: dict, message: str):
    with pytest.raises((jt.errors.MatchError, jt.errors.ObserverError)) as problem:
        jt.design_experiment(bench(), duration=60, hold=60, **options)
    assert message in str(problem.value)


@pytest.mark.slow
def test_the_schedule_can_be_driven_and_the_numbers_taken_along(tmp_path):
    design = jt.design_experiment(
        bench(), purpose="diagnosis", faults=PAIR, duration=60, hold=60, levels=2
    )
    assert isinstance(design, DiagnosisDesign)
    plan = jt.read_recording(design.save(tmp_path / "test.csv"), rig=bench().rig)
    np.testing.assert_allclose(plan.duty, design.schedule.duty)
    again = jt.Experiment.schedule(design.text, duration=60, cells=2)
    np.testing.assert_allclose(again.duty[0], design.schedule.duty[0], atol=1e-3)
    data = design.to_xarray()
    assert data.odds.shape == (3, len(design.best.time))
    table = design.to_dataframe()
    assert list(table.index) == ["designed", "constant", "PRBS"]
