"""Which chunks of a sweep a process computes: chunk k belongs to process k mod N.

The processes need not know of each other: none waits for another, and none fails with another.
"""

import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool

from .._arguments import whole_number
from .._errors import SimulationError


def assigned_part(process: tuple[int, int] | None = None) -> tuple[int, int]:
    """The number of this process and the number of processes.

    **Arguments:**

    - `process`: both numbers, or None to take them from `jax.distributed`. Where that is not
      initialised, this process is number 0 of 1.

    **Returns:** (number, processes), where numbers count from 0.

    **Raises:** `SimulationError` where `process` is no pair of whole numbers, or the number is not
    below the number of processes.
    """
    if process is None:
        import jax

        if jax.distributed.is_initialized():
            return jax.process_index(), jax.process_count()
        return 0, 1
    if not isinstance(process, Sequence) or len(process) != 2:
        raise SimulationError(f"process: expected (number, processes), got {process!r}")
    number, count = (whole_number("process", part, None, SimulationError) for part in process)
    if not 0 <= number < count:
        raise SimulationError(
            f"process: expected 0 to {max(count, 1) - 1} of {max(count, 1)}, got {number} of "
            f"{count}"
        )
    return number, count


def init_distributed(
    coordinator: str | None, processes: int | None, number: int | None
) -> tuple[int, int]:
    """Asks `jax.distributed` for the number of this process.

    A sweep needs no more than that number. A child process asks for it and ends, because JAX ends
    every process of a cluster when one of them is lost.

    **Arguments:**

    - `coordinator`: `host:port` of process 0.
    - `processes`, `number`: the number of processes and the number of this one; None where the
      cluster's scheduler knows them.

    **Returns:** (number, processes).

    **Raises:** `SimulationError` where the processes cannot connect to the coordinator.
    """
    if processes is not None and number is not None:
        assigned_part((number, processes))
    try:
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as child:
            return child.submit(_number_in_cluster, coordinator, processes, number).result()
    except (RuntimeError, ValueError, BrokenProcessPool) as problem:
        reason = str(problem).splitlines()[0]
        raise SimulationError(f"{coordinator or 'cluster'}: {reason}") from None


def _number_in_cluster(
    coordinator: str | None, processes: int | None, number: int | None
) -> tuple[int, int]:
    import jax

    jax.config.update("jax_platforms", "cpu")  # the numbers need no accelerator
    jax.distributed.initialize(coordinator, processes, number)
    part = jax.process_index(), jax.process_count()
    jax.distributed.shutdown()
    return part
