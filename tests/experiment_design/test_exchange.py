"""The search and its schedules without a simulation: against all schedules, and sums by hand."""

import itertools
import math
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from heated_box import cell_and_heater
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from jaxtwin import Experiment, Twin
from jaxtwin.errors import MatchError
from jaxtwin.experiment_design import ExperimentDesign
from jaxtwin.experiment_design._design_experiment import (
    _expected_events,
    _recorded_bounds,
    _schedules,
    _ScheduleSearch,
)
from jaxtwin.experiment_design._experiment_design import DesignStep, PlannedSchedule
from jaxtwin.experiment_design._information import EvaluatedSchedule
from jaxtwin.experiment_design._schedules import Counts, Schedules, make_schedules
from jaxtwin.experiment_design._search import (
    MAX_PASSES,
    CandidateSchedule,
    Hottest,
    a_objective,
    d_objective,
    exchange,
    random_schedules,
)

COOL = EvaluatedSchedule(np.eye(1), np.eye(1), 40.0, 60.0)


def schedules(**changes: Any) -> Schedules:
    """Three steps of 20 s with a sample every 10 s; levels -102, 0 and 102 of 255 counts."""
    settings = {"duration": 60, "hold": 20, "bounds": (-0.4, 0.4), "levels": 3, "interval": 10.0}
    return make_schedules(Twin("single-cell"), **settings | changes)


def searched(
    objective: Callable[[Counts], float], start: Counts, found: Schedules, seed: int = 0
) -> tuple[CandidateSchedule, list[int]]:
    """The end of the exchange, and the numbers of its passes."""

    def assess(counts: Sequence[Counts]) -> list[CandidateSchedule]:
        return [CandidateSchedule(each, COOL, objective(each)) for each in counts]

    passes: list[int] = []
    (first,) = assess([start])
    best = exchange(first, found, assess, seed, lambda number, candidate: passes.append(number))
    return best, passes


def test_steps_that_do_not_depend_on_each_other_are_best_after_one_pass():
    """The second pass finds nothing more. The best levels are those of the target."""
    target = np.array([[102], [-102], [0]])
    best, passes = searched(lambda c: float(np.abs(c - target).sum()), 0 * target, schedules())
    np.testing.assert_array_equal(best.counts, target)
    assert best.objective == 0
    assert passes == [1, 2]


@pytest.mark.slow
@given(arrays(np.int64, 27, elements=st.integers(0, 50)), st.integers(0, 100))
def test_no_other_level_of_a_single_step_is_better_than_the_end(table: np.ndarray, seed: int):
    """For any objective of the 27 schedules, in hundredths, so that every gain counts."""
    found = schedules()
    every = list(itertools.product(found.levels[0], repeat=3))

    def objective(counts: Counts) -> float:
        return float(table[every.index(tuple(counts.ravel().tolist()))]) / 100

    start = random_schedules(found, 1, seed)[-1]
    best, passes = searched(objective, start, found, seed)
    assert best.objective == objective(best.counts) <= objective(start)
    assert passes == list(range(1, len(passes) + 1))
    assert len(passes) <= MAX_PASSES
    for place, level in itertools.product(range(3), found.levels[0]):
        changed = best.counts.copy()
        changed[place, 0] = level
        assert objective(changed) >= best.objective


@pytest.mark.parametrize(("gain", "passes"), [(1.1e-3, [1, 2]), (0.9e-3, [1])])
def test_a_pass_that_gains_a_tenth_of_a_per_cent_is_followed_by_another(gain, passes):
    target = np.array([[102], [-102], [0]])
    each = gain / np.abs(target).sum()
    best, found = searched(lambda c: each * np.abs(c - target).sum(), 0 * target, schedules())
    np.testing.assert_array_equal(best.counts, target)
    assert found == passes


def test_a_search_that_always_gains_ends_after_ten_passes():
    """An objective that falls by 1 with each evaluation, whatever the schedule."""
    falling = itertools.count(0, -1)
    _, passes = searched(lambda counts: float(next(falling)), np.zeros((3, 1), int), schedules())
    assert passes == list(range(1, MAX_PASSES + 1))
    assert MAX_PASSES == 10


def test_criteria_are_means_of_standard_errors():
    """Of independent errors 1, 2 and 4: the geometric mean, and the root of the mean square."""
    covariance = np.diag([1.0, 4.0, 16.0])
    assert d_objective(covariance) == pytest.approx(math.log(2.0), abs=1e-12)
    assert a_objective(covariance) == pytest.approx(math.log(math.sqrt(7.0)), abs=1e-12)


def test_constant_schedules_come_before_random_ones():
    found = schedules()
    drawn = random_schedules(found, 50, seed=3)
    assert [counts.ravel().tolist() for counts in drawn[:3]] == [
        [level] * 3 for level in (-102, 0, 102)
    ]
    assert len(drawn) == 53
    assert set(np.concatenate(drawn).ravel().tolist()) == {-102, 0, 102}
    assert all(map(np.array_equal, drawn, random_schedules(found, 50, seed=3)))


@pytest.mark.parametrize(
    ("reading", "side", "is_allowed"),
    [(80.0, 130.0, True), (80.1, 130.0, False), (80.0, 130.1, False), (math.nan, 20.0, False)],
)
def test_a_schedule_is_too_hot_where_a_reading_or_a_side_is(
    reading: float, side: float, is_allowed: bool
):
    search = cast("_ScheduleSearch", SimpleNamespace(hottest=Hottest(80.0, 130.0)))
    assert (
        _ScheduleSearch._is_allowed(search, COOL._replace(reading=reading, side=side)) is is_allowed
    )


def test_corrections_are_expected_at_the_median_of_their_intervals():
    """Intervals of 100, 120 and 110 s; none behind the end, none after a single correction."""
    assert _expected_events([[5.0, 105.0, 225.0], [40.0, 150.0]], 330.5) == (110.0, 220.0, 330.0)
    assert _expected_events([[5.0, 105.0, 225.0], [40.0, 150.0]], 330.0) == (110.0, 220.0)
    assert _expected_events([[5.0], []], 600.0) == ()


def test_bounds_are_those_of_the_recordings_and_zero():
    def driven(*duty: float) -> Experiment:
        return Experiment(np.arange(float(len(duty))), np.array(duty)[:, None], channels=("T",))

    assert _recorded_bounds({}, -1.0) == (-1.0, 1.0)
    assert _recorded_bounds({}, 0.0) == (0.0, 1.0)  # of heaters
    assert _recorded_bounds({"a": driven(0.2, 0.5), "b": driven(0.3, 0.7)}, -1.0) == (0.0, 0.7)
    assert _recorded_bounds({"a": driven(-0.2, -0.5)}, -1.0) == (-0.5, 0.0)


def test_a_schedule_holds_each_step_to_the_next():
    """Samples at 0 to 60 s: two of each step, the last one at the end too."""
    found = schedules()
    drive = found.experiment(np.array([[102], [0], [-102]]), "steps")
    np.testing.assert_array_equal(drive.time, 10.0 * np.arange(7))
    np.testing.assert_allclose(255 * drive.duty[:, 0], [102, 102, 0, 0, -102, -102, -102])
    assert (found.duration, drive.name) == (60.0, "steps")
    np.testing.assert_allclose(3 * found.numbered().duty[:, 0], [1, 1, 2, 2, 3, 3, 3])


def test_a_recording_is_resampled_in_the_middle_of_each_step():
    """At 10, 30 and 50 s after its first sample, rounded to counts and cut to the bounds."""
    recording = Experiment(
        [100.0, 111.0, 129.0, 131.0], [[0.1], [0.9], [-0.9], [0.2]], channels=("T",)
    )
    np.testing.assert_array_equal(schedules().resampled(recording), [[26], [-102], [51]])


def test_a_binary_sequence_of_the_longest_period_is_balanced():
    """Over a whole period of 2^n - 1 steps one level occurs once more than the other, and no shift
    of it agrees with it in more than half of the places, rounded (Golomb)."""
    found = schedules(duration=15 * 20)
    counts = found.binary_sequence()[:, 0]
    assert sorted(np.unique(counts, return_counts=True)[1].tolist()) == [7, 8]
    assert {np.sum(counts == np.roll(counts, shift)) for shift in range(1, 15)} == {7}
    assert set(found.binary_sequence(0.5).ravel().tolist()) == {-51, 51}


@pytest.mark.parametrize(
    ("bounds", "expected"),
    [((0.2, 0.8), {51, 127}), ((-0.8, -0.2), {-51, -127}), ((0.0, 1.0), {0, 127})],
)
def test_a_smaller_binary_sequence_stays_within_the_bounds(bounds, expected):
    assert set(schedules(bounds=bounds).binary_sequence(0.5).ravel().tolist()) == expected


def planned(name: str, error: float, is_allowed: bool = True) -> PlannedSchedule:
    drive = Experiment([0.0, 10.0, 20.0], [[0.1], [0.2], [0.2]], channels=("T",))
    return PlannedSchedule(
        name, drive, np.array([[26], [51]]), {"R_E": error, "h": math.inf}, error, 45.5, 70.0,
        is_allowed,
    )  # fmt: skip


def test_a_design_has_the_same_numbers_in_every_form():
    """A value that nothing tells has an infinite error, which JSON does not have."""
    references = {"bench": planned("bench", 0.75), "PRBS": planned("PRBS", 0.6, is_allowed=False)}
    today = {"R_E": 1.0, "h": math.inf}
    found = ExperimentDesign(
        "made", "A", ("R_E", "h"), ("ohm", "W/(m^2 K)"), (2.0, 15.0), today,
        planned("designed", 0.5), references, 10.0, (DesignStep(1, 2, 30, 0.5),),
    )  # fmt: skip
    columns = {"today": 1.0, "designed": 0.5, "bench": 0.75, "PRBS": 0.6}

    frame = found.to_dataframe()
    assert list(frame.columns) == ["unit", "value", *columns]
    assert frame.loc["R_E"].to_dict() == {"unit": "ohm", "value": 2.0, **columns}
    assert np.isinf(frame.loc["h", list(columns)].to_numpy(float)).all()

    dataset = found.to_xarray()
    assert dataset["standard_error"].sel(parameter="R_E").to_series().to_dict() == columns
    np.testing.assert_array_equal(dataset["duty"].sel(cell="P1"), [0.1, 0.2, 0.2])
    assert dataset.attrs == {"rig": "made", "criterion": "A", "hold_s": 10.0}

    numbers = found.to_dict()
    assert numbers["mean_error"] == {"designed": 0.5, "bench": 0.75, "PRBS": None}
    assert numbers["standard_errors"] == {
        name: {"R_E": error, "h": None} for name, error in columns.items()
    }
    assert (numbers["duration_s"], numbers["hold_s"]) == (20.0, 10.0)
    assert numbers["highest_reading_degC"] == 45.5
    assert numbers["schedule"] == "0:0.1,10:0.2"

    assert repr(found) == (
        "<ExperimentDesign of made: 20 s in 2 steps, errors 50 % of today's "
        "(A-optimal; bench 75 %, PRBS 60 % (too hot))>"
    )
    assert str(found.history[0]) == "search 2, pass 2: 30 schedules, errors 50.0 % of today's"
    assert "<td>0.75</td>" in found._repr_html_()


def test_levels_are_those_of_each_cell_and_heater():
    """A cell may cool; a heater has as many levels from 0 on."""
    twin = Twin(cell_and_heater("on-off"))
    found = _schedules(twin, {}, 60, 20, None, 5)
    assert found.counts == 255
    assert found.levels == ((-255, -128, 0, 128, 255), *[(0, 64, 128, 191, 255)] * 2)
    for counts in (*random_schedules(found, 20, 0), *found.binary_sequences()):
        assert counts[:, 1:].min() >= 0
    drawn = np.concatenate(random_schedules(found, 20, 0))
    for cell in range(3):
        assert set(drawn[:, cell]) == set(found.levels[cell])
    cooled = Experiment([0, 30, 60], [[-1.0, 0.5, 0.2]] * 3)
    assert found.resampled(cooled).min(axis=0).tolist() == [-255, 128, 51]
    assert found.experiment(drawn[:3]).cells == ("P1", "foil", "wire")


def test_bounds_in_which_a_heater_has_no_duty_are_refused():
    twin = Twin(cell_and_heater("on-off"))
    with pytest.raises(MatchError, match="expected more than 0, because the heaters of"):
        _schedules(twin, {}, 60, 20, (-1.0, 0.0), 5)
