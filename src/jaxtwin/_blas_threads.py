"""One thread for the products of NumPy and SciPy.

The matrices of a match are tall and narrow. OpenBLAS divides each product among threads that wait
for each other busily: a match of `dual-cell` then takes a third more time on an idle machine, and
several times as much beside other work. The recordings of a match have threads already.

threadpoolctl finds the libraries and their functions, whose names differ from build to build.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from threading import Lock
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

_lock = Lock()
_inside = 0
_original_limits = None


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limits BLAS to one thread inside the block.

    The number of threads belongs to the process. Blocks of several threads may overlap; the number
    of before returns with the end of the last.
    """
    global _inside, _original_limits
    with _lock:
        if _inside == 0:
            _original_limits = _controller().limit(limits=1, user_api="blas")
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0 and _original_limits is not None:
                _original_limits.restore_original_limits()


@cache
def _controller() -> "ThreadpoolController":
    import scipy.linalg  # noqa: F401  # SciPy has a BLAS of its own, which must be loaded to be found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
