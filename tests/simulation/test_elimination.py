"""Gauss-Jordan elimination with pivots, beside NumPy's call of LAPACK."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin.simulation._rosenbrock_step import eliminate


@pytest.mark.usefixtures("float64")
@pytest.mark.parametrize("size", [1, 2, 3, 8])
def test_a_solution_is_that_of_lapack(size: int):
    rng = np.random.default_rng(size)
    matrix, right = rng.standard_normal((size, size)), rng.standard_normal(size)
    found = eliminate(jnp.asarray(matrix), jnp.asarray(right))
    np.testing.assert_allclose(found, np.linalg.solve(matrix, right), rtol=1e-11)


@pytest.mark.usefixtures("float64")
def test_a_pivot_of_zero_is_swapped_away():
    """The first column has its only entry in the last row, the second in the first."""
    matrix = jnp.array([[0.0, 2.0, 1.0], [0.0, 0.0, 4.0], [5.0, 0.0, 0.0]])
    solution = jnp.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(eliminate(matrix, matrix @ solution), solution)
