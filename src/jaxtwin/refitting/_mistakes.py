"""Mistakes of a recording that a refit would otherwise take for a change of the rig.

A duty that was written in other counts looks like another cell, an open lid that the recording
calls closed like another loss, and exchanged channels like a plate that conducts differently. Each
mistake is a rival of the refit: the recording without it, matched from the same prior with nothing
released. If the rival explains the recording better, there is nothing to learn.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from ..io import Experiment
from ..matching import Fit
from ..matching._descent_result import DescentResult
from ..rig import Input
from ._forgetting import SessionPrior
from ._session_match import SessionMatch, descend_each, session_problem

Vector = Float[np.ndarray, " unknowns"]

DUTY_FACTORS = (-1.0, 0.4, 0.5, 0.625, 0.8, 1.25, 1.6, 2.2)
"""Factors of the duty that are tried: a reversed one, and other full counts."""

BESIDE = (0.8, 1.25)
"""Those next to 1."""

NEIGHBOURS = (-0.16, -0.08, 0.0, 0.08, 0.16)
"""The logarithms of further factors around the best of these."""

MOST_CHANNELS = 8
"""With more channels, only neighbours in the order of the rig are exchanged."""

ITERATIONS = 4
"""A rival that explains a recording is near after a few steps."""

BETTER = 3.0
"""A rival wins by this difference of the logarithm of its probability, a factor of 20."""


@final
class Mistake(NamedTuple):
    """A mistake of a recording.

    - `sentence`: what would be wrong, as the end of a sentence.
    - `cost`: half the sum of squared residuals and priors without it.
    """

    sentence: str
    cost: float


def best_mistake(
    fit: Fit, prior: SessionPrior, match: SessionMatch, recordings: dict[str, Experiment]
) -> Mistake | None:
    """The mistake that explains recordings best; None if the rig and its recordings leave none to
    be tried."""
    found: list[Mistake] = []
    if any(np.any(one.duty) for one in recordings.values()):
        found.append(_wrong_duty(fit, prior, match, recordings))
    rivals = list(_rivals(fit, recordings))
    if rivals:
        several = [corrected for _, corrected in rivals]
        costs = _costs(_descents(fit, prior, match, several, match.start))
        sentences = [sentence for sentence, _ in rivals]
        found += [Mistake(*pair) for pair in zip(sentences, costs, strict=True)]
    return min(found, key=lambda mistake: mistake.cost, default=None)


def _wrong_duty(
    fit: Fit, prior: SessionPrior, match: SessionMatch, recordings: dict[str, Experiment]
) -> Mistake:
    """The factor of the duty that explains recordings best: the nearest of a few, then others
    around it, and the minimum of the parabola through the best three of these."""
    lowest = np.array(fit.twin.rig.lowest_duty)

    def descents(factors: Sequence[float], start: Vector) -> list[DescentResult]:
        corrected = [
            {
                name: replace(one, duty=np.clip(factor * one.duty, lowest, 1.0))
                for name, one in recordings.items()
            }
            for factor in factors
        ]
        return _descents(fit, prior, match, corrected, start)

    if not match.changed and match.explanation.is_enough:
        # The recorded duty is near: the minimum is between its neighbours if both are worse.
        beside = _costs(descents(BESIDE, match.start))
        if min(beside) >= match.drift_cost:
            return Mistake(_duty_sentence(BESIDE[int(np.argmin(beside))]), min(beside))
    coarse = descents(DUTY_FACTORS, match.start)
    best = int(np.argmin(_costs(coarse)))
    nearest, start = DUTY_FACTORS[best], coarse[best].vector
    if coarse[best].cost >= match.drift_cost:  # the duty as it is recorded is nearer
        return Mistake(_duty_sentence(nearest), coarse[best].cost)
    fine = np.array(_costs(descents([nearest * float(np.exp(n)) for n in NEIGHBOURS], start)))
    middle = int(np.clip(np.argmin(fine), 1, len(fine) - 2))
    left, centre, right = fine[middle - 1 : middle + 2]
    curvature, slope = left - 2 * centre + right, (right - left) / 2
    cost, moved = centre, 0.0
    if np.isfinite(curvature) and curvature > 0:
        moved = float(np.clip(-slope / curvature, -1.0, 1.0))
        cost = centre + slope * moved + curvature * moved**2 / 2
    factor = nearest * np.exp(NEIGHBOURS[middle] + moved * (NEIGHBOURS[1] - NEIGHBOURS[0]))
    return Mistake(_duty_sentence(factor), float(max(cost, 0.0)))


def _duty_sentence(factor: float) -> str:
    what = "had the other sign" if factor < 0 else f"were {factor:.2g} times as large"
    return f"if its duty {what}"


def _descents(
    fit: Fit,
    prior: SessionPrior,
    match: SessionMatch,
    several: Sequence[dict[str, Experiment]],
    start: Vector,
) -> list[DescentResult]:
    """Matches of several corrected recordings from a prior."""
    problems = [session_problem(fit, prior, corrected) for corrected in several]
    return descend_each(problems, match.noise_model, start, ITERATIONS)


def _costs(found: Sequence[DescentResult]) -> list[float]:
    """The costs of descents, infinite where there are no finite temperatures."""
    return [each.cost if np.isfinite(each.cost) else np.inf for each in found]


def _rivals(
    fit: Fit, recordings: dict[str, Experiment]
) -> Iterator[tuple[str, dict[str, Experiment]]]:
    """Each mistake but that of the duty, with the recordings as they would be without it."""
    for pair in _exchanges(recordings):
        yield (
            f"if its channels {pair[0]} and {pair[1]} were exchanged",
            {name: _exchanged(one, pair) for name, one in recordings.items()},
        )
    for row in fit.twin.rig.inputs:
        if any(row.name in one.inputs for one in recordings.values()):
            for number, state in enumerate(row.states):
                if all(np.all(_numbers(one, row) == number) for one in recordings.values()):
                    continue  # which is what they say
                yield (
                    f"if {row.name} were {state}",
                    {
                        name: one.with_inputs(**{row.name: state})
                        for name, one in recordings.items()
                    },
                )


def _numbers(recording: Experiment, row: Input) -> Float[np.ndarray, " times"]:
    """The numbers of the states of an input at each time."""
    levels = np.asarray(recording.inputs.get(row.name, row.value))
    if levels.dtype.kind in "iuf":
        return levels.astype(float)
    return np.array([row.states.index(str(level)) for level in levels.ravel()], float)


def _exchanges(recordings: dict[str, Experiment]) -> list[tuple[str, str]]:
    """The pairs of channels that all recordings have."""
    first, *others = recordings.values()
    names = [name for name in first.channels if all(name in one.channels for one in others)]
    if len(names) <= MOST_CHANNELS:
        return list(combinations(names, 2))
    return list(pairwise(names))


def _exchanged(recording: Experiment, pair: tuple[str, str]) -> Experiment:
    places = list(range(len(recording.channels)))
    a, b = (recording.channels.index(name) for name in pair)
    places[a], places[b] = b, a
    assert recording.temperatures is not None
    return replace(recording, temperatures=np.asarray(recording.temperatures)[:, places])
