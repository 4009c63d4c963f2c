"""The workers of a Dask cluster as an executor."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from ..errors import SimulationError

if TYPE_CHECKING:
    from .._executor import Executor

# The time that a scheduler has to answer, s.
CONNECT_SECONDS = 10


@contextmanager
def dask_executor(address: str, where: str = "--dask") -> "Iterator[Executor]":
    """The workers of a Dask cluster.

    **Arguments:**

    - `where`: what asks for them, for messages.

    **Raises:** `SimulationError` if there is no scheduler, or Dask is not installed.
    """
    try:
        from distributed import Client
    except ImportError:
        raise SimulationError(
            f"{where}: expected Dask, which is not installed: pip install 'jaxtwin[dask]', in a "
            "checkout pip install -e '.[dask]'"
        ) from None
    # A client that is the default tells all of Dask to use it, and a failed one leaves that behind:
    # xarray then writes no file in this process.
    try:
        client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as problem:
        raise SimulationError(f"{where}: {address}: {problem}") from None
    with client:
        yield client.get_executor()
