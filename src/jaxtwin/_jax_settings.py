"""The settings of JAX with which this package computes, independently of those of the user.

They apply only inside a `with` block and in its thread, so that the user's settings are not
changed.
"""

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import DTypeLike
from jaxtyping import PyTree

from .errors import JaxtwinError

Tree = TypeVar("Tree")

# The process that has used JAX first, of which this one may be a fork.
_first_process: int | None = None


@contextmanager
def own_settings(*, float64: bool | None = True) -> Iterator[None]:
    """Applies jaxtwin's JAX settings, whatever debugging settings or precision the user has set.

    **Arguments:**

    - `float64`: whether to compute in float64; None to use the user's setting.
    """
    if _first_process != os.getpid():
        _check_process()
    with ExitStack() as stack:
        if float64 is not None:
            stack.enter_context(jax.enable_x64(float64))
        # Rank and type promotion is intended: vectors scale rows, integers multiply floats.
        stack.enter_context(jax.numpy_rank_promotion("allow"))
        stack.enter_context(jax.numpy_dtype_promotion("standard"))
        # Recordings are NumPy arrays, which are transferred to the device when they are used.
        stack.enter_context(jax.transfer_guard("allow"))
        # A failed draw is recognised by its NaN.
        stack.enter_context(jax.debug_nans(False))
        stack.enter_context(jax.debug_infs(False))
        # Without compilation, operation by operation, a match would take hours.
        stack.enter_context(jax.disable_jit(False))
        # A float32 solve is right to a millikelvin with sums in float32. An accelerator would take
        # TF32 by itself, with errors of 0.07 K.
        stack.enter_context(jax.default_matmul_precision("float32"))
        yield


def _check_process() -> None:
    """Refuses a process in which JAX would wait for ever, or has no device.

    **Raises:** `JaxtwinError` in a fork of a process that has used JAX, whose threads are not there
    in the fork, and if JAX finds none of the platforms that it is told to use.
    """
    global _first_process
    if _first_process is not None:
        raise JaxtwinError(
            f"expected a process of its own, got a fork of process {_first_process}, which has "
            "used JAX: its threads are not here, so that computations would never end; take "
            'multiprocessing.get_context("spawn"), or "forkserver"'
        )
    try:
        jax.devices()
    except (RuntimeError, AssertionError) as error:  # JAX asserts that it has found a platform
        wanted = jax.config.jax_platforms  # pyright: ignore[reportAttributeAccessIssue]
        if not wanted:
            raise
        reason = str(error).splitlines()[0] if str(error) else "JAX finds no such device"
        raise JaxtwinError(
            f"JAX_PLATFORMS={wanted}: expected platforms that are there, got none: {reason}; "
            "JAX_PLATFORMS=cpu, or nothing, takes the processor"
        ) from None
    _first_process = os.getpid()


def is_traced(*values: object) -> bool:
    """Whether anything among these values is being traced by JAX."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def settings_for(*values: object) -> AbstractContextManager[None]:
    """The settings to compute with these values: float64, or the user's precision if one of the
    values is traced."""
    return own_settings(float64=None if is_traced(*values) else True)


def in_precision(tree: PyTree, dtype: DTypeLike) -> PyTree:
    """Converts the arrays of a tree that hold floating-point numbers to a precision."""

    def cast(leaf: object) -> object:
        is_array = isinstance(leaf, jax.Array | np.ndarray)
        is_floating = is_array and jnp.issubdtype(leaf.dtype, jnp.floating)
        return jnp.asarray(leaf, dtype) if is_floating else leaf

    return jax.tree.map(cast, tree)


def to_numpy(tree: Tree) -> Tree:
    """Converts the leaves of a PyTree to NumPy arrays, except those that JAX traces.

    Computing with a float64 array of JAX outside of `jax.enable_x64` rounds it to float32. NumPy
    arrays keep their precision, and JAX accepts them as well.
    """
    return jax.tree.map(lambda leaf: leaf if isinstance(leaf, Tracer) else np.asarray(leaf), tree)
