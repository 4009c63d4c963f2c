"""Sums of links' values by where the links end, which a network is put together from."""

from collections.abc import Sequence
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

LARGEST_TABLE = 1 << 18
"""Entries of a table of rows and links. A product with a larger one takes longer than to add up its
few entries, and as a constant it takes the compiler minutes."""


@final
class LinkSums:
    """For each of some rows the sum over its links.

    **Arguments:**

    - `rows`: how many there are.
    - `members`: pairs (row, number of the link).
    - `links`: how many there are.
    """

    def __init__(self, rows: int, members: Sequence[tuple[int, int]], links: int):
        self.rows = rows
        self.members = np.array(members, dtype=np.int32).reshape(-1, 2).T
        self.table = None
        if rows * links <= LARGEST_TABLE:
            self.table = np.zeros((rows, links))
            self.table[*self.members] = 1.0

    def __call__(self, values: Float[Array, " links"]) -> Float[Array, " rows"]:
        if self.table is not None:
            return jnp.asarray(self.table, values.dtype) @ values
        row, link = self.members
        return jnp.zeros(self.rows, values.dtype).at[row].add(values[link])
