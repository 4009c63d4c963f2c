"""Finds the duty schedule whose recording is the most informative about a rig."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, final, overload

import numpy as np
from jaxtyping import Float, Int

from .._arguments import check_callable, finite_number, names_of, whole_number
from .._name_suggestions import did_you_mean
from .._progress import advanced, announced
from ..diagnosis import Faults
from ..errors import MatchError
from ..io import Experiment
from ..matching import Fit, solution_of
from ..observers import ProcessNoise
from ..physics import Twin, check_twin
from ._diagnosis_design import DiagnosisDesign, EvidenceProblem, SeparationStep
from ._experiment_design import Criterion, DesignStep, ExperimentDesign, PlannedSchedule
from ._information import (
    UNKNOWN,
    DesignProblem,
    EvaluatedSchedule,
    NoisePrediction,
    PriorInformation,
    make_design_problem,
)
from ._schedules import Counts, Schedules, make_schedules
from ._search import (
    OBJECTIVES,
    CandidateSchedule,
    Hottest,
    SeparationSearch,
    exchange,
    random_schedules,
)

# The number of random schedules among which the searches choose their starts.
RANDOM_SCHEDULES = 11


@overload
def design_experiment(
    twin: Twin | Fit,
    *,
    purpose: Literal["match"] = "match",
    duration: float | int = 1200.0,
    hold: float | int = 60.0,
    bounds: tuple[float, float] | None = None,
    levels: int = 5,
    criterion: Criterion = "D",
    names: Iterable[str] | None = None,
    group: str | None = None,
    margin: float | int = 5.0,
    starts: int = 1,
    seed: int = 0,
    on_progress: Callable[[DesignStep], None] | None = None,
) -> ExperimentDesign: ...


@overload
def design_experiment(
    twin: Twin | Fit,
    *,
    purpose: Literal["diagnosis"],
    faults: Faults,
    noise: ProcessNoise | None = None,
    duration: float | int = 1200.0,
    hold: float | int = 60.0,
    bounds: tuple[float, float] | None = None,
    levels: int = 5,
    margin: float | int = 5.0,
    starts: int = 1,
    seed: int = 0,
    on_progress: Callable[[SeparationStep], None] | None = None,
) -> DiagnosisDesign: ...


@announced("design of an experiment")
def design_experiment(
    twin: Twin | Fit,
    *,
    purpose: Literal["match", "diagnosis"] = "match",
    faults: Faults = None,
    noise: ProcessNoise | None = None,
    duration: float | int = 1200.0,
    hold: float | int = 60.0,
    bounds: tuple[float, float] | None = None,
    levels: int = 5,
    criterion: Criterion = "D",
    names: Iterable[str] | None = None,
    group: str | None = None,
    margin: float | int = 5.0,
    starts: int = 1,
    seed: int = 0,
    on_progress: Callable[[Any], None] | None = None,
) -> ExperimentDesign | DiagnosisDesign:
    r"""Finds the duty schedule whose recording would shrink the errors of a match most.

    The errors that a match of today's recordings together with the new one will have follow from
    the exact derivatives of the readings along the schedule, before anything is recorded. The
    search changes the schedule step by step. Schedules in which a reading or a cell
    gets hotter than the rig's limits in the simulation are left out.

    With the purpose `"diagnosis"` it is the schedule that tells faults apart soonest: a test for a
    rig of which `diagnose` has found that it has one of them. The faults are there from the start,
    and of their usual sizes.

    **Arguments:**

    - `purpose`: `"match"`, or `"diagnosis"`.
    - `faults`, `noise`: of a diagnosis: two faults or more, and the noise of its observer, as for
      `jaxtwin.diagnose`.

    - `twin`: a fit, whose covariance is the prior information and whose noise is expected again; or
      a twin, of which only the priors are known, with the noise that a match assumes at first.
    - `duration`: the duration of the recording, an hour at most, s. `hold`: that of each step, s.
    - `bounds`: lowest and highest duty cycle; by default those of the fit's recordings and 0, or -1
      and 1 for a twin or a fit without its recordings. The lowest of a heater is 0.
    - `levels`: the number of duty cycles between which the search chooses, the bounds among them;
      they are rounded to the driver's counts.
    - `criterion`: of a match: `"D"` for the smallest volume of the confidence ellipsoid of the
      parameters of interest, `"A"` for the smallest mean variance. Each parameter is measured by
      the scale of the match: the standard deviation of its prior, or a factor of e.
    - `names`: of a match: the parameters of interest; by default all matched ones that do not
      belong to a single recording.
    - `group`: of a match: the group of the new recording, such as its day; None for a new group.
    - `margin`: the smallest distance of the simulation from the limits, K.
    - `starts`: the number of searches, from the best schedules among references and random ones.
    - `seed`: the same seed gives the same design.
    - `on_progress`: called with each `DesignStep`, or each `SeparationStep` of a diagnosis.

    **Returns:** an `ExperimentDesign`, with the errors predicted for it, for the steps of today's
    recordings, and for a pseudo-random binary sequence of the same duration and bounds. For a
    diagnosis a `DiagnosisDesign`, with the times after which it, the best schedule of a single
    level and such a sequence tell the faults apart.

    **Raises:** `MatchError` if a setting is not allowed, a parameter is not matched, every schedule
    gets too hot, or there are fewer than two faults; `ObserverError` for an unknown fault;
    `ParameterError` for a twin with several values of a parameter.
    """
    if purpose not in ("match", "diagnosis"):
        raise MatchError(
            f'design_experiment: purpose: expected "match" or "diagnosis", got {purpose!r}'
        )
    if criterion not in OBJECTIVES:
        raise MatchError(f'design_experiment: criterion: expected "D" or "A", got {criterion!r}')
    finite_number("design_experiment: margin", margin, MatchError)
    whole_number("design_experiment: starts", starts, 1, MatchError)
    whole_number("design_experiment: seed", seed, 0, MatchError)
    check_callable("design_experiment: on_progress", on_progress, MatchError)
    if purpose == "diagnosis":
        given = {"criterion": criterion != "D", "names": names is not None, "group": group}
        for name, is_given in given.items():
            if is_given:
                raise MatchError(
                    f"design_experiment: {name}: expected none beside the purpose of a diagnosis, "
                    "which estimates no parameters"
                )
        recordings = _recordings(twin) if isinstance(twin, Fit) else {}
        healthy = twin.mean_twin if isinstance(twin, Fit) else twin
        check_twin("design_experiment: twin", healthy, MatchError)
        schedules = _schedules(healthy, recordings, duration, hold, bounds, levels)
        test = EvidenceProblem(twin, faults, noise, schedules)
        hottest = Hottest.of(healthy, float(margin))
        return SeparationSearch(test, schedules, hottest).run(starts, seed, on_progress)
    if faults is not None or noise is not None:
        raise MatchError(
            "design_experiment: faults: expected none for a match, got some; add "
            'purpose="diagnosis"'
        )
    if isinstance(twin, Fit):
        prior, recordings = PriorInformation.of_fit(twin, group), _recordings(twin)
        events = tuple(twin.events.values())
    else:
        check_twin("design_experiment: twin", twin, MatchError)
        if group is not None:
            raise MatchError(
                f"design_experiment: group: expected None for a twin, got {group!r}; pass a fit"
            )
        prior, recordings, events = PriorInformation.of_twin(twin), {}, ()
    schedules = _schedules(prior.twin, recordings, duration, hold, bounds, levels)
    problem = make_design_problem(
        prior, schedules, NoisePrediction.of(twin), _expected_events(events, duration)
    )
    search = _ScheduleSearch(
        prior, schedules, problem, criterion, _places(prior, names), float(margin)
    )
    return search.run(recordings, starts, seed, on_progress)


@final
class _ScheduleSearch:
    """The search for one design."""

    def __init__(
        self,
        prior: PriorInformation,
        schedules: Schedules,
        problem: DesignProblem,
        criterion: Criterion,
        places: Int[np.ndarray, " parameters"],
        margin: float,
    ):
        self.prior, self.schedules, self.problem = prior, schedules, problem
        self.criterion: Criterion = criterion
        self.places = places
        self.scale = prior.scale[places]
        self.hottest = Hottest.of(prior.twin, margin)
        self.evaluations = 0
        self.today = self._covariance(None)
        self.history: list[DesignStep] = []

    def run(
        self,
        recordings: Mapping[str, Experiment],
        starts: int,
        seed: int,
        on_progress: Callable[[DesignStep], None] | None,
    ) -> ExperimentDesign:
        """Evaluates the references, and searches from the best schedules."""
        schedules = self.schedules
        recorded = [schedules.resampled(recording) for recording in recordings.values()]
        binary = schedules.binary_sequences()
        others = random_schedules(schedules, RANDOM_SCHEDULES, seed)
        result = self.assess(recorded + binary + others)
        sequences = result[len(recorded) : len(recorded) + len(binary)]
        references = {
            name: self._planned(name, candidate)
            for name, candidate in zip(recordings, result, strict=False)
        }
        allowed = [candidate for candidate in sequences if self._is_allowed(candidate.evaluated)]
        references["PRBS"] = self._planned("PRBS", (allowed or sequences)[0])
        candidates = sorted(result, key=lambda candidate: candidate.objective)
        candidates = [candidate for candidate in candidates if candidate.objective < math.inf]
        if not candidates:
            coolest = min(candidate.evaluated.reading for candidate in result)
            self.hottest.refuse(self.prior.twin.rig.name, coolest)
        ends = []
        for start, candidate in enumerate(candidates[:starts]):

            def report(number: int, best: CandidateSchedule, start: int = start) -> None:
                step = DesignStep(start, number, self.evaluations, self._mean_error(best))
                self.history.append(step)
                advanced(number, None, str(step))
                if on_progress is not None:
                    on_progress(step)

            report(0, candidate)
            ends.append(exchange(candidate, schedules, self.assess, seed + start, report))
        best = min(ends, key=lambda candidate: candidate.objective)
        rows = [self.prior.unknowns.entry_parameters[place] for place in self.places]
        return ExperimentDesign(
            rig=self.prior.twin.rig.name,
            criterion=self.criterion,
            names=tuple(row.name for row in rows),
            units=tuple(row.unit for row in rows),
            values=tuple(float(self.prior.twin.values[row.name]) for row in rows),
            standard_errors=self._errors(self.today),
            best=self._planned("designed", best),
            references=references,
            hold=schedules.hold,
            history=tuple(self.history),
        )

    def assess(self, counts: Sequence[Counts]) -> list[CandidateSchedule]:
        """Evaluates schedules in batches of one size, so that they share a compiled program."""
        batch = len(self.schedules.levels[0]) - 1
        result: list[CandidateSchedule] = []
        for first in range(0, len(counts), batch):
            part = list(counts[first : first + batch])
            filled = part + part[-1:] * (batch - len(part))
            evaluated = self.problem.evaluate(self.schedules, filled)[: len(part)]
            result += map(self._candidate, part, evaluated)
        self.evaluations += len(counts)
        return result

    def _candidate(self, counts: Counts, evaluated: EvaluatedSchedule) -> CandidateSchedule:
        if not self._is_allowed(evaluated):
            return CandidateSchedule(counts, evaluated, math.inf)
        return CandidateSchedule(counts, evaluated, self._objective(self._covariance(evaluated)))

    def _is_allowed(self, evaluated: EvaluatedSchedule) -> bool:
        return self.hottest.allows(evaluated.reading, evaluated.side)

    def _covariance(self, evaluated: EvaluatedSchedule | None) -> Float[np.ndarray, "some some"]:
        known = self.prior
        whole = (
            known.covariance()
            if evaluated is None
            else known.covariance(evaluated.normal, evaluated.meat)
        )
        return whole[np.ix_(self.places, self.places)]

    def _objective(self, covariance: Float[np.ndarray, "some some"]) -> float:
        scaled = covariance / np.outer(self.scale, self.scale)
        return OBJECTIVES[self.criterion](scaled)

    def _mean_error(self, candidate: CandidateSchedule) -> float:
        after = self._objective(self._covariance(candidate.evaluated))
        return math.exp(after - self._objective(self.today))

    def _errors(self, covariance: Float[np.ndarray, "some some"]) -> dict[str, float]:
        """Parameter -> standard error in its unit."""
        standard_deviations = np.sqrt(np.diag(covariance))
        slopes = self.prior.unknowns.value_derivatives(self.prior.vector)[self.places]
        lost = standard_deviations > 0.1 * UNKNOWN * self.scale
        errors = np.where(lost, math.inf, standard_deviations * slopes)
        rows = self.prior.unknowns.entry_parameters
        return {
            rows[place].name: float(error) for place, error in zip(self.places, errors, strict=True)
        }

    def _planned(self, name: str, candidate: CandidateSchedule) -> PlannedSchedule:
        evaluated = candidate.evaluated
        return PlannedSchedule(
            name=name,
            experiment=self.schedules.experiment(candidate.counts, name),
            counts=candidate.counts,
            standard_errors=self._errors(self._covariance(evaluated)),
            mean_error=self._mean_error(candidate),
            highest_reading=evaluated.reading,
            highest_side=evaluated.side,
            is_allowed=self._is_allowed(evaluated),
        )


def _places(prior: PriorInformation, names: Iterable[str] | None) -> Int[np.ndarray, " parameters"]:
    """The positions of the parameters of interest among the unknowns."""
    own = [row.name for row in prior.own_rows]
    if not own:
        raise MatchError(
            "design_experiment: expected a matched parameter of the rig that is not at a bound, "
            "got none; match more of them, or with other bounds"
        )
    chosen = own
    if names is not None:
        chosen = list(names_of("design_experiment: names", names, MatchError))
    unknown = [name for name in chosen if name not in own]
    if unknown or not chosen:
        raise MatchError(
            "design_experiment: names: expected some of the matched parameters "
            f"{', '.join(own)}, got {', '.join(unknown) or 'none'}{did_you_mean(unknown, own)}"
        )
    all_names = [row.name for row in prior.unknowns.entry_parameters]
    return np.array([all_names.index(name) for name in chosen])


def _recordings(fit: Fit) -> dict[str, Experiment]:
    """The recordings of a fit; none if it was loaded without them."""
    return dict(zip(fit.recordings, solution_of(fit).problem.experiments, strict=False))


def _schedules(
    twin: Twin,
    recordings: Mapping[str, Experiment],
    duration: float | int,
    hold: float | int,
    bounds: tuple[float, float] | None,
    levels: int,
) -> Schedules:
    """The schedules of a design, by default with the bounds and the interval of the recordings."""
    interval = min((float(np.median(np.diff(e.time))) for e in recordings.values()), default=1.0)
    if bounds is None:
        bounds = _recorded_bounds(recordings, min(twin.rig.lowest_duty))
    return make_schedules(
        twin, duration=duration, hold=hold, bounds=bounds, levels=levels, interval=interval
    )


def _recorded_bounds(recordings: Mapping[str, Experiment], lowest: float) -> tuple[float, float]:
    if not recordings:
        return lowest, 1.0
    driven = np.concatenate([recording.duty.ravel() for recording in recordings.values()])
    return float(min(0.0, driven.min())), float(max(0.0, driven.max()))


def _expected_events(events: Sequence[Sequence[float]], duration: float | int) -> tuple[float, ...]:
    """Expected times of the camera's corrections in another recording, s: they are repeated at the
    interval of the earlier recordings, and the first comes after one interval."""
    intervals = [np.diff(of_recording) for of_recording in events if len(of_recording) > 1]
    if not intervals:
        return ()
    period = float(np.median(np.concatenate(intervals)))
    return tuple((period * np.arange(1, math.ceil(duration / period))).tolist())
