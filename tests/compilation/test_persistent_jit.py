"""A program is traced once per machine and computes what its function says."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache.compilation_cache import reset_cache

from jaxtwin._compilation import (
    _fingerprint,
    _persistent_jit,
    clear_programs,
    compiling_seconds,
    persistent_jit,
    persistent_jit_unoptimised,
)
from jaxtwin.physics import Twin
from jaxtwin.simulation import Stepper, StepperState

traced: list[str] = []
"""Which functions were traced; a program that is loaded leaves nothing here."""


class Line(eqx.Module):
    slope: Any
    name: str = eqx.field(static=True)


def scaled(line: Line, x: Any, power: int = 1) -> tuple[Line, dict[str, Any]]:
    traced.append(line.name)
    return Line(2 * line.slope, line.name), {"y": line.slope * x**power, "power": power}


def applied(function: Any, x: Any) -> Any:
    traced.append("applied")
    return function(x)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("JAXTWIN_COMPILATION_CACHE", str(tmp_path))
    of_jax = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    use_cache_of_jax(None)
    known = (*_fingerprint.KNOWN_CODE, __name__.partition(".")[0])
    monkeypatch.setattr(_fingerprint, "KNOWN_CODE", known)
    traced.clear()
    yield tmp_path
    use_cache_of_jax(of_jax)


def use_cache_of_jax(folder: str | None) -> None:
    """A cache that JAX has opened stays in use, whatever its folder is, until it is reset."""
    jax.config.update("jax_compilation_cache_dir", folder)
    reset_cache()


def another_process() -> Any:
    """A `persistent_jit` that has nothing in memory."""
    return persistent_jit(scaled)


def test_it_gives_what_the_function_gives():
    line, found = another_process()(Line(jnp.array(3.0), "a"), np.array([1.0, 2.0]), power=2)
    assert isinstance(line, Line)
    assert (line.name, found["power"]) == ("a", 2)
    assert float(line.slope) == 6
    np.testing.assert_array_equal(found["y"], [3.0, 12.0])


@pytest.mark.parametrize("slope", [np.float64(3.0), np.array(3.0), 3.0])
def test_a_bound_argument_is_as_if_it_were_given(slope: Any):
    function = another_process()
    bound = function.bind(Line(slope, "bound"))
    for x in (np.array([1.0, 2.0]), np.array([5.0, 0.0])):
        for precise in (False, True):
            with jax.enable_x64(precise):
                line, found = bound(x)
                given, expected = function(Line(slope, "bound"), x)
            assert (line.name, found["power"]) == ("bound", 1)
            np.testing.assert_array_equal(found["y"], expected["y"])
            assert found["y"].dtype == expected["y"].dtype
            assert np.asarray(line.slope).dtype == np.asarray(given.slope).dtype
    assert traced == ["bound", "bound"]  # once for each precision


@pytest.fixture
def optimised() -> Iterator[None]:
    """Quick runs of the tests compile everything without most optimisations."""
    setting = "jax_disable_most_optimizations"
    before = jax.config.read(setting)
    jax.config.update(setting, False)
    yield
    jax.config.update(setting, before)


@pytest.mark.usefixtures("optimised")
def test_a_function_compiled_without_optimisations_is_a_program_of_its_own_and_kept():
    for compiled in 2 * (persistent_jit, persistent_jit_unoptimised):
        _, found = compiled(scaled)(Line(jnp.array(3.0), "a"), np.array([1.0, 2.0]))
        np.testing.assert_array_equal(found["y"], [3.0, 6.0])
    assert traced == ["a", "a"]


def test_an_option_that_the_compiler_does_not_know_costs_no_other(
    monkeypatch: pytest.MonkeyPatch,
):
    """A later version of XLA may lack one that is asked for here."""
    tried, compiled_by_jax = [], jax.stages.Lowered.compile

    def noted(lowered: jax.stages.Lowered, options: dict[str, Any]) -> jax.stages.Compiled:
        tried.append(options)
        return compiled_by_jax(lowered, options)

    monkeypatch.setattr(jax.stages.Lowered, "compile", noted)
    known = {"xla_backend_optimization_level": "0"}
    asked = {"xla_cpu_no_such_option": False, **known}
    compiled = _persistent_jit._compiled(jax.jit(jnp.sin).lower(1.0), asked)
    assert float(compiled(1.0)) == pytest.approx(np.sin(1.0))
    assert tried == [asked, known]


def test_another_process_loads_instead_of_tracing():
    x = jnp.arange(3.0)
    first = another_process()(Line(jnp.array(3.0), "a"), x)
    assert traced == ["a"]
    second = another_process()(Line(jnp.array(4.0), "a"), x)
    assert traced == ["a"]
    np.testing.assert_array_equal(first[1]["y"], 3 * x)
    np.testing.assert_array_equal(second[1]["y"], 4 * x)


def stepper(twin: Twin) -> tuple[Stepper, StepperState]:
    traced.append("stepper")
    made = Stepper(twin, 1.0)
    return made, made.start()


def test_a_kept_program_gives_steppers_which_pickle_their_arrays_in_their_own_way():
    first, second = (persistent_jit(stepper)(Twin("paper-2024")) for _ in range(2))
    assert traced == ["stepper"]
    assert jax.tree.structure(first) == jax.tree.structure(second)
    jax.tree.map(np.testing.assert_array_equal, first, second)


def test_new_values_share_a_program_and_anything_else_has_its_own():
    call = another_process()
    x = jnp.arange(3.0)
    call(Line(jnp.array(3.0), "a"), x)
    call(Line(jnp.array(5.0), "a"), x + 1)
    assert len(traced) == 1
    call(Line(jnp.array(3.0), "b"), x)
    call(Line(jnp.array(3.0), "a"), jnp.arange(4.0))
    call(Line(jnp.array(3.0), "a"), x, power=2)
    call(Line(jnp.array(3.0), "a"), x, power=2.0)
    call(Line(jnp.array(3), "a"), x)
    with jax.enable_x64(True):
        call(Line(jnp.array(3.0), "a"), x)
    assert len(traced) == 7


def test_a_compiled_function_can_be_vmapped_and_differentiated():
    call = another_process()
    x = jnp.arange(3.0)
    slopes = jax.vmap(lambda slope: call(Line(slope, "a"), x)[1]["y"])(jnp.array([1.0, 2.0]))
    np.testing.assert_array_equal(slopes, [x, 2 * x])
    gradient = jax.grad(lambda slope: call(Line(slope, "a"), x)[1]["y"].sum())(1.0)
    assert gradient == x.sum()


def test_a_closure_is_compiled_and_not_kept(folder):
    offset = 2.0
    call = persistent_jit(applied)
    assert call(lambda x: x + offset, jnp.array(1.0)) == 3
    assert not any(folder.iterdir())
    assert call(abs, jnp.array(-1.0)) == 1
    assert len(list(folder.iterdir())) == 1


def test_a_damaged_program_is_made_anew(folder):
    x = jnp.arange(3.0)
    another_process()(Line(jnp.array(3.0), "a"), x)
    (file,) = folder.iterdir()
    file.write_bytes(file.read_bytes()[:-100])
    assert another_process()(Line(jnp.array(3.0), "a"), x)[1]["power"] == 1
    assert traced == ["a", "a"]


def test_threads_that_want_the_same_program_make_it_once():
    call = another_process()
    with ThreadPoolExecutor(8) as pool:
        lines = [Line(jnp.array(float(n)), "a") for n in range(8)]
        results = list(pool.map(lambda line: call(line, jnp.ones(2)), lines))
    assert traced == ["a"]
    assert [float(found["y"][0]) for _, found in results] == list(range(8))


def test_a_program_that_was_prepared_is_not_compiled_again():
    call = another_process()
    call.prepare(Line(jnp.array(3.0), "a"), jnp.ones(2))
    assert traced == ["a"]
    _, found = call(Line(jnp.array(5.0), "a"), 2 * jnp.ones(2))
    assert traced == ["a"]
    np.testing.assert_array_equal(found["y"], [10.0, 10.0])


def test_few_programs_stay_in_memory(monkeypatch):
    """Linux ends a process that maps memory too often, which each program does."""
    monkeypatch.setattr(_persistent_jit, "MAX_PROGRAMS", 2)
    call = another_process()
    for size in (1, 2, 3, 1):
        call(Line(jnp.array(3.0), "a"), jnp.ones(size))
    assert len(traced) == 3  # the first came back from the disk
    assert len(call._programs) == 2


def test_no_program_is_kept_where_jax_has_a_compilation_cache_of_its_own(folder, tmp_path_factory):
    """What comes out of JAX's cache cannot be serialized again."""
    jax.config.update("jax_compilation_cache_dir", str(tmp_path_factory.mktemp("jax")))
    another_process()(Line(jnp.array(3.0), "a"), jnp.ones(1))
    assert not any(folder.iterdir())


def test_programs_can_be_freed():
    call = another_process()
    call(Line(jnp.array(3.0), "a"), jnp.ones(1))
    clear_programs()
    assert len(call._programs) == 0


@pytest.mark.slow
def test_a_loaded_program_finds_lapack(tmp_path):
    """In a process that has lowered no call of it, nobody else has looked up its functions."""
    (tmp_path / "eigenvalues.py").write_text(
        "import jax.numpy as jnp\n"
        "from jaxtwin._compilation import _fingerprint, persistent_jit\n"
        "_fingerprint.KNOWN_CODE += ('eigenvalues',)\n"
        "@persistent_jit\n"
        "def largest(matrix):\n"
        "    print('traced')\n"
        "    return jnp.linalg.eigh(matrix)[0][-1]\n"
    )
    code = "import numpy, eigenvalues; print(eigenvalues.largest(numpy.diag([1., 3., 2.])))"
    command = [sys.executable, "-c", code]
    environment = os.environ | {"JAXTWIN_COMPILATION_CACHE": str(tmp_path / "compiled")}
    printed = [
        subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        ).stdout.split()
        for _ in range(2)
    ]
    assert printed == [["traced", "3.0"], ["3.0"]]


def test_the_clock_of_compilation_runs_while_something_is_compiled():
    before = compiling_seconds()
    with _persistent_jit._clock:
        time.sleep(0.01)
        assert compiling_seconds() >= before + 0.01
    assert compiling_seconds() >= before + 0.01
