"""The entries of a sparse Jacobian from a few directional derivatives."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ._sparse_lu import Entry


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
