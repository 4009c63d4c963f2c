"""Writes a file as a whole or not at all, in the format that its ending names."""

import os
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import IO

from ._arguments import path_of
from .errors import JaxtwinError


def check_ending(
    path: str | os.PathLike[str], endings: Sequence[str], error: type[JaxtwinError]
) -> str:
    """Refuses a path whose ending names another format than the one that would be written.

    **Arguments:**

    - `endings`: the allowed endings, in lower case and with their dot.

    **Returns:** the ending, in lower case.

    **Raises:** `error` for any other.
    """
    ending = Path(path).suffix
    if ending.lower() not in endings:
        raise error(f"{os.fspath(path)}: ending: expected {' or '.join(endings)}, got {ending!r}")
    return ending.lower()


def write_whole_file(
    path: str | os.PathLike[str], content: bytes, error: type[JaxtwinError], *, mode: int = 0o666
) -> None:
    """Writes a file under a temporary name in its folder, and then renames it.

    A reader never sees half a file, and a full disk leaves an older file as it was. `mode` are the
    permissions of the file, from which the user's umask takes some.

    **Raises:** `error` if the file cannot be written.
    """
    with whole_file(path, error, mode=mode) as stream:
        stream.write(content)


@contextmanager
def whole_file(
    path: str | os.PathLike[str], error: type[JaxtwinError], *, mode: int = 0o666
) -> Iterator[IO[bytes]]:
    """A stream whose content becomes the file when the block ends without an error.

    **Raises:** `error` if the file cannot be written.
    """
    file = path_of("path", path, error)
    part = file.with_name(f".{file.name}.{uuid.uuid4().hex}.part")
    try:
        try:
            with open(part, "xb", opener=partial(os.open, mode=mode)) as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            part.replace(file)
        finally:
            part.unlink(missing_ok=True)
    except OSError as problem:
        raise error(f"{file}: cannot be written: {problem.strerror or problem}") from None
