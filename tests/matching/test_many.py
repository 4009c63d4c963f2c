"""Many sets of recordings at once: what one of them cannot spoil for the others."""

import pickle
from concurrent.futures import Future
from typing import Any

import jax
import numpy as np
import pytest

from jaxtwin import Experiment, Fit, Twin, match, match_many, simulate
from jaxtwin.errors import MatchError, SimulationError
from jaxtwin.matching import Huber, _descent, _match

FREE = ["C_load", "T_amb", "T_start"]
TRUTH = {"C_load": 24.0, "T_amb": 20.0, "T_start": 18.5}


def recording(seed: int) -> Experiment:
    """Two minutes of a known single cell, with white noise."""
    drive = Experiment.schedule("0:0.4,60:-0.3", duration=120, channels=("T",))
    seen = simulate(Twin("single-cell", TRUTH), drive).temperatures
    seen = seen + 0.05 * np.random.default_rng(seed).standard_normal(seen.shape)
    return read(drive, seen, f"bench {seed}")


def read(drive: Experiment, temperatures: np.ndarray, name: str = "bench") -> Experiment:
    return Experiment(
        drive.time,
        drive.duty,
        channels=drive.channels,
        temperatures=temperatures,
        ambient=drive.ambient,
        name=name,
    )


def spoiled(recording: Experiment, added: np.ndarray | float) -> Experiment:
    assert recording.temperatures is not None
    return read(recording, recording.temperatures + added, recording.name)


def matched(*sets: Experiment, **options) -> tuple[Fit | None, ...]:
    return match_many(
        Twin("single-cell"), [[recording] for recording in sets], free=FREE, **options
    )


@pytest.fixture(scope="module")
def benches() -> list[Experiment]:
    return [recording(seed) for seed in range(3)]


@pytest.fixture(scope="module")
def fits(benches: list[Experiment]) -> tuple[Fit | None, ...]:
    return matched(*benches[:2])


def value(fit: Fit | None) -> float:
    assert fit is not None
    return fit["C_load"].value


@pytest.mark.long
def test_with_hubers_loss_outliers_of_the_only_channel_do_not_bias_the_match(
    benches: list[Experiment],
):
    """A single channel has nothing alone; what counts less is found in what all share."""
    outliers = np.zeros((121, 1))
    outliers[10::40], outliers[30::40] = 8.0, -8.0
    for fit in matched(
        *(spoiled(recording, outliers) for recording in benches[:2]), loss=Huber(2.0)
    ):
        assert fit is not None
        (weights,) = fit.weights.values()
        assert np.all(weights[10::20] < 0.2)
        assert np.median(weights) == 1.0
        row = fit["C_load"]
        assert abs(row.value - TRUTH["C_load"]) < 4 * row.standard_error
        assert row.standard_error < 0.3


@pytest.mark.slow
def test_masks_of_a_batch_act_as_in_a_match_of_each_set(benches: list[Experiment]):
    """As in a match of each set on its own; the mask takes away what was spoiled."""
    hand = np.where((np.arange(121.0) >= 30) & (np.arange(121.0) <= 45), 6.0, 0.0)[:, None]
    sets = [spoiled(benches[0], hand), benches[1]]
    masks = {"bench 0": [(30.0, 45.0)], "bench 1": [(100.0, 120.0, 0.5)]}
    for recording, fit in zip(sets, matched(*sets, masks=masks), strict=True):
        assert fit is not None
        own = {recording.name: masks[recording.name]}
        alone = match(Twin("single-cell"), recording, free=FREE, masks=own)
        assert value(fit) == pytest.approx(value(alone), rel=1e-6)
        np.testing.assert_array_equal(fit.weights[recording.name], alone.weights[recording.name])
        row = fit["C_load"]
        assert abs(row.value - TRUTH["C_load"]) < 4 * row.standard_error


@pytest.mark.parametrize("what", ["masks", "events"])
def test_masks_and_events_of_a_recording_in_no_set_are_refused(
    benches: list[Experiment], what: str
):
    options: dict[str, Any] = {what: {"bench 1": [], "bench 7": []}}
    with pytest.raises(MatchError, match=f"{what}: expected some of .*, got 'bench 7'"):
        matched(*benches[:2], **options)


@pytest.mark.slow
@pytest.mark.parametrize(
    "error", [SimulationError("the temperatures do not stay finite"), np.linalg.LinAlgError()]
)
def test_a_set_of_which_no_fit_can_be_made_loses_no_other(
    benches: list[Experiment],
    fits: tuple[Fit | None, ...],
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
):
    """Runs with shorter steps may fail where descents do not; and derivatives that are not finite
    have no covariance."""
    estimate = _match.estimate_uncertainty

    def give_up(problem: Any, *arguments: Any):
        if problem.experiments[0].fingerprint == benches[1].fingerprint:
            raise error
        return estimate(problem, *arguments)

    monkeypatch.setattr(_match, "estimate_uncertainty", give_up)
    good, bad = matched(*benches[:2])
    assert bad is None
    assert value(good) == value(fits[0])


@pytest.mark.slow
def test_the_rest_of_the_sets_compiles_nothing_new(
    benches: list[Experiment],
    fits: tuple[Fit | None, ...],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
):
    """Three sets, two at a time: the third goes through the program of the first two."""
    assert len(fits) == 2
    monkeypatch.setattr(_descent, "BATCH", 2)
    told: set[int] = set()
    with jax.log_compiles():
        caplog.clear()
        three = matched(*benches, on_progress=lambda iteration: told.add(iteration.start))
        assert not [record.message for record in caplog.records if "Compiling" in record.message]
    assert told == {0, 1, 2}
    assert [value(fit) for fit in three[:2]] == [value(fit) for fit in fits]
    alone = matched(benches[2], benches[0])
    assert value(three[2]) == pytest.approx(value(alone[0]), rel=1e-9)


def test_sets_that_need_other_programs_are_refused():
    constant = Experiment.schedule("0:0.4", duration=120, channels=("T",))
    longer = Experiment.schedule("0:0.4", duration=240, channels=("T",))
    switched = Experiment(constant.time, np.resize([0.4, -0.3], (121, 1)), channels=("T",))
    warm = Experiment(constant.time, constant.duty, channels=("T",), ambient=20.0)
    for other in (longer, switched, warm):
        sets = [
            read(recording, np.full((len(recording.time), 1), 18.0))
            for recording in (constant, other)
        ]
        with pytest.raises(MatchError, match="set 1 with recordings of other shapes than set 0"):
            matched(*sets)


def test_at_least_one_iteration_is_asked_for(benches: list[Experiment]):
    with pytest.raises(MatchError, match="max_iterations: expected a whole number above 0, got 0"):
        matched(benches[0], max_iterations=0)


class Sending:
    """An executor that sends everything as to another process, and is at once done."""

    def __init__(self) -> None:
        self.units = 0

    def submit(self, fn: Any, /, *args: Any) -> Future[Any]:
        self.units += 1
        work, arguments = pickle.loads(pickle.dumps((fn, args)))
        job: Future[Any] = Future()
        job.set_result(pickle.loads(pickle.dumps(work(*arguments))))
        return job


@pytest.mark.slow
def test_workers_match_four_sets_each(benches: list[Experiment]):
    """Five sets are two units; the second is filled up, and what fills it is not reported."""
    sets = [*benches, *benches[:2]]
    alone = matched(*sets)
    executor, seen = Sending(), []
    fits = matched(*sets, executor=executor, on_progress=seen.append)
    assert executor.units == 2
    assert {iteration.start for iteration in seen} == set(range(5))
    for fit, other in zip(fits, alone, strict=True):
        assert fit is not None
        assert other is not None
        assert value(fit) == pytest.approx(value(other), rel=1e-6)
        assert fit.recordings == other.recordings
        assert len(fit.history) == len(other.history)
    assert value(fits[0]) == pytest.approx(value(fits[3]), rel=1e-9)
