r"""Small convex quadratic programs with limits on both sides, inside JAX.

$$\min_{z, e} \tfrac12 z^T H z + f^T z + \tfrac12 \sum_i e_i^2 / s_i, \quad
a - e \le M z \le b + e$$

A limit with a softness $s_i$ of 0 is hard; beyond a soft limit the cost grows with the square of
the excess $e_i$, which is $s_i$ times the multiplier of the limit and therefore not an additional
unknown.

Sums can form bands: what is limited in band $g$ is $N_{g,i} z - c_g$, from a centre $c_g$ that is
free and costs nothing. With limits of $\mp h$ the sums of a band then differ by at most $2 h$. The
centres are eliminated from the equations of each step, because there are as many as samples in a
horizon.

The method is a primal-dual interior point method with a single factorisation in each step (Nocedal
and Wright, *Numerical Optimization*, 2006, chapter 16.6). It needs 8 to 20 steps. First-order
methods would need hundreds, because the eigenvalues of the Hessian of a plate with a delay are far
apart.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._lapack import solve, solve_definite

# The largest number of steps.
STEPS = 30

# The factor by which a step aims to reduce the product of slack and multiplier.
CENTERING = 0.05

# The largest part of the way to the nearest limit that a step takes.
TO_BOUNDARY = 0.99


class QuadraticProgram(NamedTuple):
    """A quadratic program in which `lowest` is below `highest` for each limit.

    - `softness`: the softness of each limit; a single 0 if all are hard.
    - `bands`: the sums that are counted from the centre of their band; None for none. Their limits
      follow those of `matrix`.
    """

    hessian: Float[Array, "n n"]
    slope: Float[Array, " n"]
    matrix: Float[Array, "m n"]
    lowest: Float[Array, " m"]
    highest: Float[Array, " m"]
    softness: Float[Array, " #m"] | float = 0.0
    bands: Float[Array, "bands members n"] | None = None


class _Point(NamedTuple):
    """Unknowns with the centres of the bands after them, and slacks and multipliers of
    `[M; -M] z <= [b; -a]`."""

    z: Float[Array, " unknowns"]
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

    _, result = jax.lax.while_loop(is_open, further, (jnp.zeros((), int), _start(held)))
    last = _step(held, program, jax.lax.stop_gradient(result), is_last=True)
    return last.z[: len(program.slope)]


def _start(program: QuadraticProgram) -> _Point:
    """Multipliers of 1, and slacks as if each unknown were midway between its limits."""
    width = program.highest - program.lowest
    count = 2 * len(width)
    centres = 0 if program.bands is None else len(program.bands)
    z = jnp.zeros(len(program.slope) + centres, program.slope.dtype)
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
    by_z = _slope(program, z) + _transposed(program, _difference(multiplier))
    softness = jnp.broadcast_to(program.softness, program.lowest.shape)
    softness = jnp.concatenate([softness, softness])
    by_limit = slack - _room(program, z) - softness * multiplier
    by_product = slack * multiplier - aim
    stiffness = slack + multiplier * softness
    weight = multiplier / stiffness
    half = len(program.lowest)
    both = weight[:half] + weight[half:]
    rest = (multiplier * by_limit - by_product) / stiffness
    right = -by_z - _transposed(program, _difference(rest))
    dz = _solved(fixed, both, right, is_last=is_last)
    moved = _sums(program, dz)
    dmultiplier = weight * jnp.concatenate([moved, -moved]) + rest
    dslack = softness * dmultiplier - by_limit - jnp.concatenate([moved, -moved])
    length = 1.0 if is_last else jnp.minimum(_reach(slack, dslack), _reach(multiplier, dmultiplier))
    return _Point(z + length * dz, slack + length * dslack, multiplier + length * dmultiplier)


def _solved(
    program: QuadraticProgram,
    weight: Float[Array, " m"],
    right: Float[Array, " unknowns"],
    *,
    is_last: bool,
) -> Float[Array, " unknowns"]:
    """Solves the equations of a step, without derivatives by the program unless it is the last."""
    size = len(program.slope)
    matrix = _all_sums(program)
    system = program.hessian + matrix.T @ (weight[:, None] * matrix)
    above = right[:size]
    pulls = total = None
    if program.bands is not None:
        of_bands = weight[len(program.matrix) :].reshape(program.bands.shape[:2])
        pulls, total = (of_bands[:, :, None] * program.bands).sum(axis=1), of_bands.sum(axis=1)
        system = system - pulls.T @ (pulls / total[:, None])
        above = above + pulls.T @ (right[size:] / total)
    z = solve(system, above) if is_last else solve_definite(system, above[:, None])[:, 0]
    if pulls is None or total is None:
        return z
    return jnp.concatenate([z, (right[size:] + pulls @ z) / total])


def _slope(program: QuadraticProgram, z: Float[Array, " unknowns"]) -> Float[Array, " unknowns"]:
    """The slope of the cost; 0 by the centres."""
    size = len(program.slope)
    return jnp.zeros_like(z).at[:size].set(program.hessian @ z[:size] + program.slope)


def _all_sums(program: QuadraticProgram) -> Float[Array, "m n"]:
    if program.bands is None:
        return program.matrix
    return jnp.concatenate([program.matrix, program.bands.reshape(-1, len(program.slope))])


def _sums(program: QuadraticProgram, z: Float[Array, " unknowns"]) -> Float[Array, " m"]:
    """What is limited."""
    size, rows = len(program.slope), len(program.matrix)
    sums = _all_sums(program) @ z[:size]
    if program.bands is None:
        return sums
    return sums.at[rows:].add(-jnp.repeat(z[size:], program.bands.shape[1]))


def _room(program: QuadraticProgram, z: Float[Array, " unknowns"]) -> Float[Array, " limits"]:
    value = _sums(program, z)
    return jnp.concatenate([program.highest - value, value - program.lowest])


def _difference(multiplier: Float[Array, " limits"]) -> Float[Array, " m"]:
    """What pulls at a sum: the multiplier of its highest less that of its lowest value."""
    half = len(multiplier) // 2
    return multiplier[:half] - multiplier[half:]


def _transposed(program: QuadraticProgram, force: Float[Array, " m"]) -> Float[Array, " unknowns"]:
    by_z = _all_sums(program).T @ force
    if program.bands is None:
        return by_z
    of_bands = force[len(program.matrix) :].reshape(program.bands.shape[:2])
    return jnp.concatenate([by_z, -of_bands.sum(axis=1)])


def _reach(value: Float[Array, " limits"], change: Float[Array, " limits"]) -> Float[Array, ""]:
    """The part of a step after which the first positive quantity is nearly 0."""
    falls = change < 0
    until = jnp.where(falls, -value / jnp.where(falls, change, -1.0), jnp.inf)
    return jnp.minimum(1.0, TO_BOUNDARY * jnp.min(until))
