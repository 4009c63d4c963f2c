"""Writing a file as a whole or not at all."""

import os
import uuid

from ._arguments import path_of
from ._errors import JaxtwinError


def write_whole_file(
    path: str | os.PathLike[str], content: bytes, error: type[JaxtwinError]
) -> None:
    """Writes a file beside its place and then moves it there.

    A reader never sees half a file, and a full disk leaves an older file as it was.

    **Raises:** `error` where the file cannot be written.
    """
    file = path_of("path", path, error)
    part = file.with_name(f".{file.name}.{uuid.uuid4().hex}.part")
    try:
        try:
            with part.open("xb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            part.replace(file)
        finally:
            part.unlink(missing_ok=True)
    except OSError as problem:
        raise error(f"{file}: cannot be written: {problem.strerror or problem}") from None
