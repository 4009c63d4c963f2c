"""Distributes chunks of draws over all cores or accelerators."""

import os
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
from jaxtyping import Array, Float, Shaped

# The number of draws in a chunk on a CPU: large enough to hide the cost of a call, small enough for
# the memory that `_keep_freed_memory` keeps.
CHUNK_CPU = 64

# The number of draws in a chunk on an accelerator: enough to fill it, in some gigabytes of memory.
# CUDA's batched eigensolvers take at most 65 535 matrices.
CHUNK_ACCELERATOR = 16384


def work_in_chunks(
    draws: Mapping[str, Float[np.ndarray, " draws"]],
    work: Callable[[Mapping[str, Float[np.ndarray, " chunk"]]], Mapping[str, Array | np.ndarray]],
    *,
    chunk_size: int,
    workers: int | None = None,
    on_progress: Callable[[int], None] | None = None,
    total: int | None = None,
) -> dict[str, Shaped[np.ndarray, "draws ..."]]:
    """Processes all draws, chunk by chunk.

    **Arguments:**

    - `draws`: name -> `(draws,)`.
    - `work`: draws of a chunk -> results by name, each with a leading axis for the draws. All
      chunks have the same number of draws. It is called from several threads.
    - `chunk_size`: the number of draws in a chunk.
    - `workers`: the number of threads; None for one for each core, or for each accelerator.
    - `on_progress`: called with the number of draws of each finished chunk.
    - `total`: the number of all draws, if these are a part of them. Chunks are then as large as
      they would be for all draws, so that results do not depend on how the draws are divided.

    **Returns:** the results of all draws, in order.
    """
    devices = jax.local_devices()

    def work_on_device(
        chunk: Mapping[str, Float[np.ndarray, " chunk"]], part: slice
    ) -> Mapping[str, np.ndarray]:
        number = part.start // len(next(iter(chunk.values())))
        with jax.default_device(devices[number % len(devices)]):
            return {name: np.asarray(values) for name, values in work(chunk).items()}

    return fill_in_chunks(
        draws,
        work_on_device,
        chunk_size=chunk_size,
        workers=workers or (len(devices) if is_accelerated() else None),
        on_progress=on_progress,
        total=total,
    )


def fill_in_chunks(
    draws: Mapping[str, Float[np.ndarray, " draws"]],
    work: Callable[[Mapping[str, Float[np.ndarray, " chunk"]], slice], Mapping[str, np.ndarray]],
    *,
    chunk_size: int,
    workers: int | None = None,
    on_progress: Callable[[int], None] | None = None,
    total: int | None = None,
) -> dict[str, Shaped[np.ndarray, "draws ..."]]:
    """Processes all draws as `work_in_chunks` does, with a `work` that may write into an array of
    all draws itself.

    **Arguments:**

    - `work`: draws of a chunk, and their part of all draws -> further results by name. The last
      chunk may have more draws than its part, which it ends with copies of the last draw.
    """
    _keep_freed_memory()
    count = len(next(iter(draws.values())))
    size = _chunk_size(total or count, chunk_size)
    result: dict[str, np.ndarray] = {}
    one_at_a_time = threading.Lock()

    def work_on(number: int) -> None:
        first = number * size
        chunk = {n: _padded(values[first : first + size], size) for n, values in draws.items()}
        part = slice(first, min(first + size, count))
        solution = work(chunk, part)
        with one_at_a_time:
            for name, values in solution.items():
                if name not in result:
                    result[name] = np.empty((count, *values.shape[1:]), values.dtype)
        for name, values in solution.items():
            result[name][part] = values[: part.stop - first]
        if on_progress is not None:
            with one_at_a_time:
                on_progress(part.stop - first)

    threads = workers or _cores()
    pool = ThreadPoolExecutor(max_workers=threads)
    try:
        # Reading the results raises the exceptions of the workers.
        for _ in pool.map(work_on, range(-(-count // size))):
            pass
    finally:
        # Interrupted while chunks are still handed out, nobody wants the rest.
        pool.shutdown(cancel_futures=True)
    return result


def usual_chunk_size() -> int:
    """The default chunk size for the kind of device."""
    return CHUNK_ACCELERATOR if is_accelerated() else CHUNK_CPU


def is_accelerated() -> bool:
    """Whether the default device of JAX is not a CPU."""
    return jax.default_backend() != "cpu"


def _chunk_size(count: int, largest: int) -> int:
    """The number of draws in a chunk: a power of four, or `largest`, because draws that are solved
    again come in any number, and few sizes need few compilations."""
    bits = (count - 1).bit_length()
    size = min(1 << (bits + bits % 2), largest)
    # Two chunks of a quarter have half as many copies, and may be computed by two cores. Below
    # `CHUNK_CPU` draws the cost of a call counts more.
    return size // 4 if size >= 4 * CHUNK_CPU and count <= size // 2 else size


def _cores() -> int:
    """The number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    """Pads the last chunk with its last draw: all chunks have one shape and one compiled
    program."""
    return np.concatenate([values, np.repeat(values[-1:], size - len(values))])


def _keep_freed_memory() -> None:
    """Makes the allocator keep the memory that a chunk frees for the next chunk.

    glibc returns large blocks to the system, which fills them with zeros again page by page. That
    takes a third of the time of whole trajectories. It keeps blocks up to the size of the largest
    block that was freed, at most 32 MiB; the block that is freed here is never touched and costs
    nothing.
    """
    np.empty((32 << 20) - (64 << 10), np.uint8)
