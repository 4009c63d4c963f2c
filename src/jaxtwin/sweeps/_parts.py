"""Which part of a sweep a process does: chunks are dealt out by their number.

Workers need not know of each other: none waits for another, and one that dies takes none with it.
"""

from collections.abc import Sequence

from .._arguments import whole_number
from .._errors import SimulationError


def own_part(process: tuple[int, int] | None = None) -> tuple[int, int]:
    """This process's number and how many there are.

    **Arguments:**

    - `process`: what the user says, or None: as `jax.distributed` says where it is initialised,
      else 0 of 1.

    **Raises:** `SimulationError` where there is no such part.
    """
    if process is None:
        import jax

        if jax.distributed.is_initialized():
            return jax.process_index(), jax.process_count()
        return 0, 1
    if not isinstance(process, Sequence) or len(process) != 2:
        raise SimulationError(f"process: found {process!r}, allowed is (number, how many)")
    number, count = (whole_number("process", one, None, SimulationError) for one in process)
    if not 0 <= number < count:
        raise SimulationError(
            f"process: found {number} of {count}, allowed are 0 to {max(count, 1) - 1} of "
            f"{max(count, 1)}"
        )
    return number, count


def meet(coordinator: str | None, processes: int | None, number: int | None) -> tuple[int, int]:
    """Lets the processes of a cluster find each other through `jax.distributed`, and part again.

    A sweep needs to know no more than its part. The connection is closed at once, because JAX ends
    every process of a cluster when one is lost.

    **Arguments:**

    - `coordinator`: `host:port` of process 0.
    - `processes`, `number`: None where the cluster's own scheduler knows them.

    **Returns:** number of this process and how many there are.

    **Raises:** `SimulationError` where they do not meet.
    """
    import jax
    from jax._src.distributed import global_state

    if processes is not None and number is not None:
        own_part((number, processes))
    try:
        jax.distributed.initialize(coordinator, processes, number)
        part = global_state.process_id, global_state.num_processes
        jax.distributed.shutdown()
    except (RuntimeError, ValueError) as problem:
        reason = str(problem).splitlines()[0]
        raise SimulationError(f"{coordinator or 'cluster'}: {reason}") from None
    return part
