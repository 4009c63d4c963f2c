"""Whether the steps of a solution were short enough, and what happens to draws for which they were
not: they are solved again on steps half as long, and by a stiff solver where that does not help."""

from collections.abc import Callable
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from ..physics import System
from ._modes import Modes, heat_slope
from ._resolution import LARGEST_SPAN, network_span, spanned
from ._time_grid import TimeGrid, reference_temperature

STABILITY_LIMIT = 1.0
"""Of the `stability_number`: above it the steps are too long."""

ERROR_TOLERANCE = 2e-3
"""Of a solution's error estimate, K: above it the error may pass 1e-3 K. Of a thousand draws
between all bounds of `paper-2024`, `dual-cell` and `single-cell`, no error below this estimate
did."""

REFINEMENTS = 3
"""How often steps are halved before a stiff solver takes over."""

Results: TypeAlias = dict[str, Shaped[np.ndarray, "draws ..."]]
"""Name -> what is kept of each draw."""


def stability_number(system: System, modes: Modes, grid: TimeGrid) -> Float[Array, ""]:
    r"""How strongly the cells act on themselves beyond the modes, within the longest step.

    An exponential step is exact in the linear part $L$ and explicit in the remainder $N$ of the
    cells' heat flows. It is safe where

    $$\max_u \left\lVert |h \varphi_1(-h L)| \, |\partial N / \partial x| \right\rVert_\infty$$

    is well below 1, here over the smallest and the largest duty cycles $u$ of the run.

    **Returns:** the number. Infinite where the modes cannot be trusted although float64 can carry
    the network; NaN where it cannot, see `_resolution`.
    """
    dtype = modes.rates.dtype
    duty = jnp.asarray(grid.duty, dtype)
    levels = jnp.stack([duty.min(axis=0), duty.max(axis=0)])
    reference = reference_temperature(system, grid)
    sizes = jnp.asarray(grid.sizes, dtype)
    number = remainder_gain(system, modes, levels, reference, jnp.max(sizes))
    duration = sizes[grid.size].sum()
    slowest, fastest = modes.rates[0], modes.rates[-1]
    is_trusted = jnp.isfinite(number) & (spanned(fastest, slowest, duration) <= LARGEST_SPAN)
    is_resolved = network_span(system, slowest, duration) <= LARGEST_SPAN
    return jnp.where(is_resolved, jnp.where(is_trusted, number, jnp.inf), jnp.nan)


def remainder_gain(
    system: System,
    modes: Modes,
    duty: Float[Array, "levels cells"],
    reference: Float[Array, ""],
    step: Float[Array, ""],
) -> Float[Array, ""]:
    """The norm in the `stability_number`, largest over some duty cycles.

    **Arguments:**

    - `system`, `modes`: the equations.
    - `duty`: -1 to 1.
    - `reference`: what deviations are counted from, K.
    - `step`: its size, s.
    """
    x = modes.rates * step
    phi_1 = jnp.where(jnp.abs(x) < 1e-6, 1.0, -jnp.expm1(-x) / jnp.where(x == 0, 1.0, x))
    # What a heat flow at the sides does to their temperatures in a step.
    response = jnp.abs(modes.sides * (phi_1 * step) @ modes.sides.T)

    def row_sum(duty: Float[Array, " cells"]) -> Float[Array, ""]:
        slope = heat_slope(system, modes.operating_point, duty, reference)
        return (response @ jnp.abs(modes.linearised_conductance + slope)).sum(axis=1).max()

    return jax.vmap(row_sum)(duty).max()


def needs_shorter_steps(
    stability_number: Float[Array | np.ndarray, "*draws"],
    error_estimate: Float[Array | np.ndarray, "*draws"],
    refinement: int,
) -> Bool[np.ndarray, "*draws"]:
    """Whether steps were too long.

    A smaller error estimate is asked of steps that have been halved: where that was needed, errors
    and their estimate fall more slowly than they should.

    A solution that did not stay finite, whose error estimate is NaN, may be the result of steps
    that were too long. A stability number of NaN says that no steps help.
    """
    tolerance = ERROR_TOLERANCE if refinement == 0 else ERROR_TOLERANCE / 2
    stability_number, error_estimate = np.asarray(stability_number), np.asarray(error_estimate)
    is_good = (stability_number <= STABILITY_LIMIT) & (error_estimate <= tolerance)
    return np.asarray(~is_good & ~np.isnan(stability_number))


def solve_refined(
    draws: int,
    solve: Callable[[Int[np.ndarray, " some"], int], Results],
    rescue: Callable[[Int[np.ndarray, " some"]], Results],
) -> Results:
    """Solves draws, and those for which steps were too long again: on steps half as long, as often
    as `REFINEMENTS` says, and then by a stiff solver.

    **Arguments:**

    - `draws`: how many there are.
    - `solve`: from which draws, and how often steps are halved, to their results, with their
      "stability_number" and "error_estimate".
    - `rescue`: from which draws to the results that a stiff solver gives.

    **Returns:** the results of all draws.
    """
    chosen = np.arange(draws)
    results = solve(chosen, 0)
    chosen = chosen[_pop_refused(results, 0)]
    for refinement in range(1, REFINEMENTS + 1):
        if chosen.size == 0:
            return results
        finer = solve(chosen, refinement)
        refused = _pop_refused(finer, refinement)
        for name, values in finer.items():
            results[name][chosen] = values
        chosen = chosen[refused]
    if chosen.size:
        for name, values in rescue(chosen).items():
            results[name][chosen] = values
    return results


def _pop_refused(results: Results, refinement: int) -> Bool[np.ndarray, " draws"]:
    return needs_shorter_steps(
        results.pop("stability_number"), results.pop("error_estimate"), refinement
    )
