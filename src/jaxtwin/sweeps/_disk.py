"""Files that survive a power cut, and locks that end with the process that holds them."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from ..errors import SimulationError

try:
    import fcntl
except ImportError:  # not on Windows: two processes may then do the same work, with one result
    fcntl = None


def put(file: Path, content: bytes) -> None:
    """Writes a file completely or not at all, even if the power fails meanwhile.

    Only one process at a time may write a given file.
    """
    part = file.with_name(f".{file.name}.part")
    part.write_bytes(content)
    _sync(part)
    part.replace(file)
    _sync(file.parent)


def to_disk(file: Path) -> None:
    """Forces a file and its entry in the folder to the disk."""
    _sync(file)
    _sync(file.parent)


def lock(file: IO[bytes], byte: int) -> bool:
    """Locks one byte of an open file until it is closed. Returns False if another process holds the
    lock."""
    if fcntl is None:
        return True
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True  # a file system without locks is like Windows
    return True


@contextmanager
def disk_errors(folder: Path) -> Iterator[None]:
    """Turns an error of the disk, or a missing library, into an error that names the folder.

    **Raises:** `SimulationError` for any of them.
    """
    try:
        yield
    except ImportError:
        raise SimulationError(
            "a sweep's results are kept by zarr, which is not installed: "
            "pip install 'jaxtwin[storage]', in a checkout pip install -e '.[storage]'"
        ) from None
    except OSError as problem:
        raise SimulationError(f"{folder}: {problem.strerror or problem}") from None


def _sync(path: Path) -> None:
    if os.name == "nt" and path.is_dir():
        return  # folders cannot be opened there
    handle = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
