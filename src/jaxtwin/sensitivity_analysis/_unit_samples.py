"""Samples of the unit cube: random, stratified, and of low discrepancy."""

from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from jaxtyping import Float

from .._name_suggestions import did_you_mean
from ..errors import SimulationError
from ._sampling import uniform_draws

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
