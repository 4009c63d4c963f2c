"""Random draws of parameters, and samples of the unit cube: random, stratified, and of low
discrepancy. A seed determines the sequence, whichever part of it is computed.
"""

from collections.abc import Mapping
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri

from .._arguments import finite_number, whole_number
from .._name_suggestions import did_you_mean
from ..errors import SimulationError

# The number of draws from one state of the generator; a part of a long sweep starts at a block.
DRAWS_OF_A_KEY = 1024

# The largest normal score that a uniform number of float64 gives, 8.2 standard deviations.
MAX_NORMAL_SCORE = float(ndtri(1 - 2.0**-53))


def limits(value: float, spread: float) -> tuple[float, float]:
    """The smallest and the largest number that `normal_draws` can draw around a value."""
    farthest = value * (1 + spread * MAX_NORMAL_SCORE)
    return min(0.0, farthest), max(0.0, farthest)


# The key of the generator has 128 bits.
MAX_SEED = 2**128 - 1


def checked_seed(where: str, seed: int) -> int:
    """Checks a seed of the draws.

    **Raises:** `SimulationError` if it is no whole number from 0 to 2**128 - 1.
    """
    number = whole_number(where, seed, 0, SimulationError)
    if number > MAX_SEED:
        raise SimulationError(f"{where}: expected a whole number up to 2**128 - 1, got {number}")
    return number


def checked_spread(where: str, spread: float | int) -> float:
    """Checks a relative standard deviation of the draws.

    **Raises:** `SimulationError` if it is not between 0 and 1.
    """
    return finite_number(where, spread, SimulationError, above=0, below=1)


def normal_draws(
    values: Mapping[str, float], spread: float, seed: int, stop: int, start: int = 0
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Draws parameters independently from truncated normal distributions.

    The normal distribution has its mean at the value and a standard deviation of `spread` times the
    value. It is cut off at zero, so that a resistance stays positive.

    **Arguments:**

    - `values`: name -> mean.
    - `spread`: standard deviation relative to the mean.
    - `seed`: the same seed gives the same draws, whatever `start` and `stop`.
    - `stop`, `start`: the draws number start to stop - 1 of the sequence are made.

    **Returns:** name -> draws, in the order of `values`.
    """
    uniform = uniform_draws(len(values), seed, stop, start)
    # Probability below zero, which is cut off.
    below = ndtr(-1 / spread) if spread > 0 else 0.0
    scores = ndtri(below + uniform * (1 - below))
    return {
        name: value * (1 + spread * scores[:, column])
        for column, (name, value) in enumerate(values.items())
    }


def uniform_draws(
    columns: int, seed: int, stop: int, start: int = 0
) -> Float[np.ndarray, "draws columns"]:
    """Random numbers from 0 to 1 in several columns.

    **Arguments:**

    - `seed`: the same seed gives the same numbers, whatever `start` and `stop`.
    - `stop`, `start`: the rows number start to stop - 1 of the sequence are made.
    """
    first = start // DRAWS_OF_A_KEY
    blocks = range(first, -(-stop // DRAWS_OF_A_KEY))
    return np.concatenate(
        [
            np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, 0, block])).random(
                (DRAWS_OF_A_KEY, columns)
            )
            for block in blocks
        ]
    )[start - first * DRAWS_OF_A_KEY : stop - first * DRAWS_OF_A_KEY]


# Independent random numbers, as the paper takes them; a Latin hypercube, which has a sample in each
# of equally likely intervals of each parameter; or Sobol's sequence, scrambled (Owen).
SampleKind: TypeAlias = Literal["random", "latin-hypercube", "sobol"]


def unit_samples(
    kind: SampleKind, draws: int, columns: int, seed: int
) -> Float[np.ndarray, "draws columns"]:
    """Makes samples with independent columns, each uniform from 0 to 1. The same seed gives the
    same samples.

    **Raises:** `SimulationError` if the number of draws of Sobol's sequence is not a power of two,
    because other numbers unbalance it.
    """
    if kind == "random":
        return uniform_draws(columns, seed, draws)
    from scipy.stats import qmc  # takes a while to import

    option: dict[str, Any] = {"seed": seed}  # `rng` since SciPy 1.15, which takes both
    if kind == "latin-hypercube":
        return qmc.LatinHypercube(columns, **option).random(draws)
    if draws & (draws - 1):
        above = 1 << draws.bit_length()
        raise SimulationError(
            f"sensitivity: draws: expected a power of two for Sobol's sequence, which others "
            f'unbalance, got {draws}; take {above // 2} or {above}, or samples="latin-hypercube"'
        )
    return qmc.Sobol(columns, scramble=True, **option).random(draws)


def checked_kind(kind: SampleKind) -> SampleKind:
    """Returns the kind of samples.

    **Raises:** `SimulationError` for an unknown kind.
    """
    if kind not in get_args(SampleKind):
        raise SimulationError(
            f"sensitivity: samples: expected one of {', '.join(get_args(SampleKind))}, got {kind!r}"
            f"{did_you_mean([str(kind)], get_args(SampleKind))}"
        )
    return kind
