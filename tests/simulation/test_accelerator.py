"""What an accelerator is given, seen from a machine without one: programs lowered for CUDA."""

import re
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import Experiment, Twin
from jaxtwin._jax_settings import own_settings
from jaxtwin._lapack import _solve, eigh, solve_definite
from jaxtwin.simulation._chunk_programs import prepare_chunk, step_chunk
from jaxtwin.simulation._draw_solver import _delayed_as
from jaxtwin.simulation._scalar_chunk import (
    MIN_DRAWS,
    prepare_scalar_chunk,
    scalar_grid,
    step_scalar_chunk,
)
from jaxtwin.simulation._time_grid import padded_time_grid

DRAWS = 64
MATRICES = np.random.default_rng(0).normal(size=(DRAWS, 44, 44))
DEFINITE = MATRICES @ MATRICES.swapaxes(1, 2) + 44 * np.eye(44)


def lowered(function: Callable[..., Any], *arguments: Any) -> str:
    """The program for CUDA as text."""
    with own_settings():
        return jax.export.export(jax.jit(function), platforms=["cuda"])(*arguments).mlir_module()


@pytest.fixture(scope="module", params=["paper-2024", "dual-cell"])
def chunk(request: pytest.FixtureRequest) -> tuple[Any, Any, Any, Any]:
    """A twin, its grid, draws, and their equations."""
    twin = Twin(request.param)
    experiment = Experiment.schedule("0:0.5,50:0.8", duration=100.0, cells=2)
    grid = padded_time_grid(twin, experiment)
    draws = {"R_E": np.linspace(1.5, 2.5, DRAWS)}
    with own_settings():
        prepared = jax.eval_shape(
            lambda draws: prepare_chunk(twin, draws, grid.summary(), None), draws
        )
    return twin, grid, draws, prepared


def test_eigenproblems_of_a_batch_are_one_call_by_jacobi():
    """By JAX's own choice those above 32 rows would be solved one after the other."""
    program = lowered(jax.vmap(eigh), DEFINITE)
    (call,) = re.findall(r"custom_call @cusolver_syevd_ffi.*", program)
    assert "algorithm = 2 : ui8" in call
    assert f"tensor<{DRAWS}x44x44xf64>" in call
    assert "stablehlo.while" not in program
    assert "@lapack" not in program


def test_a_chunk_has_its_linear_algebra_at_once_and_on_the_accelerator(chunk):
    twin, grid, draws, _ = chunk
    program = lowered(lambda draws: prepare_chunk(twin, draws, grid.summary(), None), draws)
    assert program.count("@cusolver_syevd_ffi") == 1
    assert "@lapack" not in program
    assert "callback" not in program


def test_all_steps_of_all_draws_are_one_loop_of_one_program(chunk):
    """Nothing goes to the host and back in between."""
    twin, grid, _, prepared = chunk
    columns = np.arange(len(twin.channels))
    program = lowered(lambda prepared: step_chunk(prepared, grid, columns, False, False), prepared)
    # Beside it a lagging driver has a small loop of its own for what reaches the cells.
    loops = re.findall(r"= stablehlo.while\(.*", program)
    amplitudes = f"tensor<{DRAWS}x{prepared.modes.rates.shape[-1]}xf64>"
    assert sum(amplitudes in loop for loop in loops) == 1
    assert "custom_call" not in program


@pytest.mark.slow
def test_many_draws_have_no_eigenproblem_and_one_loop_of_elementwise_steps(chunk):
    """Every number of a draw is an array over the draws, and no step calls a library: a compiler
    can fuse all of it."""
    twin, _, draws, _ = chunk
    experiment = Experiment.schedule("0:0.5,50:0.8", duration=100.0, cells=2)
    grid = scalar_grid(twin, experiment, MIN_DRAWS, steady_start=False)
    assert grid is not None
    program = lowered(lambda d: prepare_scalar_chunk(twin, d, grid.summary(), None), draws)
    assert "custom_call" not in program
    with own_settings():
        prepared = jax.eval_shape(
            lambda draws: prepare_scalar_chunk(twin, draws, grid.summary(), None), draws
        )
    columns, delayed = np.arange(len(twin.channels)), _delayed_as(twin, grid)
    program = lowered(lambda p: step_scalar_chunk(p, delayed, columns, False, False), prepared)
    (loop,) = re.findall(r"= stablehlo.while\(.*", program)
    nodes = prepared.system.capacitance.shape[-1]
    assert loop.count(f"tensor<{DRAWS}xf64>") >= 2 * nodes
    assert "custom_call" not in program
    body = program.split("stablehlo.while", 1)[1]
    assert "dot_general" not in body.split("stablehlo.return", 2)[1]


@pytest.mark.parametrize("call", [eigh, _solve, solve_definite])
def test_batched_and_one_by_one_are_the_same(call):
    """The function that the batch is mapped over on an accelerator, here on the CPU."""
    right = np.random.default_rng(1).normal(size=(DRAWS, 44, 3))
    given = (DEFINITE,) if call is eigh else (DEFINITE, right)
    with own_settings():
        at_once = jax.jit(jax.vmap(call.fun))(*given)
        one_by_one = jax.jit(jax.vmap(call))(*given)
    for batched, single in zip(jax.tree.leaves(at_once), jax.tree.leaves(one_by_one), strict=True):
        np.testing.assert_allclose(jnp.abs(batched), jnp.abs(single), rtol=0, atol=1e-9)


def test_sums_of_float32_are_float32():
    """Not TF32, which an accelerator takes by itself: 0.07 K on one NVIDIA H200."""
    with own_settings(float64=False):
        jaxpr = jax.make_jaxpr(jnp.matmul)(np.eye(2, dtype=np.float32), np.eye(2, dtype=np.float32))
    (product,) = (e for e in jaxpr.eqns if e.primitive.name == "dot_general")
    assert set(product.params["precision"]) == {jax.lax.Precision.HIGHEST}
