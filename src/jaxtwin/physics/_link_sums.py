"""Sums of links' values, grouped by the nodes at which the links end, from which the matrices of a
network are assembled."""

from collections.abc import Sequence
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# The largest number of entries of a dense table of rows and links. A product with a larger table
# takes longer than adding up the few entries that are not 0, and its compilation takes minutes.
MAX_TABLE = 1 << 18


@final
class LinkSums:
    """Sums of values of links, one sum for each row.

    **Arguments:**

    - `rows`: the number of rows.
    - `members`: pairs (row, number of the link).
    - `links`: the number of links.
    """

    def __init__(self, rows: int, members: Sequence[tuple[int, int]], links: int):
        self.rows = rows
        self.members = np.array(members, dtype=np.int32).reshape(-1, 2).T
        self.table = None
        if rows * links <= MAX_TABLE:
            self.table = np.zeros((rows, links))
            self.table[*self.members] = 1.0

    def __call__(self, values: Float[Array, " links"]) -> Float[Array, " rows"]:
        if self.table is not None:
            return jnp.asarray(self.table, values.dtype) @ values
        row, link = self.members
        return jnp.zeros(self.rows, values.dtype).at[row].add(values[link])
