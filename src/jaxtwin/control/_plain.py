"""Arrays as a person at a prompt wants them."""

from typing import TypeVar

import jax
import numpy as np
from jax.core import Tracer

Tree = TypeVar("Tree")


def plain(tree: Tree) -> Tree:
    """The same with NumPy's arrays in place of JAX's where they have values.

    JAX rounds float64 arrays to float32 wherever a person computes with them at a prompt, with a
    warning; NumPy's stay as they are, and JAX takes them as well.
    """
    return jax.tree.map(lambda leaf: leaf if isinstance(leaf, Tracer) else np.asarray(leaf), tree)
