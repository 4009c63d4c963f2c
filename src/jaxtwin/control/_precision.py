"""float64 for a person at a prompt, and whatever the surroundings have for code inside of JAX."""

from contextlib import AbstractContextManager
from typing import TypeVar

import jax
import numpy as np
from jax.core import Tracer

from .._jax_settings import own_settings

Tree = TypeVar("Tree")


def is_traced(*values: object) -> bool:
    """Whether anything among these values is being traced by JAX."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def precision_for(*values: object) -> AbstractContextManager[None]:
    """The settings to compute with these values: float64 where none of them is traced."""
    return own_settings(float64=None if is_traced(*values) else True)


def plain(tree: Tree) -> Tree:
    """The same with NumPy's arrays in place of JAX's where they have values.

    JAX rounds float64 arrays to float32 wherever a person computes with them at a prompt, with a
    warning; NumPy's stay as they are, and JAX takes them as well.
    """
    return jax.tree.map(lambda leaf: leaf if isinstance(leaf, Tracer) else np.asarray(leaf), tree)
