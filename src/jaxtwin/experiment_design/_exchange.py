r"""The search for the most informative schedule: coordinate exchange.

Each step of each cell in turn gets the best level while all other steps are held, until nothing
improves (Meyer and Nachtsheim, Technometrics 37 (1995) 60-69). The levels of a step are
evaluated side by side. The search starts at the best of many schedules; exchange from several
starts is the usual remedy against local optima.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar, final

import numpy as np
from jaxtyping import Float

from ._evidence import SeparationEvidence
from ._information import EvaluatedSchedule
from ._schedules import Counts, Schedules

# The largest number of passes over all steps; two or three are usual.
MAX_PASSES = 10

# A pass that improves the objective by less is the last one: a tenth of a per cent of a standard
# error.
MIN_GAIN = 1e-3


Found = TypeVar("Found", bound=EvaluatedSchedule | SeparationEvidence)


@final
@dataclass(frozen=True, eq=False)
class Candidate(Generic[Found]):
    """A schedule, with the information that would be available after it.

    - `objective`: the number that is minimised; infinite if the schedule gets too hot.
    """

    counts: Counts
    evaluated: Found
    objective: float


def random_schedules(schedules: Schedules, number: int, seed: int) -> list[Counts]:
    """Schedules whose levels are drawn independently, after those that hold a single level."""
    rng = np.random.default_rng(seed)
    shape = (schedules.steps, schedules.cells)
    levels, cells = np.array(schedules.levels), np.arange(schedules.cells)
    drawn = (rng.choice(levels.shape[1], shape) for _ in range(number))
    return schedules.constant + [levels[cells, places] for places in drawn]


def exchange(
    start: Candidate[Found],
    schedules: Schedules,
    assess: Callable[[Sequence[Counts]], list[Candidate[Found]]],
    seed: int,
    on_pass: Callable[[int, Candidate[Found]], None],
) -> Candidate[Found]:
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
