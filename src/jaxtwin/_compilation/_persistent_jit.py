"""A `jit` whose compiled programs outlive the process.

JAX's own persistent compilation cache keeps the output of XLA, but every process traces and lowers
every function again, which is a large part of a first call. Here the key of a program needs no
tracing: it consists of the function, the code of this package and its libraries, the static
arguments, and the arrays' shapes and types.
"""

import contextlib
import functools
import pickle
import threading
import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, ParamSpec, TypeVar, final

import equinox as eqx
import jax
from jax.core import Tracer
from jax.experimental import serialize_executable
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun
from jaxtyping import Array, PyTree

from ._fingerprint import NoFingerprintError, fingerprint, surroundings
from ._store import cache_folder, load, save

P = ParamSpec("P")
T = TypeVar("T")

# The largest number of programs of one function in memory; the oldest is dropped first. Each has
# about forty memory maps, and Linux ends a process with 65 530 of them.
MAX_PROGRAMS = 16

# Compiler options without LLVM's optimisations, which take most of the time of compilation.
# Operations follow each other: in a step of an observer, which has a hundred small ones, to hand
# them to other threads takes as long as all their work. XLA's older code generator for fused
# operations takes half as long as the newer one, and its code is as fast here
# (`benchmarks/NOTES.md`).
UNOPTIMISED: dict[str, str | bool] = {
    "xla_cpu_enable_concurrency_optimized_scheduler": False,
    "xla_cpu_use_fusion_emitters": False,
    "xla_backend_optimization_level": "0",
}

# The same options with LLVM's first level of optimisation. The higher levels take a quarter longer
# and give code that is not faster here.
COMPILER_OPTIONS = UNOPTIMISED | {"xla_backend_optimization_level": "1"}


def clear_programs() -> None:
    """Frees the programs that this process holds, as `jax.clear_caches` does for those of JAX."""
    for function in _functions:
        function.clear()


def compiling_seconds() -> float:
    """The time that this process has spent on tracing and compiling so far, s."""
    return _clock.seconds()


def persistent_jit(function: Callable[P, T]) -> "PersistentJit[P, T]":
    """Compiles a function as `equinox.filter_jit` does, and keeps the programs on disk.

    All arrays among the arguments are traced, everything else is static. If the function itself is
    traced (under `jax.vmap`, `jax.jit`, `jax.jvp`), it becomes part of that trace, as with any
    `jit`. A program whose static arguments have no meaning in another process, such as a closure,
    is kept only until the process ends.
    """
    return PersistentJit(function, COMPILER_OPTIONS)


def persistent_jit_unoptimised(function: Callable[P, T]) -> "PersistentJit[P, T]":
    """`persistent_jit` for a function whose work is done by LAPACK, or that has very little work.
    It compiles in a third of the time, and the code outside of LAPACK is slower."""
    return PersistentJit(function, UNOPTIMISED)


@final
@dataclass(frozen=True)
class _ArrayAt:
    """The placeholder in a PyTree for the array with this number."""

    number: int


@final
@dataclass(frozen=True)
class _Program:
    """Compiled code from arrays to arrays, and the PyTree that it fills. It takes those arrays that
    it uses, `used`: each one that is handed over costs half a microsecond, and of the hundreds of
    an observer a step uses some dozens."""

    compiled: jax.stages.Compiled
    used: tuple[int, ...]
    output: PyTree

    def __call__(self, arrays: Sequence[Any]) -> Any:
        results = self.compiled(*[arrays[place] for place in self.used])
        leaves, structure = self._flat
        return structure.unflatten(
            results[leaf.number] if isinstance(leaf, _ArrayAt) else leaf for leaf in leaves
        )

    @functools.cached_property
    def _flat(self) -> tuple[list[Any], Any]:
        return jax.tree.flatten(self.output)


@final
class _Stopwatch:
    """A clock that runs while at least one thread is inside its block."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._began = 0.0
        self._total = 0.0

    def __enter__(self) -> None:
        with self._lock:
            if not self._inside:
                self._began = time.perf_counter()
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                self._total += time.perf_counter() - self._began

    def seconds(self) -> float:
        with self._lock:
            return self._total + (time.perf_counter() - self._began if self._inside else 0.0)


_clock = _Stopwatch()

_functions: "list[PersistentJit[..., Any]]" = []


@final
class _Traced:
    """The placeholder among the static arguments for an array."""


@final
class PersistentJit(Generic[P, T]):
    """A function that `persistent_jit` compiles."""

    def __init__(self, function: Callable[P, T], options: dict[str, str | bool]) -> None:
        functools.update_wrapper(self, function)
        self._function = function
        self._options = options
        self._inlined = eqx.filter_jit(function)
        self._programs: dict[Hashable, _Program] = {}
        self._locks: dict[Hashable, threading.Lock] = {}
        self._adding = threading.Lock()
        _functions.append(self)

    def clear(self) -> None:
        with self._adding:
            self._programs.clear()

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> T:
        leaves, structure = jax.tree.flatten((args, kwargs))
        if any(isinstance(leaf, Tracer) for leaf in leaves):
            return self._inlined(*args, **kwargs)
        program, arrays = self._program_for(leaves, structure)
        return program(arrays)

    def bind(self, first: Any) -> "BoundJit[T]":
        """The function with a first argument that stays the same from call to call."""
        return BoundJit(self._program_for, first)

    def prepare(self, *args: P.args, **kwargs: P.kwargs) -> None:
        """Compiles or loads the program for such arguments, and does not run it. Another thread can
        do other work in the meantime."""
        self._program_for(*jax.tree.flatten((args, kwargs)))

    def _program_for(self, leaves: list[Any], structure: Any) -> tuple[_Program, list[Any]]:
        """The program for some arguments, and their arrays."""
        static, arrays, key = _taken_apart(leaves, structure)
        program = self._programs.get(key)
        if program is None:
            # Threads wait for a program that another one compiles; different programs are compiled
            # at the same time.
            with self._locks.setdefault(key, threading.Lock()):
                program = self._programs.get(key)
                if program is None:
                    program = self._load_or_compile(structure, static, arrays)
                    self._remember(key, program)
        return program, arrays

    def _remember(self, key: Hashable, program: _Program) -> None:
        with self._adding:
            self._programs[key] = program
            self._locks.pop(key, None)
            if len(self._programs) > MAX_PROGRAMS:
                self._programs.pop(next(iter(self._programs)))

    def _load_or_compile(
        self, structure: object, static: tuple[Any, ...], arrays: list[Any]
    ) -> _Program:
        device, folder = _only_device(arrays), cache_folder()
        if device is None or folder is None or _jax_keeps_programs():
            return self._compile(structure, static, arrays)
        name = self._name(structure, static, arrays, device)
        if name is None:
            return self._compile(structure, static, arrays)
        if (kept := load(folder, name)) is not None:
            with contextlib.suppress(Exception):  # a damaged program is compiled again
                return _restored(kept, device)
        program = self._compile(structure, static, arrays)
        with contextlib.suppress(Exception):  # callbacks, for example, cannot be kept
            save(folder, name, _stored(program))
        return program

    def _name(
        self, structure: Any, static: tuple[Any, ...], arrays: list[Any], device: Any
    ) -> str | None:
        """The name under which a program is kept; None if its arguments have no fingerprint."""
        skeleton = jax.tree.unflatten(structure, static)
        signatures = [str(_signature(array)) for array in arrays]
        options = tuple(self._compiler_options().items())
        meaning = (self._function, options, skeleton, signatures, str(_settings()), str(device))
        try:
            return fingerprint((surroundings(device.client), meaning))
        except NoFingerprintError:
            return None

    def _compiler_options(self) -> dict[str, str | bool]:
        fewest = jax.config.read("jax_disable_most_optimizations")
        return UNOPTIMISED if fewest else self._options

    def _compile(self, structure: object, static: tuple[Any, ...], arrays: list[Any]) -> _Program:
        output: PyTree = None

        def on_arrays(*arrays: Array) -> list[Array]:
            nonlocal output
            given = iter(arrays)
            leaves = [next(given) if leaf is _Traced else leaf for leaf in static]
            args, kwargs = jax.tree.unflatten(structure, leaves)
            dynamic, rest = eqx.partition(self._function(*args, **kwargs), eqx.is_array)  # pyright: ignore[reportCallIssue]
            results, places = jax.tree.flatten(dynamic)
            numbered = jax.tree.unflatten(places, map(_ArrayAt, range(len(results))))
            output = eqx.combine(numbered, rest)
            return results

        with _clock:
            traced = jax.jit(on_arrays).trace(*arrays).jaxpr
            used = _used(traced)

            def on_used(*few: Any) -> Any:
                every: list[Any] = [None] * len(arrays)
                for place, array in zip(used, few, strict=True):
                    every[place] = array
                return jaxpr_as_fun(traced)(*every)

            on_used.__name__ = self._function.__name__
            lowered = jax.jit(on_used).lower(*[arrays[place] for place in used])
            compiled = _compiled(lowered, self._compiler_options())
        return _Program(compiled, used, output)


def _used(traced: ClosedJaxpr) -> tuple[int, ...]:
    """The places of the arguments that a traced function uses."""
    jaxpr = traced.jaxpr
    used = {id(invar) for equation in jaxpr.eqns for invar in equation.invars}
    used.update(id(outvar) for outvar in jaxpr.outvars)
    return tuple(place for place, argument in enumerate(jaxpr.invars) if id(argument) in used)


def _compiled(lowered: jax.stages.Lowered, options: dict[str, str | bool]) -> jax.stages.Compiled:
    """Compiles with those of the options that this version of XLA has."""
    try:
        return lowered.compile(options)
    except jax.errors.JaxRuntimeError as error:  # it names an option that it does not know
        known = {name: value for name, value in options.items() if name not in str(error)}
        return _compiled(lowered, known) if len(known) < len(options) else lowered.compile()


@final
class BoundJit(Generic[T]):
    """A compiled function whose first argument stays the same.

    A loop that runs for hours calls the same function with the same observer or controller, which
    has more than a hundred arrays. They are flattened and brought to the device once, so that a
    call costs what its other arguments cost.
    """

    def __init__(
        self, program_for: Callable[[list[Any], Any], tuple[_Program, list[Any]]], first: Any
    ) -> None:
        self._program_for = program_for
        self._first = first
        self._programs: dict[Hashable, tuple[_Program, list[Any]]] = {}

    def __call__(self, *args: Any) -> T:
        """Calls the function; not inside a trace, which the function itself is for."""
        leaves, structure = jax.tree.flatten(args)
        _, arrays, key = _taken_apart(leaves, structure)
        if key not in self._programs:
            every = jax.tree.flatten(((self._first, *args), {}))
            program, all_arrays = self._program_for(*every)
            same = all_arrays[: len(all_arrays) - len(arrays)]
            # By the settings of this call, which are part of the key.
            self._programs[key] = program, [jax.device_put(array) for array in same]
        program, same = self._programs[key]
        return program([*same, *arrays])


def _taken_apart(leaves: list[Any], structure: Any) -> tuple[tuple[Any, ...], list[Any], Hashable]:
    """The static leaves, the arrays, and what tells the program for them from others."""
    is_array = [eqx.is_array(leaf) for leaf in leaves]
    pairs = list(zip(leaves, is_array, strict=True))
    static = tuple(_Traced if is_one else leaf for leaf, is_one in pairs)
    arrays = [leaf for leaf, is_one in pairs if is_one]
    # 1, 1.0 and True are equal, and compile to different programs.
    kinds = tuple(map(type, static))
    return static, arrays, (structure, static, kinds, tuple(map(_signature, arrays)), _settings())


def _signature(array: Any) -> Hashable:
    """The properties of an array on which a program depends."""
    committed = getattr(array, "committed", False)  # which arrays of NumPy do not have
    return (
        array.shape,
        array.dtype,
        getattr(array, "weak_type", False),
        array.sharding if committed else None,
    )


def _settings() -> Hashable:
    """The settings of JAX that a caller of this package decides; see `own_settings`."""
    return (jax.config.read("jax_enable_x64"), _default_device())


def _default_device() -> Any:
    """The value of `jax.default_device`: a device, the name of a platform, or None."""
    return jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]


def _jax_keeps_programs() -> bool:
    """Whether the user has enabled JAX's own persistent cache. Only that cache is then used.

    A program from that cache cannot be serialized again: the copy loads, but fails when it runs
    (seen with jax 0.10.2, "NOT_FOUND: Function ... not found").
    """
    return bool(jax.config.jax_compilation_cache_dir)  # pyright: ignore[reportAttributeAccessIssue]


def _only_device(arrays: list[Any]) -> Any:
    """The device on which a program runs, None if it runs on several."""
    committed = {
        device
        for array in arrays
        if isinstance(array, jax.Array) and array.committed
        for device in array.devices()
    }
    match list(committed):
        case []:
            chosen = _default_device()
            is_platform = chosen is None or isinstance(chosen, str)
            return jax.local_devices(backend=chosen)[0] if is_platform else chosen
        case [device]:
            return device
        case _:
            return None


def _stored(program: _Program) -> bytes:
    code, _, results = serialize_executable.serialize(program.compiled)
    return pickle.dumps((code, program.used, results.num_leaves, program.output))


def _restored(kept: bytes, device: Any) -> _Program:
    _find_lapack()
    code, used, results, output = pickle.loads(kept)
    compiled = serialize_executable.deserialize_and_load(
        code,
        jax.tree.structure(((0,) * len(used), {})),
        jax.tree.structure([0] * results),
        backend=device.client,
        execution_devices=[device],
    )
    return _Program(compiled, used, output)


@functools.cache
def _find_lapack() -> None:
    """Makes JAX look up LAPACK's functions, which it otherwise does when it lowers a call of one of
    them.

    Without this, a program that was lowered in another process would call a null pointer.
    """
    matrix = jax.ShapeDtypeStruct((1, 1), "float32")
    jax.jit(jax.lax.linalg.cholesky).lower(matrix)
