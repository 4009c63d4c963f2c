"""The order of elimination of a network, and the places of its factors, for `rodas5p.c`."""

from typing import final

import numpy as np
from jaxtyping import Bool, Int

from .._sparse_lu import SparseLU


@final
class Elimination:
    """A sparsity pattern and its factors by rows, with the nodes in the order of elimination.

    - `order` (nodes,): the node that is eliminated first, second, and so on.
    - `row`, `column`: where each row of the matrix begins, and the column of each entry.
    - `factor_row`, `factor_column`, `diagonal`: the same for the factors $L$ and $U$ together, and
      the place of the diagonal of each row.
    - `place` (nodes, nodes): the place of each entry among the factors, -1 for none.
    - `changed`: the places that elimination changes, in its order.
    """

    def __init__(self, pattern: Bool[np.ndarray, "nodes nodes"]):
        steps = SparseLU(pattern).elimination
        self.order = np.array([pivot for pivot, *_ in steps], np.int32)
        filled = np.array(pattern, bool) | np.eye(len(pattern), dtype=bool)
        ordered = filled[np.ix_(self.order, self.order)]
        for pivot, rows, columns in steps:
            filled[np.ix_(rows, columns)] = True
            filled[pivot, pivot] = True
        factors = filled[np.ix_(self.order, self.order)]
        self.row, self.column = _by_rows(ordered)
        self.factor_row, self.factor_column = _by_rows(factors)
        self.place = np.full(factors.shape, -1, np.int32)
        self.place[factors] = np.arange(np.count_nonzero(factors))
        self.diagonal = np.diag(self.place).astype(np.int32)
        self.changed = np.array(
            [
                self.place[i, j]
                for i in range(len(factors))
                for k in np.flatnonzero(factors[i, :i])
                for j in k + 1 + np.flatnonzero(factors[k, k + 1 :])
            ],
            np.int32,
        )


def _by_rows(
    pattern: Bool[np.ndarray, "rows columns"],
) -> tuple[Int[np.ndarray, " begins"], Int[np.ndarray, " entries"]]:
    """Where each row of a pattern begins, and the column of each entry."""
    begins = np.append(0, np.cumsum(pattern.sum(axis=1)))
    return begins.astype(np.int32), np.nonzero(pattern)[1].astype(np.int32)
