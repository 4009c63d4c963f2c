"""Programs that are traced and compiled once per machine, not once per process.

`persistent_jit` (`_persistent_jit`) stands in place of `jax.jit`: it recognises a program by the
code that it is traced from and the shapes of its arguments (`_fingerprint`), and keeps the compiled
program in a folder (`_store`). `persistent_jit_unoptimised` is for what runs in LAPACK.

JAX's own cache cannot take its place: a process must trace a program before it can look it up
there, which is a large part of a first call. What is kept are therefore executables of
`jax.experimental.serialize_executable`, which are pickles; `_store` says from which folders they
are loaded. A program that cannot be serialized or loaded is traced and compiled as by `jax.jit`.
"""

from ._persistent_jit import clear_programs as clear_programs
from ._persistent_jit import compiling_seconds as compiling_seconds
from ._persistent_jit import persistent_jit as persistent_jit
from ._persistent_jit import persistent_jit_unoptimised as persistent_jit_unoptimised
from ._store import MAX_CACHE as MAX_CACHE
from ._store import CacheState as CacheState
from ._store import cache_state as cache_state
