"""JAX's persistent compilation cache, for the command line.

Compiling takes most of a short command's time, and JAX can keep what it compiled in a folder. That
is a setting of a whole process: the command line owns its process and may switch it on, the library
leaves it alone.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import final

VARIABLE = "JAXTWIN_COMPILATION_CACHE"
OFF = ("off", "0", "no", "false")


@final
@dataclass(frozen=True)
class CacheState:
    """Where the command line keeps compiled programs.

    **Arguments:**

    - `folder`: None where it keeps none.
    - `reason`: who decided.
    - `files`, `size`: what lies there, bytes.
    """

    folder: Path | None
    reason: str
    files: int
    size: int


def use_compilation_cache() -> None:
    """Switches the cache on in this process, unless the user said otherwise.

    `JAXTWIN_COMPILATION_CACHE=off` turns it off, another value is the folder to use; a folder that
    JAX itself was given (`JAX_COMPILATION_CACHE_DIR`) is left as it is.
    """
    folder, _ = _chosen()
    if folder is None or os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return  # a cache is a convenience; `jaxtwin doctor` says that there is none
    import jax

    jax.config.update("jax_compilation_cache_dir", str(folder))
    # A twin compiles in pieces of some tenths of a second; JAX's own limit, 1 s, would drop them.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def cache_state() -> CacheState:
    """What `use_compilation_cache` does here and what the cache holds."""
    folder, reason = _chosen()
    sizes = []
    if folder is not None and not os.access(_existing(folder), os.W_OK):
        return CacheState(None, f"off, {folder} cannot be written to", 0, 0)
    if folder is not None and folder.is_dir():
        sizes = [file.stat().st_size for file in folder.rglob("*") if file.is_file()]
    return CacheState(folder, reason, len(sizes), sum(sizes))


def _chosen() -> tuple[Path | None, str]:
    own = os.environ.get(VARIABLE, "")
    if own.lower() in OFF:
        return None, f"off by {VARIABLE}"
    if own:
        return Path(own), f"folder from {VARIABLE}"
    if given := os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return Path(given), "folder from JAX_COMPILATION_CACHE_DIR"
    import pooch

    folder = Path(pooch.os_cache("jaxtwin")) / "compiled"
    return folder, f"default; {VARIABLE}=off turns it off"


def _existing(folder: Path) -> Path:
    """The folder, or the nearest one above it that exists."""
    return next(place for place in (folder, *folder.absolute().parents) if place.exists())
