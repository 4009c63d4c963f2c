"""Random draws from the uncertainty of a match."""

import numpy as np
from jaxtyping import Float

from .._arguments import of_kind, whole_number
from .._name_suggestions import did_you_mean
from ..errors import MatchError
from ._fit import Fit, solution_of
from ._group_values import group_and_shared_values


def posterior_draws(
    fit: Fit, draws: int, *, seed: int = 0, group: str | None = None
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Draws the matched parameters of the rig from the covariance of a match.

    The parameters are drawn jointly from a normal distribution, positive parameters by their
    logarithms, and clipped to their bounds. The covariance includes the differences of the rig
    between recordings (`Uncertainty.between_recordings`). Values that belong to a single recording,
    such as the ambient temperature, are not drawn.

    The distribution is that of a linear model at the match. If the recordings determine a nonlinear
    combination of parameters far better than each parameter, simulations of some draws deviate from
    the recordings. `prediction_band` is linear and is not affected.

    **Arguments:**

    - `fit`: a match.
    - `draws`: the number of draws.
    - `seed`: the seed; the same seed gives the same draws.
    - `group`: the group of recordings whose values are drawn; None for a group that was not
      matched, whose values vary more.

    **Returns:** name -> values `(draws,)` in the unit of the rig's table, as `simulate_batch` and
    `simulate_closed_loops` take them.

    **Raises:** `MatchError` if `fit` is not a fit, the group was not matched, or a number is not a
    positive whole number.
    """
    of_kind("posterior_draws: fit", fit, Fit, "a Fit, as match gives it", MatchError)
    count = whole_number("posterior_draws: draws", draws, 1, MatchError)
    solution = solution_of(fit)
    names = solution.problem.group_names
    if group is not None and group not in names:
        raise MatchError(
            f"posterior_draws: group: expected one of {', '.join(names)}, or None, got {group!r}"
            f"{did_you_mean([group], names)}"
        )
    number = 0 if len(names) == 1 else None if group is None else names.index(group)
    known = group_and_shared_values(solution.problem.unknowns, solution.vector, number)
    between = np.diag(fit.uncertainty.between_recordings**2)
    covariance = known.covariance(fit.uncertainty.vector_covariance + between)
    # By eigenvectors, because a singular covariance has no Cholesky factor.
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    random = np.random.default_rng(whole_number("posterior_draws: seed", seed, 0, MatchError))
    entries = known.mean + random.normal(size=(count, len(values))) @ root.T
    with np.errstate(
        over="ignore"
    ):  # of values that are hardly known; they are clipped to their bounds
        return {
            row.name: np.clip(
                np.exp(column) if row.is_logarithmic else column, row.lower, row.upper
            )
            for row, column in zip(known.rows, entries.T, strict=True)
        }
