r"""How long Page's sum runs until a false alarm: exactly, for normal innovations, and counted.

A two-sided sum with run length $L$ upwards and downwards alike has $L/2$ (Kemp 1961). One side is a
Markov chain on a grid of the sum (Brook and Evans 1972): with $Q$ the probabilities between states
below the threshold, the mean run lengths are $(I - Q)^{-1} 1$.
"""

from math import erf, sqrt

import numpy as np
from jaxtyping import Float

from ._cumulative import REFERENCE

# The number of states between 0 and the threshold.
MARKOV_STATES = 400


def mean_run_length(threshold: float, reference: float = REFERENCE) -> float:
    """The mean number of independent normal innovations until a two-sided sum passes a threshold
    that it should not."""
    width = 2 * threshold / (2 * MARKOV_STATES - 1)
    centres = width * np.arange(MARKOV_STATES)
    edges = np.append(-np.inf, centres + width / 2)
    steps = edges[None, :] - centres[:, None] + reference
    below = np.vectorize(lambda x: 0.5 * (1 + erf(x / sqrt(2))))(steps)
    matrix = np.diff(below, axis=1)
    lengths = np.linalg.solve(np.eye(MARKOV_STATES) - matrix, np.ones(MARKOV_STATES))
    return float(lengths[0] / 2)


def alarms_of_sum(
    innovations: Float[np.ndarray, " samples"], threshold: float, reference: float = REFERENCE
) -> int:
    """How often a two-sided sum passes a threshold, if it begins again after each alarm."""
    alarms, up, down = 0, 0.0, 0.0
    for x in innovations.tolist():
        up, down = max(0.0, up + x - reference), max(0.0, down - x - reference)
        if max(up, down) >= threshold:
            alarms, up, down = alarms + 1, 0.0, 0.0
    return alarms
