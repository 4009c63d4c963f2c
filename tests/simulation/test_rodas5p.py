"""Rodas5P as a diffrax solver, on equations with a known solution and on the rigs."""

from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

from jaxtwin import Experiment, Twin
from jaxtwin._sparse import SparseLU, column_groups, sparse_jacobian
from jaxtwin.simulation import Rodas5P
from jaxtwin.simulation._rosenbrock_step import GAMMA, NODES, SLOPE_TABLE, STATE_TABLE, TIME
from jaxtwin.simulation._scalar_network import network_pattern
from jaxtwin.simulation._simulate_batch import simulate_batch

PATTERN = np.array([[1, 1, 0], [1, 1, 1], [0, 1, 1]], bool)
SOLVERS = (Rodas5P(), Rodas5P(sparsity=PATTERN))


def known(t: Array) -> Array:
    """The solution of `field`."""
    return jnp.stack([jnp.sin(t), jnp.cos(2 * t), jnp.exp(-t)])


def field(t: Any, y: Any, rate: Any) -> Array:
    """Stiff for a large rate, nonlinear, and not autonomous (after Prothero and Robinson 1974)."""
    matrix = jnp.array([[0.0, 1.0, 0.0], [1.0, -2.0, 0.5], [0.0, 0.5, -1.0]]).at[0, 0].set(-rate)
    slope = jax.jvp(known, (t,), (jnp.ones_like(t),))[1]
    error = y - known(t)
    return matrix @ error + slope + jnp.array([1.0, 0.0, 1.0]) * error**2


def solved(
    solver: Rodas5P, steps: int, rate: Array | float, start: Array | None = None
) -> diffrax.Solution:
    """By equal steps from 0 to 2."""
    return diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        solver,
        t0=0.0,
        t1=2.0,
        dt0=None,
        y0=known(jnp.array(0.0)) if start is None else start,
        args=rate,
        stepsize_controller=diffrax.StepTo(ts=jnp.linspace(0.0, 2.0, steps + 1)),
        saveat=diffrax.SaveAt(t1=True, dense=True),
        adjoint=diffrax.DirectAdjoint(),
        max_steps=64,
    )


def at_end(solution: diffrax.Solution) -> Array:
    """The last state."""
    assert solution.ys is not None
    return jax.tree.map(lambda rows: rows[-1], solution.ys)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "rate"), [(SOLVERS[0], 1e6), (SOLVERS[1], 1e6), (SOLVERS[1], 5.0)]
)
def test_order_is_five_on_stiff_equations_whose_solution_is_known(solver, rate, float64):
    """Twice the steps, a 32nd of the error; without the term of the time derivative the order is
    one."""
    errors = [
        float(jnp.abs(at_end(solved(solver, steps, rate)) - known(jnp.array(2.0))).max())
        for steps in (8, 16)
    ]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(orders > 4.8)
    assert errors[0] < 1e-5


@pytest.mark.slow
def test_continuous_output_is_of_fourth_order(float64):
    times = jnp.linspace(0.0, 2.0, 101)
    expected = jax.vmap(known)(times)
    errors = [
        float(jnp.abs(jax.vmap(solved(SOLVERS[1], n, 5.0).evaluate)(times) - expected).max())
        for n in (8, 16)
    ]
    assert np.log2(errors[0] / errors[1]) > 3.8
    solution = solved(SOLVERS[1], 8, 5.0)
    change = solution.evaluate(0.3, 1.1)
    np.testing.assert_allclose(
        change, solution.evaluate(1.1) - solution.evaluate(0.3), rtol=0, atol=1e-14
    )


@pytest.mark.slow
def test_error_estimate_is_of_fifth_order(float64):
    """That of the embedded solution of order four, as a step size controller assumes."""
    start, term = known(jnp.array(0.0)) + 0.1, diffrax.ODETerm(field)
    estimates = [
        jnp.abs(SOLVERS[1].step(term, 0.0, h, start, 5.0, None, False)[1]).max()
        for h in (0.02, 0.01)
    ]
    assert SOLVERS[1].order(term) == SOLVERS[1].error_order(term) == 5
    assert np.log2(estimates[0] / estimates[1]) > 4.7


def test_coefficients_satisfy_the_conditions_of_a_rosenbrock_method():
    r"""The tables are those for sums in the transformed form. With $\Gamma^{-1} = I / \gamma - C$,
    the row sums of $A \Gamma$ are the nodes and those of $\Gamma$ the factors of the time
    derivative (Hairer and Wanner, sec. IV.7)."""
    gamma = np.linalg.inv(np.eye(8) / GAMMA - SLOPE_TABLE)
    np.testing.assert_allclose((STATE_TABLE @ gamma).sum(axis=1), NODES, rtol=0, atol=1e-11)
    np.testing.assert_allclose(gamma.sum(axis=1), TIME, rtol=0, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize(
    "solver",
    [
        pytest.param(SOLVERS[0], id="full", marks=pytest.mark.long),
        pytest.param(SOLVERS[1], id="sparse"),
    ],
)
def test_derivatives_are_those_of_the_steps(solver, float64):
    """Forward and backward, against differences of the same steps."""
    start = known(jnp.array(0.0)) + 0.1

    def last(rate: Array) -> Array:
        return at_end(solved(solver, 8, rate, start))

    rate, h = jnp.array(5.0), 1e-4
    differences = (last(rate + h) - last(rate - h)) / (2 * h)
    forward = jax.jvp(last, (rate,), (jnp.ones(()),))[1]
    np.testing.assert_allclose(forward, differences, rtol=1e-6)
    backward = jax.grad(lambda rate: last(rate)[0])(rate)
    np.testing.assert_allclose(backward, forward[0], rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS, ids=["full", "sparse"])
def test_a_batch_is_the_same_as_one_by_one(solver, float64):
    rates = jnp.array([1.0, 30.0, 1e5])
    batch = jax.jit(jax.vmap(lambda rate: at_end(solved(solver, 8, rate))))(rates)
    alone = [at_end(solved(solver, 8, rate)) for rate in rates]
    np.testing.assert_allclose(batch, jnp.stack(alone), rtol=0, atol=1e-13)


@pytest.mark.slow
def test_a_state_may_be_a_tree(float64):
    """An oscillator as two named numbers, over a period."""
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: {"x": y["v"], "v": -y["x"]}),
        Rodas5P(sparsity=np.ones((2, 2), bool)),
        t0=0.0,
        t1=2 * np.pi,
        dt0=0.1,
        y0={"x": jnp.array(1.0), "v": jnp.array(0.0)},
        stepsize_controller=diffrax.PIDController(rtol=1e-9, atol=1e-9),
    )
    end: Any = at_end(solution)
    assert abs(end["x"] - 1) < 1e-7
    assert abs(end["v"]) < 1e-7


@pytest.mark.parametrize("name", ["paper-2024", "dual-cell"])
def test_factorisation_of_a_rig_solves_its_equations_with_little_fill(name, float64):
    """The entries of both factors are at most twice those of the matrix, where full ones would be
    seven times as many."""
    pattern = network_pattern(Twin(name).wiring)
    lu, random = SparseLU(pattern), np.random.default_rng(0)
    matrix = np.where(pattern, random.normal(size=pattern.shape), 0) + 10 * np.eye(len(pattern))
    right = random.normal(size=len(pattern))
    factors = lu.factorise({(i, j): jnp.asarray(matrix[i, j]) for i, j in lu.entries})
    solution = np.array(lu.solve(factors, [jnp.asarray(row) for row in right]))
    np.testing.assert_allclose(matrix @ solution, right, rtol=0, atol=1e-13)
    assert len(factors) < 2 * pattern.sum() < pattern.size / 3
    assert lu == SparseLU(pattern.copy())
    assert hash(lu) == hash(SparseLU(pattern.copy()))


def test_sparse_jacobian_takes_few_derivatives(float64):
    """A chain of ten nodes needs three, whatever its length."""
    pattern = np.abs(np.subtract.outer(np.arange(10), np.arange(10))) <= 1
    matrix = jnp.asarray(np.where(pattern, np.random.default_rng(1).normal(size=(10, 10)), 0))
    at = jnp.linspace(0.0, 1.0, 10)
    entries = SparseLU(pattern).entries
    found = sparse_jacobian(lambda x: matrix @ jnp.sin(x), at, entries)
    expected = jax.jacfwd(lambda x: matrix @ jnp.sin(x))(at)
    np.testing.assert_allclose([found[e] for e in entries], [expected[e] for e in entries])
    assert max(column_groups(pattern)) + 1 == 3


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("paper-2024", marks=pytest.mark.slow),
        pytest.param("dual-cell", marks=pytest.mark.long),
    ],
)
def test_the_rigs_are_as_kvaerno5_solves_them(name):
    """To 1e-6 K, with a driver that lags and delays and losses that are not linear."""
    twin, time = Twin(name), np.arange(61.0)
    steps = Experiment(time, np.where(time < 20, 0.5, 0.8)[:, None] * np.ones(2))
    controller = diffrax.PIDController(rtol=1e-10, atol=1e-10)
    expected = twin.simulate(steps, solver=diffrax.Kvaerno5(), stepsize_controller=controller)
    found = twin.simulate(steps, solver=Rodas5P(), stepsize_controller=controller)
    assert np.abs(found.states[::10] - expected.states[::10]).max() < 1e-6


@pytest.mark.slow
def test_batches_are_those_of_the_default_solver():
    """In one thread, because the full matrices of two would deadlock on a CPU."""
    twin = Twin("paper-2024")
    experiment = Experiment.schedule("0:0.5,50:0.8", duration=100.0, cells=2)
    draws = {"R_E": np.linspace(1.5, 2.5, 8)}
    default = simulate_batch(twin, experiment, draws)
    assert np.abs(simulate_batch(twin, experiment, draws, solver=Rodas5P()) - default).max() < 1e-3
