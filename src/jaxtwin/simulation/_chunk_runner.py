"""Draws in chunks, over all cores or accelerators."""

import os
import threading
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Shaped

from .._jax_settings import own_settings
from ..physics import Twin
from ._chunk import Prepared, prepare_chunk
from ._delay import has_own_delays
from ._schedule import Schedule

Precision = Literal["float64", "float32"]

CHUNK_CPU = 128
"""Draws that one core works on at a time: enough that calls cost nothing beside the work, few
enough for its cache. Half as many where each has a delay and a table of its own for reading the
samples."""

CHUNK_ACCELERATOR = 65536
"""Draws that an accelerator works on at a time: enough to fill it."""


@final
@dataclass(frozen=True)
class ChunkRunner:
    """How chunks of draws are worked on.

    **Arguments:**

    - `twin`: what is not drawn keeps its values.
    - `initial`: temperatures at the start, checked.
    - `precision`: of the steps. Eigenvalues that span nine decades are always found in float64.
    - `chunk_size`: draws at a time, None for that of the device.
    - `workers`: threads, None for one a core, or one an accelerator.
    """

    twin: Twin
    initial: str | Float[np.ndarray, " starts"] | None
    precision: Precision
    chunk_size: int | None
    workers: int | None

    def run(
        self,
        draws: Mapping[str, Float[np.ndarray, " draws"]],
        schedule: Schedule,
        reduce: Callable[[Prepared], dict[str, Array | np.ndarray]],
        on_progress: Callable[[int], None] | None = None,
    ) -> dict[str, Shaped[np.ndarray, "draws *results"]]:
        """Prepares and reduces all draws, chunk by chunk.

        **Arguments:**

        - `draws`: name -> `(draws,)`, in the unit of the rig's table.
        - `schedule`: as commanded.
        - `reduce`: what is kept of a chunk.
        - `on_progress`: called with the number of draws of each finished chunk.

        **Returns:** what `reduce` makes of all draws, in their order.
        """
        _keep_freed_memory()
        accelerated = jax.default_backend() != "cpu"
        devices = jax.local_devices()
        count = len(next(iter(draws.values())))
        # Draws that are solved again come in any number: few sizes, few compilations.
        rounded = 1 << (count - 1).bit_length()
        size = self.chunk_size or min(self._chunk_of_device(accelerated, draws), rounded)
        result: dict[str, np.ndarray] = {}
        one_at_a_time = threading.Lock()

        def work(number: int) -> None:
            first = number * size
            chunk = {n: _padded(values[first : first + size], size) for n, values in draws.items()}
            # Each thread has its own precision.
            with jax.default_device(devices[number % len(devices)]):
                with own_settings():
                    prepared = prepare_chunk(self.twin, chunk, schedule, self.initial)
                    if self.precision == "float32":
                        numbers, rest = eqx.partition(prepared, eqx.is_inexact_array)
                        numbers = jax.tree.map(lambda leaf: leaf.astype("float32"), numbers)
                        prepared = eqx.combine(numbers, rest)
                with own_settings(float64=self.precision == "float64"):
                    found = jax.tree.map(np.asarray, reduce(prepared))
            with one_at_a_time:
                for name in found.keys() - result.keys():
                    result[name] = np.empty((count, *found[name].shape[1:]), found[name].dtype)
            for name, values in found.items():
                result[name][first : first + size] = values[: count - first]
            if on_progress is not None:
                with one_at_a_time:
                    on_progress(min(size, count - first))

        threads = self.workers or (len(devices) if accelerated else _cores())
        pool = ThreadPoolExecutor(max_workers=threads)
        try:
            # Exceptions come out where the results are asked for.
            for _ in pool.map(work, range(-(-count // size))):
                pass
        finally:
            # Interrupted while chunks are still handed out, nobody wants the rest.
            pool.shutdown(cancel_futures=True)
        return result

    def _chunk_of_device(self, accelerated: bool, drawn: Iterable[str]) -> int:
        if accelerated:
            return CHUNK_ACCELERATOR
        return CHUNK_CPU // 2 if has_own_delays(self.twin, drawn) else CHUNK_CPU


def _cores() -> int:
    """That this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    """The last chunk is filled up with its last draw: one shape, one compilation."""
    return np.concatenate([values, np.repeat(values[-1:], size - len(values))])


def _keep_freed_memory() -> None:
    """Has the allocator keep what a chunk frees for the next one.

    glibc returns large blocks to the system, which fills them with zeros again page by page: a
    third of the time of whole trajectories. It keeps blocks as large as the largest one that was
    freed, up to 32 MiB; this one is never touched and costs nothing.
    """
    np.empty((32 << 20) - (64 << 10), np.uint8)
