r"""Small convex quadratic programs with limits on both sides, inside JAX.

$$\min_{z, e} \tfrac12 z^T H z + f^T z + \tfrac12 \sum_i e_i^2 / s_i, \quad
a - e \le M z \le b + e$$

A limit with a softness $s_i$ of 0 is hard; beyond a soft limit the cost grows with the square of
the excess $e_i$, which is $s_i$ times the multiplier of the limit and therefore not an additional
unknown.

The method is a primal-dual interior point method with a single factorisation in each step (Nocedal
and Wright, *Numerical Optimization*, 2006, chapter 16.6). It needs 8 to 20 steps. First-order
methods would need hundreds, because the eigenvalues of the Hessian of a plate with a delay are far
apart.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..._lapack import solve, solve_definite

STEPS = 30
"""The largest number of steps."""

CENTERING = 0.05
"""The factor by which a step aims to reduce the product of slack and multiplier."""

TO_BOUNDARY = 0.99
"""The largest part of the way to the nearest limit that a step takes."""


class QuadraticProgram(NamedTuple):
    """A quadratic program in which `lowest` is below `highest` for each limit.

    - `softness`: the softness of each limit; a single 0 if all are hard.
    """

    hessian: Float[Array, "n n"]
    slope: Float[Array, " n"]
    matrix: Float[Array, "m n"]
    lowest: Float[Array, " m"]
    highest: Float[Array, " m"]
    softness: Float[Array, " #m"] | float = 0.0


class _Point(NamedTuple):
    """Unknowns, and slacks and multipliers of `[M; -M] z <= [b; -a]`."""

    z: Float[Array, " n"]
    slack: Float[Array, " limits"]
    multiplier: Float[Array, " limits"]


def minimised(program: QuadraticProgram) -> Float[Array, " n"]:
    """The minimum. Its derivatives are those of the optimality conditions: they pass through a last
    Newton step, and not through the steps before."""
    # Scaled to a Hessian of about 1, so that slacks and multipliers are of one size.
    scale = jnp.max(jnp.abs(jnp.diag(program.hessian)))
    program = program._replace(
        hessian=program.hessian / scale,
        slope=program.slope / scale,
        softness=program.softness * scale,
    )
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
    """Multipliers of 1, and slacks as if each unknown were midway between its limits."""
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

    - `fixed`: the program from which the matrix of the step is made, without derivatives.
    - `program`: the program whose conditions are to hold.
    - `is_last`: whether this is the last step, a full one that aims at the present point's
      complementarity.
    """
    z, slack, multiplier = point
    count = len(slack)
    gap = slack @ multiplier / count
    aim = slack * multiplier if is_last else CENTERING * gap
    by_z = program.hessian @ z + program.slope + _transposed(program, multiplier)
    softness = jnp.broadcast_to(program.softness, program.lowest.shape)
    softness = jnp.concatenate([softness, softness])
    by_limit = slack - _room(program, z) - softness * multiplier
    by_product = slack * multiplier - aim
    stiffness = slack + multiplier * softness
    weight = multiplier / stiffness
    half = len(program.lowest)
    both = weight[:half] + weight[half:]
    matrix = fixed.hessian + fixed.matrix.T @ (both[:, None] * fixed.matrix)
    rest = (multiplier * by_limit - by_product) / stiffness
    right = -by_z - _transposed(program, rest)
    dz = solve(matrix, right) if is_last else solve_definite(matrix, right[:, None])[:, 0]
    moved = program.matrix @ dz
    dmultiplier = weight * jnp.concatenate([moved, -moved]) + rest
    dslack = softness * dmultiplier - by_limit - jnp.concatenate([moved, -moved])
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
    """The part of a step after which the first positive quantity is nearly 0."""
    falls = change < 0
    until = jnp.where(falls, -value / jnp.where(falls, change, -1.0), jnp.inf)
    return jnp.minimum(1.0, TO_BOUNDARY * jnp.min(until))
