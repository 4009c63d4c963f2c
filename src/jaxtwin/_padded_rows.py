"""Pads rows to a few sizes, so that data of similar lengths use the same compiled programs.

Rows are padded to the next of eight sizes in each octave, by an eighth at most.
"""

from typing import TypeVar

import jax
import numpy as np
from jaxtyping import Shaped

# The number of sizes in each octave, and the smallest size.
SIZES_PER_OCTAVE = 8

Rows = TypeVar("Rows")


def padded_count(count: int, least_part: int = SIZES_PER_OCTAVE) -> int:
    """The number of rows after padding, a multiple of at least `least_part`."""
    part = max(least_part, 2 ** (count.bit_length() - 1) // SIZES_PER_OCTAVE)
    return -(-count // part) * part


def padded(
    rows: Shaped[np.ndarray, "rows *columns"], fill: object = None, least: int = 0
) -> Shaped[np.ndarray, "filled *columns"]:
    """Pads rows with a value, or with the last row if it is None, to at least `least` rows."""
    missing = padded_count(max(len(rows), least)) - len(rows)
    last = rows[-1:] if fill is None else np.full_like(rows[:1], fill)
    return np.concatenate([rows, np.repeat(last, missing, axis=0)])


def padded_rows(rows: Rows, least: int = 0) -> Rows:
    """Pads each array of a PyTree with its last row."""
    return jax.tree.map(lambda array: padded(np.asarray(array), least=least), rows)


def first_rows(of_padded: Rows, count: int) -> Rows:
    """The first rows of each array of a PyTree, in NumPy."""
    return jax.tree.map(lambda array: np.asarray(array)[:count], of_padded)
