"""Random draws of parameters, the same for a seed whatever part of them is asked for."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri

from .._arguments import finite_number, whole_number
from .._errors import SimulationError

BLOCK = 1024
"""Draws made from one state of the generator; a part of a long sweep starts at its block."""

FARTHEST = float(ndtri(1 - 2.0**-53))
"""The largest normal score that a uniform number of float64 gives, 8.2 standard deviations."""


def limits(value: float, spread: float) -> tuple[float, float]:
    """Between which `normal_draws` draws a parameter around a value: from 0 outwards."""
    farthest = value * (1 + spread * FARTHEST)
    return min(0.0, farthest), max(0.0, farthest)


LARGEST_SEED = 2**128 - 1
"""The key of the generator has 128 bits."""


def checked_seed(where: str, seed: int) -> int:
    """A seed that the generator takes.

    **Raises:** `SimulationError` where it does not.
    """
    number = whole_number(where, seed, 0, SimulationError)
    if number > LARGEST_SEED:
        raise SimulationError(f"{where}: found {number}, allowed is up to 2**128 - 1")
    return number


def checked_spread(where: str, spread: float | int) -> float:
    """A standard deviation as a part of the value.

    **Raises:** `SimulationError` where it is not between 0 and 1.
    """
    number = finite_number(where, spread, SimulationError)
    if not 0 < number < 1:
        raise SimulationError(f"{where}: found {spread}, allowed is between 0 and 1")
    return number


def normal_draws(
    values: Mapping[str, float], spread: float, seed: int, stop: int, start: int = 0
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Independent normal draws around values, kept on the values' side of zero.

    The normal distribution has its mean at the value and a standard deviation of `spread` times it,
    and is cut off at zero: a resistance stays one.

    **Arguments:**

    - `values`: name -> mean.
    - `spread`: standard deviation as a part of the mean.
    - `seed`: the same seed gives the same draws, whatever `start` and `stop`.
    - `stop`, `start`: draws start ... stop - 1 of the endless sequence.
    """
    first = start // BLOCK
    blocks = range(first, -(-stop // BLOCK))
    uniform = np.concatenate(
        [
            np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, 0, block])).random(
                (BLOCK, len(values))
            )
            for block in blocks
        ]
    )[start - first * BLOCK : stop - first * BLOCK]
    # The part below zero, of the standard normal distribution.
    below = ndtr(-1 / spread) if spread > 0 else 0.0
    scores = ndtri(below + uniform * (1 - below))
    return {
        name: value * (1 + spread * scores[:, column])
        for column, (name, value) in enumerate(values.items())
    }
