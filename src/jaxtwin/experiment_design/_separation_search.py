"""Finds the duty schedule that tells faults apart soonest."""

import math
from collections.abc import Callable, Sequence
from typing import final

from .._waiting import advanced
from ._diagnosis_design import DiagnosisDesign, PlannedTest, SeparationStep
from ._evidence import MIN_LOG_ODDS, EvidenceProblem, SeparationEvidence
from ._exchange import Candidate, exchange, random_schedules
from ._hottest import Hottest
from ._schedules import Counts, Schedules

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
                number: int, best: Candidate[SeparationEvidence], start: int = start
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
        sequence = next((one for one in sequences if one.objective < math.inf), sequences[0])
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

    def _assess(self, counts: Sequence[Counts]) -> list[Candidate[SeparationEvidence]]:
        self._evaluations += len(counts)
        pairs = zip(counts, self._problem.evaluate(self._schedules, counts), strict=True)
        return [
            Candidate(one, result, result.objective if self._is_allowed(result) else math.inf)
            for one, result in pairs
        ]

    def _is_allowed(self, found: SeparationEvidence) -> bool:
        return self._hottest.allows(found.reading, found.side)

    def _planned(self, name: str, candidate: Candidate[SeparationEvidence]) -> PlannedTest:
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
