"""Finds the duty schedule that tells faults apart soonest."""

import math
from collections.abc import Callable, Sequence
from typing import final

from .._waiting import advanced
from ._diagnosis_design import DiagnosisDesign, PlannedTest, SeparationStep
from ._evidence import LEAST, Evidence, EvidenceProblem
from ._exchange import Candidate, exchange, random_schedules
from ._hottest import Hottest
from ._schedules import Counts, Schedules

RANDOM = 4
"""The number of random schedules among which the searches choose their starts."""


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
        several = random_schedules(schedules, RANDOM, seed)
        levels, others = several[: len(schedules.constant)], several[len(schedules.constant) :]
        sequences, constants = self._assess(binary), self._assess(levels)
        found = [*sequences, *constants, *self._assess(others)]
        allowed = sorted(found, key=lambda candidate: candidate.objective)
        allowed = [candidate for candidate in allowed if candidate.objective < math.inf]
        if not allowed:
            coolest = min(candidate.evaluated.reading for candidate in found)
            self._hottest.refuse(self._problem.twin.rig.name, coolest)
        ends = []
        for start, candidate in enumerate(allowed[:starts]):

            def report(number: int, best: Candidate[Evidence], start: int = start) -> None:
                step = SeparationStep(start, number, self._evaluations, best.evaluated.separation)
                self._history.append(step)
                advanced(number, None, str(step))
                if on_progress is not None:
                    on_progress(step)

            report(0, candidate)
            # Nothing tells faults apart whose effects are the same.
            if candidate.evaluated.odds[-1] > LEAST:
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

    def _assess(self, counts: Sequence[Counts]) -> list[Candidate[Evidence]]:
        self._evaluations += len(counts)
        pairs = zip(counts, self._problem.evaluate(self._schedules, counts), strict=True)
        return [
            Candidate(one, found, found.objective if self._is_allowed(found) else math.inf)
            for one, found in pairs
        ]

    def _is_allowed(self, found: Evidence) -> bool:
        return self._hottest.allows(found.reading, found.side)

    def _planned(self, name: str, candidate: Candidate[Evidence]) -> PlannedTest:
        found = candidate.evaluated
        return PlannedTest(
            name=name,
            experiment=self._schedules.experiment(candidate.counts, name),
            counts=candidate.counts,
            separation=found.separation,
            time=found.time,
            odds=found.odds,
            hardest=found.hardest,
            highest_reading=found.reading,
            highest_side=found.side,
            is_allowed=self._is_allowed(found),
        )
