"""What a match should say of its recordings: gaps, and channels at the end of their range."""

import numpy as np
from jaxtyping import Bool, Float

from ..io import Experiment
from ..io._gaps import gap_sentences

LONGEST_STAY = 10
"""So many samples in a row at the highest or lowest value of all, or more, may be the end of a
sensor's range."""

STANDS = 20
"""A channel at the end of its range has this many times as many samples there as at the value
beside it. A temperature that settles is slow before, so that both have many."""


def recording_notes(experiment: Experiment) -> list[str]:
    """What is assumed of the gaps of a recording, and which channels stand at one value, in
    sentences."""
    notes = gap_sentences(experiment)
    if experiment.temperatures is None:
        return notes
    for name, readings in zip(experiment.channels, experiment.temperatures.T, strict=True):
        there = ~np.isnan(readings)
        for word, sign in (("highest", 1.0), ("lowest", -1.0)):
            at_end = _at_end_of_range(sign * readings[there])
            if at_end.any():
                value = readings[there][at_end][0]
                first = experiment.time[there][at_end][0]
                notes.append(
                    f"{experiment.name or 'the recording'}: {name} stands at its {word} value, "
                    f"{value:.6g} degC, in {at_end.sum()} of {there.sum()} samples, first at "
                    f"{first:.10g} s, as at the end of a sensor's range: these readings are bounds "
                    "and not temperatures; make them missing (NaN), or masks=... leaves them out"
                )
    return notes


def _at_end_of_range(readings: Float[np.ndarray, " samples"]) -> Bool[np.ndarray, " samples"]:
    """The samples at the highest value, if a channel came to stand there; none otherwise."""
    none = np.zeros(len(readings), bool)
    values, counts = np.unique(readings, return_counts=True)
    if len(values) < 3 or counts[-1] < STANDS * counts[-2]:
        return none
    at_end = readings == values[-1]
    edges = np.flatnonzero(np.diff(np.append(np.insert(at_end.astype(int), 0, 0), 0)))
    begins, ends = edges[::2], edges[1::2]
    # A recording may begin at rest, in which a coarse sensor shows a single value.
    stays = (ends - begins)[begins > 0]
    return at_end if len(stays) and stays.max() >= LONGEST_STAY else none
