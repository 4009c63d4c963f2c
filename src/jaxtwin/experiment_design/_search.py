"""The search for the best schedule, for the most information on a rig or for telling faults apart
soonest, below the highest temperatures that a schedule may reach: coordinate exchange.

Each step of each cell in turn gets the best level while all other steps are held, until nothing
improves (Meyer and Nachtsheim, Technometrics 37 (1995) 60-69). The levels of a step are evaluated
side by side. The search starts at the best of many schedules; exchange from several starts is the
usual remedy against local optima.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, NamedTuple, NoReturn, TypeVar, final

import numpy as np
from jaxtyping import Float

from .._celsius import ZERO_CELSIUS
from .._progress import advanced
from ..errors import MatchError
from ..physics import Twin
from ._diagnosis_design import (
    MIN_LOG_ODDS,
    DiagnosisDesign,
    EvidenceProblem,
    PlannedTest,
    SeparationEvidence,
    SeparationStep,
)
from ._information import EvaluatedSchedule
from ._schedules import Counts, Schedules


@final
class Hottest(NamedTuple):
    """The highest temperature of a channel, and of a cell's side, degC; infinite without limits."""

    reading: float
    side: float

    @classmethod
    def of(cls, twin: Twin, margin: float) -> "Hottest":
        """The limits of a rig less a margin, K."""
        reading = twin.rig.maximum_temperature
        if reading is None:
            return cls(math.inf, math.inf)
        side = min(twin.rig.maximum_side_temperatures, default=math.inf)
        return cls(reading - ZERO_CELSIUS - margin, side - ZERO_CELSIUS - margin)

    def allows(self, reading: float, side: float) -> bool:
        """Whether temperatures are below; those that are not finite are not."""
        return reading <= self.reading and side <= self.side

    def refuse(self, rig: str, coolest: float) -> NoReturn:
        """Says that even the coolest schedule of a rig is too hot.

        **Raises:** `MatchError`.
        """
        raise MatchError(
            f"design_experiment: {rig}: expected {self}, got at least {coolest:.1f} degC; use "
            "other bounds, a smaller margin or a shorter duration"
        )

    def __str__(self) -> str:
        cells = f" and its cells below {self.side:g} degC" if math.isfinite(self.side) else ""
        return f"a schedule whose readings stay below {self.reading:g} degC{cells}"


# The largest number of passes over all steps; two or three are usual.
MAX_PASSES = 10

# A pass that improves the objective by less is the last one: a tenth of a per cent of a standard
# error.
MIN_GAIN = 1e-3


Evaluated = TypeVar("Evaluated", bound=EvaluatedSchedule | SeparationEvidence)


@final
@dataclass(frozen=True, eq=False)
class CandidateSchedule(Generic[Evaluated]):
    """A schedule, with the information that would be available after it.

    - `objective`: the number that is minimised; infinite if the schedule gets too hot.
    """

    counts: Counts
    evaluated: Evaluated
    objective: float


def random_schedules(schedules: Schedules, number: int, seed: int) -> list[Counts]:
    """Schedules whose levels are drawn independently, after those that hold a single level."""
    rng = np.random.default_rng(seed)
    shape = (schedules.steps, schedules.cells)
    levels, cells = np.array(schedules.levels), np.arange(schedules.cells)
    drawn = (rng.choice(levels.shape[1], shape) for _ in range(number))
    return schedules.constant + [levels[cells, places] for places in drawn]


def exchange(
    start: CandidateSchedule[Evaluated],
    schedules: Schedules,
    assess: Callable[[Sequence[Counts]], list[CandidateSchedule[Evaluated]]],
    seed: int,
    on_pass: Callable[[int, CandidateSchedule[Evaluated]], None],
) -> CandidateSchedule[Evaluated]:
    """Improves a schedule step by step.

    **Arguments:**

    - `start`: a schedule that does not get too hot.
    - `assess`: evaluates schedules.
    - `seed`: the seed of the order in which steps are visited.
    - `on_pass`: called with the number of each pass and the best schedule after it.
    """
    rng = np.random.default_rng(seed)
    best = start
    for number in range(1, MAX_PASSES + 1):
        before = best.objective
        for place in rng.permutation(best.counts.size):
            changed = []
            for level in schedules.levels[place % schedules.cells]:
                counts = best.counts.copy()
                counts.flat[place] = level
                if level != best.counts.flat[place]:
                    changed.append(counts)
            result = min(assess(changed), key=lambda candidate: candidate.objective)
            if result.objective < best.objective - 1e-9:
                best = result
        on_pass(number, best)
        if best.objective > before - MIN_GAIN:
            break
    return best


def d_objective(covariance: Float[np.ndarray, "some some"]) -> float:
    """D-optimality: logarithm of the geometric mean of the confidence ellipsoid's half axes."""
    return float(np.linalg.slogdet(covariance)[1]) / (2 * len(covariance))


def a_objective(covariance: Float[np.ndarray, "some some"]) -> float:
    """Logarithm of the root of the mean variance: A-optimality."""
    return 0.5 * float(np.log(np.trace(covariance) / len(covariance)))


# Name -> function of the scaled covariance of the parameters of interest.
OBJECTIVES = {"D": d_objective, "A": a_objective}


# The number of random schedules among which the searches choose their starts.
RANDOM_SCHEDULES = 4


@final
class SeparationSearch:
    """The search for a schedule that tells faults apart.

    **Arguments:**

    - `problem`: the faults. `schedules`: the schedules. `hottest`: what they may not exceed.
    """

    def __init__(self, problem: EvidenceProblem, schedules: Schedules, hottest: Hottest):
        self._problem, self._schedules, self._hottest = problem, schedules, hottest
        self._evaluations = 0
        self._history: list[SeparationStep] = []

    def run(
        self, starts: int, seed: int, on_progress: Callable[[SeparationStep], None] | None
    ) -> DiagnosisDesign:
        """Evaluates the references, and searches from the best schedules."""
        schedules = self._schedules
        binary = schedules.binary_sequences()
        several = random_schedules(schedules, RANDOM_SCHEDULES, seed)
        levels, others = several[: len(schedules.constant)], several[len(schedules.constant) :]
        sequences, constants = self._assess(binary), self._assess(levels)
        result = [*sequences, *constants, *self._assess(others)]
        allowed = sorted(result, key=lambda candidate: candidate.objective)
        allowed = [candidate for candidate in allowed if candidate.objective < math.inf]
        if not allowed:
            coolest = min(candidate.evaluated.reading for candidate in result)
            self._hottest.refuse(self._problem.twin.rig.name, coolest)
        ends = []
        for start, candidate in enumerate(allowed[:starts]):

            def report(
                number: int, best: CandidateSchedule[SeparationEvidence], start: int = start
            ) -> None:
                step = SeparationStep(start, number, self._evaluations, best.evaluated.separation)
                self._history.append(step)
                advanced(number, None, str(step))
                if on_progress is not None:
                    on_progress(step)

            report(0, candidate)
            # Nothing tells faults apart whose effects are the same.
            if candidate.evaluated.odds[-1] > MIN_LOG_ODDS:
                candidate = exchange(candidate, schedules, self._assess, seed + start, report)
            ends.append(candidate)
        best = min(ends, key=lambda candidate: candidate.objective)
        sequence = next(
            (candidate for candidate in sequences if candidate.objective < math.inf), sequences[0]
        )
        constant = min(constants, key=lambda candidate: candidate.objective)
        return DiagnosisDesign(
            rig=self._problem.twin.rig.name,
            faults=self._problem.names,
            best=self._planned("designed", best),
            references={
                "constant": self._planned("constant", constant),
                "PRBS": self._planned("PRBS", sequence),
            },
            hold=schedules.hold,
            history=tuple(self._history),
        )

    def _assess(self, counts: Sequence[Counts]) -> list[CandidateSchedule[SeparationEvidence]]:
        self._evaluations += len(counts)
        pairs = zip(counts, self._problem.evaluate(self._schedules, counts), strict=True)
        return [
            CandidateSchedule(
                schedule, result, result.objective if self._is_allowed(result) else math.inf
            )
            for schedule, result in pairs
        ]

    def _is_allowed(self, evidence: SeparationEvidence) -> bool:
        return self._hottest.allows(evidence.reading, evidence.side)

    def _planned(self, name: str, candidate: CandidateSchedule[SeparationEvidence]) -> PlannedTest:
        result = candidate.evaluated
        return PlannedTest(
            name=name,
            experiment=self._schedules.experiment(candidate.counts, name),
            counts=candidate.counts,
            separation=result.separation,
            time=result.time,
            odds=result.odds,
            hardest=result.hardest,
            highest_reading=result.reading,
            highest_side=result.side,
            is_allowed=self._is_allowed(result),
        )
