"""The optimiser on problems whose solutions are known, and against SciPy on bounded ones."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
import scipy.optimize

from jaxtwin.matching import BoundedLevenbergMarquardt

pytestmark = pytest.mark.usefixtures("float64")


def solve(fn: Callable, start, lower=None, upper=None, **options) -> optx.Solution:
    bounds = {}
    if lower is not None:
        bounds = {"lower": jnp.asarray(lower), "upper": jnp.asarray(upper)}
    return optx.least_squares(
        fn,
        BoundedLevenbergMarquardt(**options),
        jnp.asarray(start, dtype=float),
        options=bounds,
        max_steps=500,
        throw=False,
    )


def rosenbrock(y, args):
    return jnp.stack([10 * (y[1] - y[0] ** 2), 1 - y[0]])


def test_rosenbrocks_valley_ends_at_one_one():
    solution = solve(rosenbrock, [-1.2, 1.0])
    np.testing.assert_allclose(solution.value, [1.0, 1.0], atol=1e-8)
    assert int(solution.stats["num_jacobians"]) <= int(solution.stats["num_residuals"])


def test_a_linear_problem_is_solved_by_normal_equations():
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((20, 4)), rng.standard_normal(20)
    solution = solve(
        lambda y, args: jnp.asarray(a) @ y - jnp.asarray(b), np.zeros(4), rtol=1e-15, gtol=1e-12
    )
    np.testing.assert_allclose(solution.value, np.linalg.lstsq(a, b)[0], atol=1e-7)


def test_powells_singular_function_ends_at_zero():
    # The Jacobian is singular at the solution; convergence is linear there.
    def powell(y, args):
        return jnp.stack(
            [
                y[0] + 10 * y[1],
                jnp.sqrt(5.0) * (y[2] - y[3]),
                (y[1] - 2 * y[2]) ** 2,
                jnp.sqrt(10.0) * (y[0] - y[3]) ** 2,
            ]
        )

    solution = solve(powell, [3.0, -1.0, 0.0, 1.0], rtol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(solution.value, np.zeros(4), atol=1e-2)
    assert float(solution.stats["cost"]) < 1e-10


def test_a_descent_ends_where_rounding_refuses_a_step_that_promises_nothing():
    rng = np.random.default_rng(0)
    a, b = jnp.asarray(rng.standard_normal((20, 3))), jnp.asarray(rng.standard_normal(20))
    start = jnp.linalg.lstsq(a, b)[0] + 1e-6

    def rough(y, args):
        """Every other point costs a little more."""
        rounding = jnp.where(jnp.all(y == start), 0.0, 1e-5)
        return jnp.append(a @ y - b, rounding)

    solution = optx.least_squares(
        rough,
        BoundedLevenbergMarquardt(rtol=1e-6, gtol=0.0),
        start,
        options={"jacobian": lambda y, args: jnp.append(a, jnp.zeros((1, 3)), axis=0)},
        max_steps=500,
        throw=False,
    )
    np.testing.assert_array_equal(solution.value, start)
    assert int(solution.stats["num_residuals"]) == 2


@pytest.mark.parametrize("start", [[-1.2, 1.0], [0.4, 0.4]])
def test_an_optimum_on_the_box_is_scipys(start):
    lower, upper = [-2.0, -1.0], [0.5, 3.0]
    ours = solve(rosenbrock, start, lower, upper)
    theirs = scipy.optimize.least_squares(
        lambda y: np.asarray(rosenbrock(jnp.asarray(y), None)),
        start,
        bounds=(lower, upper),
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    np.testing.assert_allclose(ours.value, theirs.x, atol=1e-5)
    assert ours.value[0] == 0.5


def test_a_parameter_that_changes_nothing_stays_where_it_is():
    solution = solve(lambda y, args: jnp.stack([y[0] - 2.0, y[0] - 2.0]), [0.0, 5.0])
    np.testing.assert_allclose(solution.value, [2.0, 5.0], atol=1e-8)


def test_the_steps_do_not_depend_on_the_units_of_the_unknowns():
    # The same problem with the second parameter in units a million times smaller.
    def fn(y, args):
        return rosenbrock(jnp.stack([y[0], y[1] * 1e-6]), args)

    plain, scaled = solve(rosenbrock, [-1.2, 1.0]), solve(fn, [-1.2, 1.0e6])
    np.testing.assert_allclose(scaled.value * np.array([1, 1e-6]), plain.value, rtol=1e-6)
    assert int(plain.stats["num_residuals"]) == int(scaled.stats["num_residuals"])


def test_a_start_outside_the_box_is_moved_onto_it():
    solution = solve(lambda y, args: y - 1.0, [9.0], [0.0], [2.0])
    np.testing.assert_allclose(solution.value, [1.0], atol=1e-8)


def test_residuals_that_are_not_finite_are_an_error():
    solution = solve(lambda y, args: jnp.log(y), [-1.0])
    assert solution.result != optx.RESULTS.successful


def test_a_batch_of_starts_is_solved_at_once():
    starts = jnp.array([[-1.2, 1.0], [2.0, 2.0], [0.0, -3.0]])
    values = jax.vmap(lambda start: solve(rosenbrock, start).value)(starts)
    np.testing.assert_allclose(values, np.ones((3, 2)), atol=1e-6)
