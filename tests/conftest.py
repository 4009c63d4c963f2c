"""What all tests share: shape checks, reproducible examples, compiled programs, float64."""

import gc
import importlib.util
import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import hypothesis
import jax
import pytest
from checked_types import check_package

# Before the first import of jaxtwin: every annotated shape and type in the package is checked.
check_package("jaxtwin")

# Tests count what is compiled; programs that an earlier process compiled would not be.
os.environ["JAXTWIN_COMPILATION_CACHE"] = "off"

os.environ["PATH"] += os.pathsep + "/usr/sbin"  # where Debian puts mosquitto

# Figures are drawn in memory, whatever the machine has for a screen.
os.environ["MPLBACKEND"] = "Agg"

hypothesis.settings.register_profile("jaxtwin", derandomize=True, deadline=None)
hypothesis.settings.load_profile("jaxtwin")


# Programs that earlier test runs compiled, a folder for each worker; `make clean` removes it.
COMPILED = Path(__file__).parent.parent / ".jax_cache"

# The name of this process among those that run tests.
WORKER = os.environ.get("PYTEST_XDIST_WORKER", "alone")

# A compiled program is written completely after this time, s.
WRITING = 5.0

# The time of compilation from which a program is kept, s. To write and read a smaller one takes as
# long as to compile it.
WORTH_KEEPING = 0.3

# Bytes of compiled programs beyond which those of earlier runs are thrown away.
LARGEST_CACHE = 4e9

# A program that is older was not compiled by a run that still goes on, s.
LONGEST_RUN = 3600.0

# JAX's setting that leaves out most of XLA's optimisations. Runs without the slow tests set it,
# unless the environment already says 0 or 1.
QUICK_COMPILATION = "JAX_DISABLE_MOST_OPTIMIZATIONS"

# XLA's flags beside that setting. A program is not divided among threads that compile it, which
# costs a sixth more in all: each processor has a worker here.
QUICK_FLAGS = ["--xla_cpu_parallel_codegen_split_count=1"]

if jax.__version_info__ < (0, 11):  # jaxlib 0.12 ends a process that is given it
    # XLA itself writes small loops of a program for LLVM, as it does for the programs of the
    # library, without MLIR, whose compiler is made anew for each: up to half of the time of tests
    # with many small programs, nothing with large ones. If a test fails with it and passes with
    # JAX_DISABLE_MOST_OPTIMIZATIONS=0, suspect it: jaxlib 0.10.2 compiled one program wrongly that
    # way, without fusion (tests/simulation/test_scalar_chunk.py).
    QUICK_FLAGS.append("--xla_cpu_use_fusion_emitters=false")

# New objects after which Python looks for cycles among them, in place of 700. Programs are traced
# in so many objects that a tenth of the time would go into that.
YOUNG_OBJECTS = 50_000

# Every compiled program maps memory, and Linux ends a process that has 65 530 maps.
MOST_MEMORY_MAPS = 20_000


def pytest_configure(config: pytest.Config) -> None:
    """Lets JAX keep compiled programs between runs."""
    folder = COMPILED / WORKER
    if WORKER == "alone" and sum(f.stat().st_size for f in COMPILED.glob("*/*")) > LARGEST_CACHE:
        for file in COMPILED.glob("*/*"):
            if file.stat().st_mtime < time.time() - LONGEST_RUN:
                file.unlink()
    folder.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    # By default the name of an entry depends on the folder, and no worker finds another's.
    jax.config.update("jax_persistent_cache_enable_xla_caches", "none")
    jax.config.update("jax_persistent_cache_min_compile_time_secs", WORTH_KEEPING)
    if "not slow" in config.option.markexpr and QUICK_COMPILATION not in os.environ:
        # Most of the time of the quick tests is compilation. Processes that they start do the same.
        os.environ[QUICK_COMPILATION] = "1"
        jax.config.update("jax_disable_most_optimizations", True)
    if jax.config.read("jax_disable_most_optimizations"):
        flags = os.environ.get("XLA_FLAGS", "").split()
        # A worker has those of the process that started it.
        flags += [flag for flag in QUICK_FLAGS if flag not in flags]
        os.environ["XLA_FLAGS"] = " ".join(flags)
    gc.set_threshold(YOUNG_OBJECTS, 20, 100)


@pytest.fixture(scope="module", autouse=True)
def _programs_of_all_workers() -> None:
    """Links what other workers have compiled until now.

    Each worker has a folder of its own, because JAX's cache is not safe where processes share one:
    an entry can be read while it is being written. One that is some seconds old is complete.
    """
    folder, now = COMPILED / WORKER, time.time()
    own = {file.name for file in folder.iterdir()}
    for file in COMPILED.glob("*/*"):
        if file.name not in own and file.stat().st_mtime < now - WRITING:
            own.add(file.name)
            os.link(file, folder / file.name)


@pytest.fixture(scope="module", autouse=True)
def _few_memory_maps() -> Iterator[None]:
    """Frees the compiled programs after a module of tests that leaves too many."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > MOST_MEMORY_MAPS:
        # Not at the top of the file: the checks of shapes and types reach only what is imported
        # after their hook.
        from jaxtwin._compilation import clear_programs

        clear_programs()
        jax.clear_caches()
        gc.collect()


@pytest.fixture
def float64() -> Iterator[None]:
    """64-bit JAX for a test that computes with jax.numpy itself.

    jaxtwin's own solves switch to float64 by themselves; the setting is left alone everywhere else
    so that the tests see what a user sees.
    """
    with jax.enable_x64(True):
        yield


# Marker -> the program that its tests need.
PROGRAMS = {
    "ngspice": "ngspice",
    "mosquitto": "mosquitto",
    "ffmpeg": "ffmpeg",
    "compiler": "c++",
    "c_compiler": "cc",
}

# Marker -> the Python module that its tests need.
MODULES = {
    "salib": "SALib",
    "python_control": "control",
    "slycot": "slycot",
    "fmpy": "fmpy",
    "daqp": "daqp",
}


def found() -> dict[str, str | None]:
    """Marker -> where its program or module is, None where it is not installed."""
    places = {marker: shutil.which(program) for marker, program in PROGRAMS.items()}
    for marker, module in MODULES.items():
        spec = importlib.util.find_spec(module)
        places[marker] = spec and spec.origin
    return places


# Its tests share nothing, and one takes as long as a whole folder of others.
PAGES = "test_snippets.py"


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Gives each process a file at a time, whose fixtures are then made once, or one page."""
    from xdist.scheduler import LoadFileScheduling

    class FilesAndPages(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return nodeid if PAGES in nodeid else super()._split_scope(nodeid)

    return FilesAndPages(config, log)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leaves out what needs a program or module that is not installed; it counts as deselected.
    The pages come first, so that no process works on one when the others have finished."""
    items.sort(key=lambda item: item.path.name != PAGES)
    for marker, place in found().items():
        if place:
            continue
        left_out = [item for item in items if item.get_closest_marker(marker)]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in left_out]


def pytest_report_header() -> list[str]:
    """Says at the top which programs and modules are there."""
    return [
        f"{(PROGRAMS | MODULES)[marker]}: {place or 'not installed, its tests do not run'}"
        for marker, place in found().items()
    ]


@pytest.fixture
def compilations() -> Iterator[Callable[[], int]]:
    """How many programs were compiled since it was asked last, by JAX's own events."""
    durations: list[float] = []

    def listen(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            durations.append(duration_secs)

    def count() -> int:
        number = len(durations)
        durations.clear()
        return number

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield count
    jax.monitoring.unregister_event_duration_listener(listen)
