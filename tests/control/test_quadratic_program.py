"""Quadratic programs against scipy's solvers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import lsq_linear, minimize

from jaxtwin._quadratic_program import QuadraticProgram, minimised

minimum = jax.jit(minimised)


def random_program(size: int, decades: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A root of the Hessian, and where the minimum without limits is."""
    random = np.random.default_rng(seed)
    turn = np.linalg.qr(random.normal(size=(size, size)))[0]
    aim = random.normal(size=size) * random.choice([0.3, 1.0, 5.0])
    return np.sqrt(np.logspace(0, -decades, size))[:, None] * turn, aim


@pytest.mark.slow
@pytest.mark.parametrize("size", [2, 10, 40])
@pytest.mark.parametrize("decades", [0, 3, 5])
def test_the_minimum_in_a_box_is_that_of_scipy(size: int, decades: int):
    """By bounded least squares with an active set, which ends at the vertex itself."""
    with jax.enable_x64(True):
        for seed in range(4):
            root, aim = random_program(size, decades, seed)
            H = root.T @ root
            expected = lsq_linear(root, root @ aim, (-1.0, 1.0), "bvls", tol=1e-15).x
            limits = -np.ones(size), np.ones(size)
            program = QuadraticProgram(*map(jnp.asarray, (H, -H @ aim, np.eye(size), *limits)))
            np.testing.assert_allclose(minimum(program), expected, rtol=0, atol=1e-6)


def test_limits_of_differences_are_those_of_scipy():
    """Box and rate, by sequential least squares."""
    size = 10
    M = np.vstack([np.eye(size), np.eye(size) - np.eye(size, k=-2)])
    low, high = -np.ones(2 * size), np.r_[np.ones(size), np.full(size, 0.2)]
    with jax.enable_x64(True):
        for seed in range(4):
            root, aim = random_program(size, 2, seed)
            H = root.T @ root
            found = minimize(
                lambda z, H=H, aim=aim: 0.5 * (z - aim) @ H @ (z - aim),
                np.zeros(size),
                jac=lambda z, H=H, aim=aim: H @ (z - aim),
                method="SLSQP",
                constraints={
                    "type": "ineq",
                    "fun": lambda z: np.r_[high - M @ z, M @ z - low],
                    "jac": lambda z: np.vstack([-M, M]),
                },
                options={"ftol": 1e-15, "maxiter": 500},
            )
            program = QuadraticProgram(*map(jnp.asarray, (H, -H @ aim, M, low, high)))
            z = np.asarray(minimum(program))
            np.testing.assert_allclose(z, found.x, rtol=0, atol=1e-6)
            assert np.all((M @ z - low > -1e-9) & (high - M @ z > -1e-9))


def test_soft_limits_are_those_of_scipy_with_their_excess_as_unknowns():
    """A hard box, and sums that are limited softly, some of them beyond what the box leaves."""
    size, rows = 6, 4
    for seed in range(4):
        root, aim = random_program(size, 2, seed)
        random = np.random.default_rng(seed)
        H, M = root.T @ root, random.normal(size=(rows, size))
        middle = 3 * random.normal(size=rows)
        soft_low, soft_high = middle - 0.1, middle + 0.1
        softness = 0.02 * np.arange(1.0, rows + 1)
        low, high = np.r_[-np.ones(size), soft_low], np.r_[np.ones(size), soft_high]

        def cost(both, H=H, aim=aim, softness=softness):
            z, e = both[:size] - aim, both[size:]
            return 0.5 * z @ H @ z + 0.5 * np.sum(e**2 / softness)

        def slope(both, H=H, aim=aim, softness=softness):
            return np.r_[H @ (both[:size] - aim), both[size:] / softness]

        excess = np.hstack([M, np.eye(rows)]), np.hstack([-M, np.eye(rows)])
        G, h = np.vstack(excess), np.r_[soft_low, -soft_high]
        expected = minimize(
            cost,
            np.zeros(size + rows),
            jac=slope,
            method="SLSQP",
            bounds=[(-1, 1)] * size + [(0, None)] * rows,
            constraints={
                "type": "ineq",
                "fun": lambda both, G=G, h=h: G @ both - h,
                "jac": lambda both, G=G: G,
            },
            options={"ftol": 1e-15, "maxiter": 500},
        )
        assert expected.x[size:].max() > 0.1
        with jax.enable_x64(True):
            parts = (H, -H @ aim, np.vstack([np.eye(size), M]), low, high)
            program = QuadraticProgram(*map(jnp.asarray, (*parts, np.r_[np.zeros(size), softness])))
            np.testing.assert_allclose(minimum(program), expected.x[:size], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_derivatives_are_those_of_the_minimum():
    """Where a limit is active the unknown does not move; forwards, backwards and in batches."""
    root, aim = random_program(4, 1, 0)
    aim[0] += 3.0

    with jax.enable_x64(True):
        H = jnp.asarray(root.T @ root)

        @jax.jit
        def found(aim: jax.Array) -> jax.Array:
            return minimised(QuadraticProgram(H, -H @ aim, jnp.eye(4), -jnp.ones(4), jnp.ones(4)))

        at = jnp.asarray(aim)
        slope = jax.jit(jax.jacfwd(found))(at)
        by_differences = np.stack(
            [(found(at.at[n].add(1e-4)) - found(at.at[n].add(-1e-4))) / 2e-4 for n in range(4)],
            axis=1,
        )
        np.testing.assert_allclose(slope, by_differences, atol=1e-5)
        np.testing.assert_allclose(jax.jit(jax.jacrev(found))(at), slope, atol=1e-12)
        many = jnp.stack([at, -at])
        np.testing.assert_allclose(jax.vmap(found)(many)[1], found(-at), atol=1e-9)


def test_the_cost_in_float32_is_within_a_thousandth_of_the_minimum():
    for decades in (0, 2, 3):
        root, aim = random_program(40, decades, decades)
        H = root.T @ root
        expected = lsq_linear(root, root @ aim, (-1.0, 1.0), "bvls", tol=1e-15).x
        parts = (H, -H @ aim, np.eye(40), -np.ones(40), np.ones(40))
        z = minimum(QuadraticProgram(*(jnp.asarray(part, jnp.float32) for part in parts)))
        worse = 0.5 * (z - expected) @ H @ (z - expected) + (H @ (expected - aim)) @ (z - expected)
        assert z.dtype == jnp.float32
        assert float(worse) < 1e-3
