"""Files that are on the disk for good, and claims on them that end with their process."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from .._errors import SimulationError

try:
    import fcntl
except ImportError:  # not on Windows: two processes may then do the same work, with one result
    fcntl = None


def put(file: Path, content: bytes) -> None:
    """Writes a file so that it is there as a whole or not at all, also after a power cut.

    One process at a time may do this to a file.
    """
    part = file.with_name(f".{file.name}.part")
    part.write_bytes(content)
    _sync(part)
    part.replace(file)
    _sync(file.parent)


def to_disk(file: Path) -> None:
    """Forces a file to the disk, and its name in the folder."""
    _sync(file)
    _sync(file.parent)


def lock(file: IO[bytes], byte: int) -> bool:
    """Locks one byte of an open file until it is closed; False where another process has it."""
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
    """Turns errors of the disk, or of a missing library, into one line about a folder.

    **Raises:** `SimulationError`.
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
