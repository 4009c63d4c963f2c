"""Sparse matrices: Jacobians from a few directional derivatives, and their LU factorisation.

The factorisation is unrolled to one operation for each entry of the pattern. The order of
elimination and the entries that fill in are found from the pattern, before anything is traced. What
is traced is a sequence of multiplications and additions of numbers. Under `jax.vmap` each number is
an array over the batch, so that a batch of matrices is factorised by elementwise operations, which
a compiler fuses, instead of by calls of a library."""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import product
from typing import TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

# Row and column of an entry of a matrix.
Entry: TypeAlias = tuple[int, int]

# The entries of a matrix that may differ from 0.
Entries: TypeAlias = Mapping[Entry, Float[Array, "*batch"]]


@final
class SparseLU:
    """The factorisation of square matrices of one sparsity pattern.

    The pivots are the diagonal entries, in an order that keeps the number of entries small (minimum
    degree, as of Tinney and Walker 1967). Rows are not exchanged, because the order must not depend
    on the numbers: the diagonal must be large, as it is for $1 / (h \\gamma) - J$ with the Jacobian
    $J$ of a dissipative system, whatever the step size $h$.

    **Arguments:**

    - `pattern` (n, n): whether an entry may differ from 0. The diagonal always may.
    """

    def __init__(self, pattern: Bool[np.ndarray, "n n"]):
        pattern = np.asarray(pattern, bool) | np.eye(len(pattern), dtype=bool)
        self.size = len(pattern)
        self.entries: tuple[Entry, ...] = tuple(
            (int(row), int(column)) for row, column in np.argwhere(pattern)
        )
        self.pattern = pattern

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SparseLU) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @cached_property
    def _key(self) -> tuple[int, bytes]:
        return self.size, self.pattern.tobytes()

    @cached_property
    def elimination(self) -> tuple[tuple[int, tuple[int, ...], tuple[int, ...]], ...]:
        """The pivots in their order, each with the rows below it and the columns right of it."""
        filled = self.pattern.copy()
        left, steps = set(range(self.size)), []
        while left:
            others = sorted(left)
            rows = {k: [i for i in others if filled[i, k] and i != k] for k in others}
            columns = {k: [j for j in others if filled[k, j] and j != k] for k in others}
            pivot = min(others, key=lambda k: len(rows[k]) * len(columns[k]))
            filled[np.ix_(rows[pivot], columns[pivot])] = True
            steps.append((pivot, tuple(rows[pivot]), tuple(columns[pivot])))
            left.remove(pivot)
        return tuple(steps)

    def factorise(self, matrix: Entries) -> dict[Entry, Float[Array, "*batch"]]:
        """Computes the factors of a matrix.

        **Arguments:**

        - `matrix`: the entries of the pattern.

        **Returns:** the entries of both factors, with the inverse of each pivot in its place.
        """
        factors = dict(matrix)
        for pivot, rows, columns in self.elimination:
            inverse = factors[pivot, pivot] = 1 / factors[pivot, pivot]
            for row in rows:
                factors[row, pivot] = factors[row, pivot] * inverse
            for row, column in product(rows, columns):
                change = factors[row, pivot] * factors[pivot, column]
                old = factors.get((row, column))
                factors[row, column] = -change if old is None else old - change
        return factors

    def solve(
        self, factors: Entries, right: Sequence[Float[Array, "*batch"]]
    ) -> list[Float[Array, "*batch"]]:
        """Solves the equations for one right-hand side.

        **Arguments:**

        - `factors`: those of `factorise`.
        - `right`: the rows of the right-hand side.

        **Returns:** the rows of the solution.
        """
        x = list(right)
        for pivot, rows, _ in self.elimination:
            for row in rows:
                x[row] = x[row] - factors[row, pivot] * x[pivot]
        for pivot, _, columns in reversed(self.elimination):
            for column in columns:
                x[pivot] = x[pivot] - factors[pivot, column] * x[column]
            x[pivot] = x[pivot] * factors[pivot, pivot]
        return x


# The entries of a sparse Jacobian from a few directional derivatives.


def sparse_jacobian(
    function: Callable[[Float[Array, " n"]], Float[Array, " n"]],
    at: Float[Array, " n"],
    entries: Sequence[Entry],
) -> dict[Entry, Float[Array, ""]]:
    """Computes the Jacobian of a function whose other entries are 0.

    Columns without a common row are differentiated together (A. R. Curtis, M. J. D. Powell and J.
    K. Reid, J. Inst. Maths Applics 13 (1974) 117-119), so that the number of derivatives does not
    grow with the size of a network.

    **Arguments:**

    - `function`: the function.
    - `at`: its argument.
    - `entries`: the entries that may differ from 0.
    """
    pattern = np.zeros((at.size, at.size), bool)
    pattern[tuple(np.transpose(entries))] = True
    group = column_groups(pattern)
    seeds = jnp.asarray(np.eye(max(group) + 1)[:, group], at.dtype)
    derivatives = jax.vmap(lambda seed: jax.jvp(function, (at,), (seed,))[1])(seeds)
    return {(row, column): derivatives[group[column], row] for row, column in entries}


def column_groups(pattern: Bool[np.ndarray, "rows columns"]) -> list[int]:
    """The group of each column: columns of a group have no row in common. The groups are those that
    a greedy search finds, columns with many entries first."""
    columns = pattern.shape[1]
    meets = pattern.T.astype(int) @ pattern > 0
    group = np.full(columns, -1)
    for column in np.argsort(-pattern.sum(axis=0), kind="stable"):
        taken = set(group[meets[column]])
        group[column] = next(number for number in range(columns) if number not in taken)
    return group.tolist()
