"""`rodas5p.c`, compiled for a network by the machine's own C compiler when it is first needed.

The libraries are kept beside the compiled programs, under the same rules as those
(`_compilation/_store.py`): what is loaded from there is run. A machine without a compiler, or with
JAXTWIN_NATIVE=off, solves draws by the programs of JAX.
"""

import ctypes
import hashlib
import json
import logging
import os
import platform
import shutil
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from .._compilation._fingerprint import processor
from .._compilation._store import OFF, cache_folder, load, save
from ..physics import LAW_FOLDER

logger = logging.getLogger("jaxtwin")

VARIABLE = "JAXTWIN_NATIVE"

SOURCE = Path(__file__).with_name("rodas5p.c")

# With the laws of heat that it includes.
SOURCES = (SOURCE, *sorted(LAW_FOLDER.glob("*.c")))

# Not -ffast-math: draws that fail are recognised by their NaN.
FLAGS = ("-std=gnu11", "-O3", "-fno-math-errno", "-fPIC", "-shared")

# For all instructions of this processor; left out where the compiler does not know the flag.
OWN_PROCESSOR = ("-march=native",)

# The longest time that a compilation may take, s.
PATIENCE = 60.0


class NativeState(NamedTuple):
    """Whether draws can be solved by a native library.

    - `compiler`: the C compiler, None if draws cannot be.
    - `reason`: why, for people.
    """

    compiler: str | None
    reason: str


def native_state() -> NativeState:
    """Whether this process solves draws by native libraries, as far as that is known before one is
    compiled."""
    if os.environ.get(VARIABLE, "").lower() in OFF:
        return NativeState(None, f"by JAX; C is off by {VARIABLE}")
    name = os.environ.get("CC", "cc")
    compiler = shutil.which(name)
    if compiler is None:
        return NativeState(None, f"by JAX; there is no C compiler {name!r}, CC names another")
    return NativeState(compiler, f"in C, compiled by {compiler}; {VARIABLE}=off turns it off")


def native_library(header: str) -> ctypes.CDLL | None:
    """The library of a network, compiled or loaded by the first call; None if there can be none.

    **Arguments:**

    - `header`: `network.h`, see `NativeNetwork`.
    """
    compiler, _ = native_state()
    return None if compiler is None else _library(compiler, header)


@lru_cache(maxsize=32)
def _library(compiler: str, header: str) -> ctypes.CDLL | None:
    name = _name(compiler, header)
    folder = cache_folder()
    built = None if folder is None else load(folder, name)
    try:
        if built is None:
            built = _compiled(compiler, header)
            if folder is not None:
                save(folder, name, built)
        return _loaded(built)
    except (OSError, subprocess.SubprocessError) as error:
        logger.warning("draws are solved by JAX: %s cannot compile for them: %s", compiler, error)
        return None


def _name(compiler: str, header: str) -> str:
    """The name of a kept library. It differs for other sources, compilers and processors, for whose
    instructions a library is compiled."""
    about = Path(compiler).stat()
    parts = [
        *(file.read_text() for file in SOURCES),
        header,
        repr(
            (FLAGS, OWN_PROCESSOR, compiler, about.st_size, about.st_mtime_ns, platform.machine())
        ),
        processor(),
    ]
    return "rodas5p-" + hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _compiled(compiler: str, header: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "network.h").write_text(header)
        target = Path(folder) / "rodas5p.so"
        last = ["-I", folder, str(SOURCE), "-o", str(target), "-lm"]
        done = None
        for flags in (OWN_PROCESSOR, ()):
            command = [compiler, *FLAGS, *flags, *last]
            done = subprocess.run(command, check=False, capture_output=True, timeout=PATIENCE)
            if done.returncode == 0:
                return target.read_bytes()
        assert done is not None
        raise OSError(done.stderr.decode(errors="replace").strip() or "it failed without a word")


def _loaded(built: bytes) -> ctypes.CDLL:
    """Loads a library from a copy that only this process can have written."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "rodas5p.so"
        copy.write_bytes(built)
        return ctypes.CDLL(str(copy))
