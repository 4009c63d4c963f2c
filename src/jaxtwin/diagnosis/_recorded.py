"""The samples of an observed recording as the programs of a diagnosis take them."""

import math

import jax
import numpy as np
from jaxtyping import Bool

from ..observers import FilterSamples, KalmanState, Observed
from ._likelihood_ratio import RatioInputs

# Recordings are filled up to multiples of this number of samples, so that they share programs.
SAMPLE_BLOCK = 256


def inputs_of(observed: Observed, start: int) -> RatioInputs:
    """The samples of a recording, from one of which on faults may begin."""
    count = len(observed.is_sample)
    length = SAMPLE_BLOCK * math.ceil(count / SAMPLE_BLOCK)
    befores, samples = filled_up(observed, 0, length)
    begins: Bool[np.ndarray, " samples"] = np.zeros(length, bool)
    begins[:count] = np.asarray(observed.is_sample) & (np.arange(count) >= max(start, 1))
    return RatioInputs(befores, samples, begins)


def filled_up(observed: Observed, first: int, length: int) -> tuple[KalmanState, FilterSamples]:
    """So many samples from one on, with the states before each, filled up with samples of no length
    and without readings."""
    count = len(observed.is_sample)
    rows = np.minimum(np.arange(first, first + length), count - 1)
    befores = jax.tree.map(
        lambda leaf: np.asarray(leaf)[np.maximum(rows - 1, 0)], observed.filtered.states
    )
    is_there = np.arange(first, first + length) < count
    samples = observed.samples
    levels = None if samples.levels is None else np.asarray(samples.levels)[rows]
    filled = FilterSamples(
        dt=np.where(is_there, np.asarray(samples.dt)[rows], 0.0),
        duty=np.asarray(samples.duty)[rows],
        readings=np.where(is_there[:, None], np.asarray(samples.readings)[rows], np.nan),
        ambient=np.where(is_there, np.asarray(samples.ambient)[rows], np.nan),
        levels=levels,
    )
    return befores, filled
