"""The folder in which compiled programs are kept."""

import contextlib
import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import final

import platformdirs

from .._errors import JaxtwinError
from .._whole_file import write_whole_file

VARIABLE = "JAXTWIN_COMPILATION_CACHE"
OFF = ("off", "0", "no", "false")

LARGEST_CACHE = 1 << 30
"""The largest size of the folder, bytes; the least recently used program is deleted first."""

DIGEST = hashlib.sha256().digest_size


@final
@dataclass(frozen=True)
class CacheState:
    """The state of the folder in which compiled programs are kept.

    **Arguments:**

    - `folder`: the folder; None if programs are not kept.
    - `reason`: the setting that determined the folder.
    - `files`, `size`: the number of its files and their size, bytes.
    """

    folder: Path | None
    reason: str
    files: int
    size: int


def cache_state() -> CacheState:
    """The folder in which this process keeps compiled programs, and its contents."""
    folder, reason = _chosen()
    if folder is not None and not os.access(_existing(folder), os.W_OK):
        return CacheState(None, f"off, {folder} cannot be written to", 0, 0)
    sizes = [size for _, _, size in _programs(folder)] if folder is not None else []
    return CacheState(folder, reason, len(sizes), sum(sizes))


def cache_folder() -> Path | None:
    """The folder in which programs are to be kept, which need not exist; None if none are kept."""
    return _chosen()[0]


def load(folder: Path, name: str) -> bytes | None:
    """A kept program; None if there is none, or if it is damaged."""
    file = folder / name
    try:
        content = file.read_bytes()
        os.utime(file)  # the least recently used program is deleted if the folder is full
    except OSError:
        return None
    digest, program = content[:DIGEST], content[DIGEST:]
    return program if hashlib.sha256(program).digest() == digest else None


def save(folder: Path, name: str, program: bytes) -> None:
    """Keeps a program if that is possible. Other processes see it as a whole or not at all."""
    # A cache is optional: a full disk or a folder of another user is not an error.
    with contextlib.suppress(OSError, JaxtwinError):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        _make_room(folder, len(program))
        content = hashlib.sha256(program).digest() + program
        write_whole_file(folder / name, content, JaxtwinError)


def _make_room(folder: Path, size: int) -> None:
    programs = sorted(_programs(folder))
    total = size + sum(size for _, _, size in programs)
    for _, file, size in programs:
        if total <= LARGEST_CACHE:
            return
        file.unlink(missing_ok=True)
        total -= size


def _programs(folder: Path) -> list[tuple[float, Path, int]]:
    """For each program the time of its last use, its file, and its size in bytes."""
    found = []
    with contextlib.suppress(FileNotFoundError):
        for entry in os.scandir(folder):
            with contextlib.suppress(FileNotFoundError):  # another process made room
                about = entry.stat()
                found.append((about.st_mtime, Path(entry.path), about.st_size))
    return found


def _chosen() -> tuple[Path | None, str]:
    own = os.environ.get(VARIABLE, "")
    if own.lower() in OFF:
        return None, f"off by {VARIABLE}"
    if own:
        return Path(own), f"folder from {VARIABLE}"
    folder = Path(platformdirs.user_cache_dir("jaxtwin")) / "compiled"
    return folder, f"default; {VARIABLE}=off turns it off"


def _existing(folder: Path) -> Path:
    """The folder, or the nearest one above it that exists."""
    return next(place for place in (folder, *folder.absolute().parents) if place.exists())
