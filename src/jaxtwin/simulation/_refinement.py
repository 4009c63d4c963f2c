"""Decides whether the steps of a solution were short enough. Draws for which they were not are
solved again with shorter steps, and by a stiff solver if that does not help.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from ..physics import System
from ._modes import MAX_SPAN, Modes, heat_slope, network_span, spanned
from ._time_grid import InputSummary, reference_temperature

# The largest `stability_number` of steps that are short enough.
STABILITY_LIMIT = 1.0

# The largest error estimate of a solution that is accepted, K. Of a thousand draws between all
# bounds of `paper-2024`, `dual-cell` and `single-cell`, none with a smaller estimate had an error
# above 1e-3 K.
ERROR_TOLERANCE = 2e-3

# The numbers of times that steps are halved, one after the other, before a stiff solver takes over.
# Halving them once is not tried: it would suffice for half of the draws that need shorter steps,
# and compiling it takes longer than thousands of draws.
REFINEMENTS = (2, 3)

# Name -> the results of the draws.
Results: TypeAlias = dict[str, Shaped[np.ndarray, "draws ..."]]


def stability_number(system: System, modes: Modes, inputs: InputSummary) -> Float[Array, ""]:
    r"""A measure of the nonlinear feedback of the cells within the longest step.

    An exponential step is exact in the linear part $L$ and explicit in the remainder $N$ of the
    cells' heat flows. It is safe where

    $$\max_u \left\lVert |h \varphi_1(-h L)| \, |\partial N / \partial x| \right\rVert_\infty$$

    is well below 1, here over the smallest and the largest duty cycles $u$ of the run, and over
    the regimes of other inputs.

    **Returns:** the number. Infinite if the modes cannot be trusted although float64 can carry
    the network; NaN if it cannot, see `_resolution`.
    """
    if inputs.regimes is not None:
        levels = jnp.asarray(inputs.regimes, modes.rates.dtype)
        inputs = replace(inputs, regimes=None)
        numbers = jax.vmap(
            lambda regime, modes: stability_number(
                system.under(system.conditions(regime)), modes, inputs
            )
        )(levels, modes)
        return numbers.max()
    dtype = modes.rates.dtype
    duties = jnp.stack([jnp.asarray(duty, dtype) for duty in (inputs.lowest, inputs.highest)])
    reference = reference_temperature(system, inputs)
    longest = jnp.asarray(inputs.longest_step, dtype)
    number = remainder_gain(system, modes, duties, reference, longest)
    duration = jnp.asarray(inputs.duration, dtype)
    slowest, fastest = modes.rates[0], modes.rates[-1]
    is_trusted = jnp.isfinite(number) & (spanned(fastest, slowest, duration) <= MAX_SPAN)
    is_resolved = network_span(system, slowest, duration) <= MAX_SPAN
    return jnp.where(is_resolved, jnp.where(is_trusted, number, jnp.inf), jnp.nan)


def remainder_gain(
    system: System,
    modes: Modes,
    duty: Float[Array, "levels cells"],
    reference: Float[Array, ""],
    step: Float[Array, ""],
) -> Float[Array, ""]:
    """The norm in the `stability_number`: its largest value over some duty cycles.

    **Arguments:**

    - `system`, `modes`: the equations and their modes.
    - `duty`: the duty cycles, -1 to 1.
    - `reference`: the temperature from which deviations are counted, K.
    - `step`: the step size, s.
    """
    x = modes.rates * step
    phi_1 = jnp.where(jnp.abs(x) < 1e-6, 1.0, -jnp.expm1(-x) / jnp.where(x == 0, 1.0, x))
    # The response of the sides' temperatures in a step to heat flows at the sides.
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
    """Whether the steps of each solution were too long.

    For steps that have been halved the error estimate must be smaller, because errors and their
    estimates then fall more slowly than in theory.

    An error estimate of NaN belongs to a solution that did not stay finite, which may be a result
    of too long steps. A stability number of NaN means that shorter steps do not help.
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
    """Solves draws. Draws for which the steps were too long are solved again with shorter ones,
    see `REFINEMENTS`, and at last by a stiff solver.

    **Arguments:**

    - `draws`: the number of draws.
    - `solve`: (indices of draws, number of halvings) -> results of the default solver, with
      "refused": whether the steps of a draw were too long.
    - `rescue`: indices of draws -> results of a stiff solver.

    **Returns:** the results of all draws.
    """
    chosen = np.arange(draws)
    results = solve(chosen, 0)
    chosen = chosen[results.pop("refused")]
    for refinement in REFINEMENTS:
        if chosen.size == 0:
            return results
        finer = solve(chosen, refinement)
        refused = finer.pop("refused")
        for name, values in finer.items():
            results[name][chosen] = values
        chosen = chosen[refused]
    if chosen.size:
        for name, values in rescue(chosen).items():
            results[name][chosen] = values
    return results
