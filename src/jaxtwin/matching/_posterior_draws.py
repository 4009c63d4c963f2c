"""Random draws of what a match leaves open."""

import numpy as np
from jaxtyping import Float

from .._arguments import of_kind, whole_number
from .._errors import MatchError
from ..rig._problems import nearest
from ._fit import Fit, solution_of
from ._group_values import group_and_shared_values


def posterior_draws(
    fit: Fit, draws: int, *, seed: int = 0, group: str | None = None
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Values of the rig's own parameters that a match leaves open.

    They are drawn together from the normal distribution that the match's covariance describes, in
    the logarithms of positive parameters, and kept inside of the parameters' bounds. Its spread
    contains by how much the rig's own values differ from recording to recording. What belongs to a
    single recording, such as the temperature of the room, is not drawn.

    The distribution is that of a linear model about the match. Where the recordings determine a
    combination of parameters far better than each of them, and the combination is curved, some
    draws lie beside the recordings: `prediction_band` is linear and has no such draws.

    **Arguments:**

    - `fit`: a match.
    - `draws`: how many.
    - `seed`: the same seed gives the same draws.
    - `group`: of recordings, whose values are drawn; None for a group that the match has not seen,
      which differ more.

    **Returns:** name -> values `(draws,)` in the unit of the rig's table: `draws` of
    `simulate_batch`, `simulate_closed_loop` and others.

    **Raises:** `MatchError` where this is no fit, or the number is not above 0.
    """
    of_kind("posterior_draws: fit", fit, Fit, "a Fit, as match gives it", MatchError)
    count = whole_number("posterior_draws: draws", draws, 1, MatchError)
    solution = solution_of(fit)
    groups = solution.problem.groups
    if group is not None and group not in groups:
        raise MatchError(
            f"posterior_draws: group: expected one of {', '.join(groups)}, or None, got {group!r}"
            f"{nearest([group], groups)}"
        )
    number = 0 if len(groups) == 1 else None if group is None else groups.index(group)
    known = group_and_shared_values(solution.problem.unknowns, solution.vector, number)
    between = np.diag(fit.uncertainty.between_recordings**2)
    covariance = known.covariance(fit.uncertainty.vector_covariance + between)
    # By eigenvectors: a covariance with directions of no width has no Cholesky factor.
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    random = np.random.default_rng(whole_number("posterior_draws: seed", seed, 0, MatchError))
    entries = known.mean + random.normal(size=(count, len(values))) @ root.T
    with np.errstate(over="ignore"):  # of what is hardly known, which then is at its bound
        return {
            row.name: np.clip(
                np.exp(column) if row.is_logarithmic else column, row.lower, row.upper
            )
            for row, column in zip(known.rows, entries.T, strict=True)
        }
