"""Converts JAX's arrays to NumPy's."""

from typing import TypeVar

import jax
import numpy as np
from jax.core import Tracer

Tree = TypeVar("Tree")


def to_numpy(tree: Tree) -> Tree:
    """Converts the leaves of a PyTree to NumPy arrays, except those that JAX traces.

    Computing with a float64 array of JAX outside of `jax.enable_x64` rounds it to float32. NumPy
    arrays keep their precision, and JAX accepts them as well.
    """
    return jax.tree.map(lambda leaf: leaf if isinstance(leaf, Tracer) else np.asarray(leaf), tree)
