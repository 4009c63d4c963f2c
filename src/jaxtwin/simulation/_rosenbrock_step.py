r"""One step of the Rosenbrock method Rodas5P.

For $\dot y = f(t, y)$ with the Jacobian $J$ at the start of a step of size $h$,

$$\left(\frac{I}{\gamma h} - J\right) k_i = f(t_0 + c_i h, u_i) + \sum_{j<i} \frac{C_{ij}}{h} k_j
+ h d_i \frac{\partial f}{\partial t}, \quad u_i = y_0 + \sum_{j<i} a_{ij} k_j,$$

eight linear systems with one matrix, and no iterations: the derivatives of a step are those of its
formula. G. Steinebach, "Construction of Rosenbrock-Wanner method Rodas5P and numerical benchmarks
within the Julia Differential Equations package", BIT Numer. Math. 63 (2023) 27: stiffly accurate
and L-stable, of order five, and of order four on parabolic problems with boundary values that
change, to which other methods of this kind lose more of their order. The coefficients are those of
the paper for the sums in the form above (E. Hairer and G. Wanner, "Solving Ordinary Differential
Equations II", sec. IV.7).

A vector is a list of arrays here: of one array that holds all its components, or of one array for
each component.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._sparse import Entry

Vector: TypeAlias = Sequence[Float[Array, "*shape"]]

GAMMA = 0.21193756319429014

NODES = (0.0, 0.6358126895828704, 0.4095798393397535, 0.9769306725060716, 0.4288403609558664)
NODES += (1.0, 1.0, 1.0)
"""$c_i$: where in the step each stage is."""

TIME = (GAMMA, -0.42387512638858027, -0.3384627126235924, 1.8046452872882734, 2.325825639765069)
TIME += (0.0, 0.0, 0.0)
"""$d_i$."""

# $a_{ij}$ of the first six stages. The others are $u_7 = u_6 + k_6$ and $u_8 = u_7 + k_7$, and the
# result is $u_8 + k_8$.
STATES: tuple[tuple[float, ...], ...] = (
    (),
    (3.0,),
    (2.849394379747939, 0.45842242204463923),
    (-6.954028509809101, 2.489845061869568, -10.358996098473584),
    (2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641),
    (
        -7.502846399306121,
        2.561846144803919,
        -11.627539656261098,
        -0.18268767659942256,
        0.030198172008377946,
    ),
)

# $C_{ij}$.
SLOPES: tuple[tuple[float, ...], ...] = (
    (),
    (-14.155112264123755,),
    (-17.97296035885952, -2.859693295451294),
    (147.12150275711716, -1.41221402718213, 71.68940251302358),
    (165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306),
    (
        24.854864614690072,
        -3.0009227002832186,
        47.4931110020768,
        5.5814197821558125,
        -0.6610691825249471,
    ),
    (
        30.91273214028599,
        -3.1208243349937974,
        77.79954646070892,
        34.28646028294783,
        -19.097331116725623,
        -28.087943162872662,
    ),
    (
        37.80277123390563,
        -3.2571969029072276,
        112.26918849496327,
        66.9347231244047,
        -40.06618937091002,
        -54.66780262877968,
        -9.48861652309627,
    ),
)

# The weights of the stages in $p_2, p_3, p_4$ of the continuous output of fourth order, $$y(t_0 + s
# h) = (1 - s) y_0 + s y_1 + s (1 - s) (p_2 + s (p_3 + s p_4)).$$
DENSE: tuple[tuple[float, ...], ...] = (
    (
        25.948786856663858,
        -2.5579724845846235,
        10.433815404888879,
        -2.3679251022685204,
        0.524948541321073,
        1.1241088310450404,
        0.4272876194431874,
        -0.17202221070155493,
    ),
    (
        -9.91568850695171,
        -0.9689944594115154,
        3.0438037242978453,
        -24.495224566215796,
        20.176138334709044,
        15.98066361424651,
        -6.789040303419874,
        -6.710236069923372,
    ),
    (
        11.419903575922262,
        2.8879645146136994,
        72.92137995996029,
        80.12511834622643,
        -52.072871366152654,
        -59.78993625266729,
        -0.15582684282751913,
        4.883087185713722,
    ),
)


# The weights of the powers of $s$ in a polynomial $c$ with which $y(t_0 + s h) + c(s) k_8$ is a
# continuous output of fifth order for linear equations. Of $\dot y = \lambda y$ both $k_8$ and the
# error of the output of fourth order begin with $(h \lambda)^5$, and $c$ is the ratio of the two.
# It is 0 at both ends of the step.
CORRECTION = (
    0.0,
    7.560298092921883,
    -66.33677970337487,
    177.50113060685334,
    -186.00271158389666,
    67.27806258749634,
)


def _table(rows: Sequence[Sequence[float]]) -> Float[np.ndarray, "8 8"]:
    """Rows of weights of the stages, filled up with zeros."""
    table = np.zeros((len(NODES), len(NODES)))
    for number, row in enumerate(rows):
        table[number, : len(row)] = row
    return table


STATE_TABLE = _table([*STATES, (*STATES[-1], 1.0), (*STATES[-1], 1.0, 1.0)])
# All $a_{ij}$ and $C_{ij}$.
SLOPE_TABLE = _table(SLOPES)


class RosenbrockStep(NamedTuple):
    """The result of a step: the state at its `end`, and the difference to the embedded solution of
    fourth order as an estimate of the `error`, which is $k_8$."""

    end: list[Array]
    error: list[Array]


def rosenbrock_step(
    start: Vector,
    size: Float[Array, ""],
    slope: Callable[[int, Vector], Vector],
    time_slope: Vector | None,
    solve: Callable[[Vector], Vector],
    first_slope: Vector | None = None,
) -> RosenbrockStep:
    r"""Computes one step.

    **Arguments:**

    - `start`: the state at the start of the step.
    - `size`: the step size $h$.
    - `slope`: (number of a stage, 0 to 7, and its state) -> $f$ at the time of the stage.
    - `time_slope`: $\partial f / \partial t$ at the start; None where $f$ does not depend on time.
    - `solve`: the solution of a system with the matrix $I / (\gamma h) - J$.
    - `first_slope`: $f$ at the start if it is known.
    """
    stages: list[list[Array]] = []
    state = list(start)
    for number, of_stages in enumerate(SLOPES):
        if number < len(STATES):
            if number:
                state = added(start, combined(STATES[number], stages))
        else:
            state = added(state, stages[-1])
        at_stage = slope(number, state) if number or first_slope is None else first_slope
        right = list(at_stage)
        if number:
            right = added(right, [x / size for x in combined(of_stages, stages)])
        if time_slope is not None and TIME[number]:
            right = [
                x + (TIME[number] * size) * rate for x, rate in zip(right, time_slope, strict=True)
            ]
        stages.append(list(solve(right)))
    return RosenbrockStep(added(state, stages[-1]), stages[-1])


def step_matrix(
    jacobian: Mapping[Entry, Float[Array, "*shape"]], size: Float[Array, ""]
) -> dict[Entry, Float[Array, "*shape"]]:
    r"""The entries of $I / (\gamma h) - J$ for those of a sparse $J$."""
    diagonal = 1 / (GAMMA * size)
    return {(i, j): diagonal - slope if i == j else -slope for (i, j), slope in jacobian.items()}


def combined(weights: Sequence[float], vectors: Sequence[Vector]) -> list[Array]:
    """The sum of vectors with weights."""
    total = [weights[0] * x for x in vectors[0]]
    for weight, vector in zip(weights[1:], vectors[1:], strict=True):
        total = [a + weight * x for a, x in zip(total, vector, strict=True)]
    return total


def added(one: Vector, other: Vector) -> list[Array]:
    """The sum of two vectors."""
    return [jnp.add(a, b) for a, b in zip(one, other, strict=True)]


# Gauss-Jordan elimination as one loop: a tenth of the code of a call of LAPACK's general solver.
#
# XLA expands that call into a factorisation, a loop that converts its row swaps into a permutation,
# and two triangular solves. Each such call takes half a second to compile.


def eliminate(matrix: Float[Array, "n n"], right: Float[Array, " n"]) -> Float[Array, " n"]:
    """Solves `matrix @ x = right` for a matrix of a few rows. The pivots are the largest entries of
    the columns."""
    rows = jnp.arange(right.size)

    def clear_column(
        k: Int[Array, ""], table: Float[Array, "n columns"]
    ) -> Float[Array, "n columns"]:
        left = jnp.where(rows >= k, jnp.abs(table[:, k]), -1.0)
        largest = jnp.argmax(left)
        pivot_row = table[largest]
        table = jnp.where((rows == largest)[:, None], table[k], table)
        pivot_row = pivot_row / pivot_row[k]
        cleared = table - table[:, k, None] * pivot_row
        return jnp.where((rows == k)[:, None], pivot_row, cleared)

    table = jnp.concatenate([matrix, right[:, None]], axis=1)
    return jax.lax.fori_loop(0, right.size, clear_column, table)[:, -1]
