"""Whether two recordings hold the same samples: one of them is a part of the other, under another
name, beginning at 0 s, with fewer channels or samples, or the two overlap."""

import numpy as np
from jaxtyping import Float

from ..io import Experiment

# Times of a sample in two recordings differ by less, s: those of a part may be shifted.
SAME_TIME = 1e-6

# As many samples of different readings, or more, are no coincidence.
MIN_SHARED_SAMPLES = 3


def shared_samples(a: Experiment, b: Experiment) -> int:
    """The number of samples that two recordings share; 0 if they only look alike for a while, as
    two runs from the same start do without noise."""
    names = [name for name in a.channels if name in b.channels]
    if not names or a.n_cells != b.n_cells:
        return 0
    a, b = a.select(names), b.select(names)
    shorter, longer = sorted((_Samples(a), _Samples(b)), key=lambda samples: len(samples.time))
    if not len(shorter.time) or len(np.unique(shorter.rows, axis=0)) < MIN_SHARED_SAMPLES:
        return 0
    # A part is wherever its first sample is: at its own time, if it kept that.
    alike = np.all(longer.rows == shorter.rows[0], axis=1)
    for shift in longer.time[alike] - shorter.time[0]:
        if len(shorter.time) == _same(shorter, longer, shift):
            return len(shorter.time)
    first, last = (max(a.time[0], b.time[0]), min(a.time[-1], b.time[-1]))
    if a.time[0] == b.time[0]:
        return 0  # neither is the beginning of the other
    early, late = (samples.between(first, last) for samples in (shorter, longer))
    if len(early.time) != len(late.time) or len(np.unique(early.rows, axis=0)) < MIN_SHARED_SAMPLES:
        return 0
    return len(early.time) if _same(early, late, 0.0) == len(early.time) else 0


class _Samples:
    """The samples with a reading: their times, and readings and duty as rows; -inf for a missing
    reading, which no reading is."""

    def __init__(self, experiment: Experiment):
        assert experiment.temperatures is not None, "named_recordings has checked it"
        there = experiment.sampled.any(axis=1)
        self.time: Float[np.ndarray, " samples"] = experiment.time[there]
        readings = np.nan_to_num(experiment.temperatures[there], nan=-np.inf)
        self.rows: Float[np.ndarray, "samples values"] = np.hstack(
            [readings, experiment.duty[there]]
        )

    def between(self, first: float, last: float) -> "_Samples":
        """The samples in a span of time."""
        inside = (self.time >= first) & (self.time <= last)
        part = object.__new__(_Samples)
        part.time, part.rows = self.time[inside], self.rows[inside]
        return part


def _same(shorter: _Samples, longer: _Samples, shift: float) -> int:
    """How many samples of one recording are, after a shift of time, those of the other."""
    time = shorter.time + shift
    at = np.clip(np.searchsorted(longer.time, time - SAME_TIME), 0, len(longer.time) - 1)
    same = (np.abs(longer.time[at] - time) < SAME_TIME) & np.all(
        longer.rows[at] == shorter.rows, axis=1
    )
    return int(np.count_nonzero(same))
