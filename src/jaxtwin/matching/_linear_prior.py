"""Priors of linear combinations of unknowns."""

import math
from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ._unknowns import Unknowns


@final
class LinearPrior(eqx.Module):
    """A prior of linear combinations of unknowns, such as the difference of two of them.

    - `matrix`, `values`: `matrix @ vector - values` has mean 0 and variance 1, independently.
    """

    matrix: Float[np.ndarray | Array, "combinations unknowns"]
    values: Float[np.ndarray | Array, " combinations"]

    @classmethod
    def none(cls, unknowns: int) -> "LinearPrior":
        """A prior without any combination."""
        return cls(np.zeros((0, unknowns)), np.zeros(0))

    @classmethod
    def between_groups(cls, unknowns: Unknowns) -> "LinearPrior":
        r"""The prior that relates the values of several groups.

        The value of a group is the sum of $\phi \sim N(m, s^2)$, which all groups share, and its
        difference, $N(0, \tau^2)$. With $\phi$ integrated out, the values of $G$ groups have the
        covariance $\tau^2 I + s^2 1 1^T$: their mean and their differences from it are independent.
        """
        rows, places = unknowns.per_group, unknowns.group_entries()
        groups = len(places)
        mean = np.full((groups, groups), 1 / groups)
        matrix = np.zeros((groups * len(rows), unknowns.size))
        for number, row in enumerate(rows):
            assert row.prior_spread is not None
            assert row.group_spread is not None
            of_mean = math.hypot(row.group_spread, math.sqrt(groups) * row.prior_spread)
            block = (np.eye(groups) - mean) / row.group_spread + mean / of_mean
            matrix[groups * number : groups * (number + 1), places[:, number]] = block
        return cls(matrix, matrix @ unknowns.prior_means())

    @classmethod
    def normal(
        cls, mean: Float[np.ndarray, " unknowns"], covariance: Float[np.ndarray, "some some"]
    ) -> "LinearPrior":
        """A normal prior of the first unknowns; the others have none."""
        some = len(covariance)
        matrix = np.zeros((some, len(mean)))
        # L L^T = cov, so the rows of the inverse of L are its whitening.
        matrix[:, :some] = np.linalg.inv(np.linalg.cholesky(covariance))
        return cls(matrix, matrix @ mean)
