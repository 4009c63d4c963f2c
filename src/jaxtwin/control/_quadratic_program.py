r"""Small convex quadratic programs with limits on both sides, inside of JAX.

$$\min_z \tfrac12 z^T H z + f^T z, \quad a \le M z \le b$$

The method is a primal-dual interior point with a single factorisation a step (Nocedal and Wright,
*Numerical Optimization*, 2006, chapter 16.6). It takes 8 to 20 steps whatever the problem;
first-order methods would need hundreds, because the Hessian of a plate seen through its delay has
eigenvalues that are far apart.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._lapack import solve, solve_definite

STEPS = 30
"""At most, for programs that are harder than any that was tried."""

CENTERING = 0.05
"""By how much a step aims to bring slack times multiplier down."""

TO_BOUNDARY = 0.99
"""Part of the way to the nearest limit that a step goes at most."""


class QuadraticProgram(NamedTuple):
    """Each limit leaves room: `lowest` is below `highest`."""

    hessian: Float[Array, "n n"]
    slope: Float[Array, " n"]
    matrix: Float[Array, "m n"]
    lowest: Float[Array, " m"]
    highest: Float[Array, " m"]


class _Point(NamedTuple):
    """Unknowns, slacks and multipliers of `[M; -M] z <= [b; -a]`."""

    z: Float[Array, " n"]
    slack: Float[Array, " limits"]
    multiplier: Float[Array, " limits"]


def minimised(program: QuadraticProgram) -> Float[Array, " n"]:
    """The minimum. Its derivatives are those of the optimality conditions, by a last Newton step
    through which they pass; not those of the steps before."""
    # Scaled to a Hessian of about 1, so that slacks and multipliers are of one size.
    scale = jnp.max(jnp.abs(jnp.diag(program.hessian)))
    program = program._replace(hessian=program.hessian / scale, slope=program.slope / scale)
    held = jax.lax.stop_gradient(program)
    limit = 1e-4 * jnp.finfo(program.slope.dtype).eps ** 0.5

    def is_open(state: tuple[Array, _Point]) -> Bool[Array, ""]:
        steps, point = state
        return (steps < STEPS) & (jnp.mean(point.slack * point.multiplier) > limit)

    def further(state: tuple[Array, _Point]) -> tuple[Array, _Point]:
        return state[0] + 1, _step(held, held, state[1])

    _, found = jax.lax.while_loop(is_open, further, (jnp.zeros((), int), _start(held)))
    return _step(held, program, jax.lax.stop_gradient(found), is_last=True).z


def _start(program: QuadraticProgram) -> _Point:
    """Multipliers of 1, and slacks as if each unknown were midway."""
    width = program.highest - program.lowest
    count = 2 * len(width)
    z = jnp.zeros_like(program.slope)
    slack = jnp.maximum(_room(program, z), jnp.concatenate([width, width]) / 2)
    return _Point(z, slack, jnp.ones(count, z.dtype))


def _step(
    fixed: QuadraticProgram, program: QuadraticProgram, point: _Point, *, is_last: bool = False
) -> _Point:
    """A step of Newton's method towards the central path.

    **Arguments:**

    - `fixed`: of which the matrix of the step is made, without derivatives.
    - `program`: whose conditions are to hold.
    - `is_last`: whole, and with the aim where the point is.
    """
    z, slack, multiplier = point
    count = len(slack)
    gap = slack @ multiplier / count
    aim = slack * multiplier if is_last else CENTERING * gap
    by_z = program.hessian @ z + program.slope + _transposed(program, multiplier)
    by_limit = slack - _room(program, z)
    by_product = slack * multiplier - aim
    weight = multiplier / slack
    half = len(program.lowest)
    both = weight[:half] + weight[half:]
    matrix = fixed.hessian + fixed.matrix.T @ (both[:, None] * fixed.matrix)
    rest = (multiplier * by_limit - by_product) / slack
    right = -by_z - _transposed(program, rest)
    dz = solve(matrix, right) if is_last else solve_definite(matrix, right[:, None])[:, 0]
    moved = program.matrix @ dz
    dslack = -by_limit - jnp.concatenate([moved, -moved])
    dmultiplier = -(by_product + multiplier * dslack) / slack
    length = 1.0 if is_last else jnp.minimum(_reach(slack, dslack), _reach(multiplier, dmultiplier))
    return _Point(z + length * dz, slack + length * dslack, multiplier + length * dmultiplier)


def _room(program: QuadraticProgram, z: Float[Array, " n"]) -> Float[Array, " limits"]:
    value = program.matrix @ z
    return jnp.concatenate([program.highest - value, value - program.lowest])


def _transposed(
    program: QuadraticProgram, multiplier: Float[Array, " limits"]
) -> Float[Array, " n"]:
    half = len(program.lowest)
    return program.matrix.T @ (multiplier[:half] - multiplier[half:])


def _reach(value: Float[Array, " limits"], change: Float[Array, " limits"]) -> Float[Array, ""]:
    """How far a step can go until something that is above 0 is nearly 0."""
    falls = change < 0
    until = jnp.where(falls, -value / jnp.where(falls, change, -1.0), jnp.inf)
    return jnp.minimum(1.0, TO_BOUNDARY * jnp.min(until))
