"""The folder in which compiled programs are kept.

What is loaded from it is run: JAX serializes its executables as pickles, and has no other form for
them. Programs are therefore neither loaded from nor kept in a folder that another user owns or may
write to, and no file is loaded that another user could have changed. Only files that end with
`ENDING` are counted and deleted.
"""

import contextlib
import hashlib
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import final

import platformdirs

from .._whole_file import write_whole_file
from ..errors import JaxtwinError

VARIABLE = "JAXTWIN_COMPILATION_CACHE"
OFF = ("off", "0", "no", "false")

# The largest size of the folder, bytes; the least recently used program is deleted first.
MAX_CACHE = 1 << 30

# The ending of the files of this cache.
ENDING = ".jaxtwin-program"

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
    if folder is not None and (problem := _problem(folder)):
        return CacheState(None, f"off, {problem}", 0, 0)
    sizes = [size for _, _, size in _programs(folder)] if folder is not None else []
    return CacheState(folder, reason, len(sizes), sum(sizes))


def cache_folder() -> Path | None:
    """The folder in which programs are to be kept, which need not exist; None if none are kept."""
    folder, _ = _chosen()
    return None if folder is None or _problem(folder) else folder


def load(folder: Path, name: str) -> bytes | None:
    """A kept program; None if there is none, or if it is damaged."""
    file = folder / (name + ENDING)
    try:
        # The file that is checked is the one that is read, and no link to another.
        with open(file, "rb", opener=_without_links) as stream:
            if not _is_own(os.fstat(stream.fileno())):
                return None
            content = stream.read()
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
        write_whole_file(folder / (name + ENDING), content, JaxtwinError, mode=0o600)


def _without_links(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0))


def _is_own(about: os.stat_result) -> bool:
    """Whether a file or folder is the user's and nobody else may write to it. Windows, where
    permissions have another form, keeps the folder inside the user's profile."""
    if not hasattr(os, "getuid"):
        return True
    return about.st_uid == os.getuid() and not about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _make_room(folder: Path, size: int) -> None:
    programs = sorted(_programs(folder))
    total = size + sum(size for _, _, size in programs)
    for _, file, size in programs:
        if total <= MAX_CACHE:
            return
        file.unlink(missing_ok=True)
        total -= size


def _programs(folder: Path) -> list[tuple[float, Path, int]]:
    """For each program the time of its last use, its file, and its size in bytes."""
    result = []
    with contextlib.suppress(FileNotFoundError):
        for entry in os.scandir(folder):
            if not entry.name.endswith(ENDING):
                continue
            with contextlib.suppress(FileNotFoundError):  # another process made room
                about = entry.stat(follow_symlinks=False)
                result.append((about.st_mtime, Path(entry.path), about.st_size))
    return result


def _chosen() -> tuple[Path | None, str]:
    own = os.environ.get(VARIABLE, "")
    if own.lower() in OFF:
        return None, f"off by {VARIABLE}"
    if own:
        return Path(own), f"folder from {VARIABLE}"
    folder = Path(platformdirs.user_cache_dir("jaxtwin")) / "compiled"
    return folder, f"default; {VARIABLE}=off turns it off"


def _problem(folder: Path) -> str:
    """Why programs cannot be kept in a folder; empty if they can."""
    if folder.exists() and not _is_own(folder.stat()):
        return f"{folder} is another user's or can be written to by others; chmod go-w mends that"
    if not os.access(_existing(folder), os.W_OK):
        return f"{folder} cannot be written to"
    return ""


def _existing(folder: Path) -> Path:
    """The folder, or the nearest one above it that exists."""
    return next(place for place in (folder, *folder.absolute().parents) if place.exists())
