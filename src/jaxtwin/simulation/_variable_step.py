"""A step of any length, by the numbers of a `Stepper`: for an observer, whose readings come at
irregular times."""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..physics import Conditions
from ._exponential import StepInputs, exponential_step, step_factors
from ._stepper import Stepper, loss_line


def variable_step(
    stepper: Stepper,
    amplitudes: Float[Array, " modes"],
    duty: Float[Array, "stages cells"],
    surroundings: Float[Array, ""],
    heat: Float[Array, " modes"],
    size: Float[Array, ""],
    conditions: Conditions | None = None,
) -> Float[Array, " modes"]:
    """Computes the amplitudes of the modes after a step.

    **Arguments:**

    - `stepper`: gives the modes. Its step size says up to which length steps are stable.
    - `amplitudes`: those at the start of the step.
    - `duty`: the duty that reaches the cells at the start, in the middle and at the end.
    - `surroundings`: the ambient's deviation from the reference during the step, K.
    - `heat`: an additional force on the modes during the step.
    - `size`: the length of the step, s; 0 leaves the amplitudes as they are.
    - `conditions`: what the rig's other inputs change during the step; None where none is stated.
    """
    factors = step_factors(stepper.field.modes.rates, size)
    # The line through the losses divides by the length of the step.
    length = jnp.maximum(size, jnp.finfo(size.dtype).tiny ** 0.5)[None]
    sized = eqx.tree_at(
        lambda s: (s.sizes, s.half_decay, s.half),
        stepper,
        (length, factors.half_decay, factors.half),
    )
    held = StepInputs(duty[0], surroundings, heat, conditions)
    line = loss_line(sized, amplitudes, held, None)
    flow = heat
    if line is not None:
        elapsed = size * jnp.array([0.0, 0.5, 1.0], size.dtype)
        flow = line.first + elapsed[:, None] * line.slope
    inputs = StepInputs(duty, surroundings, flow, conditions)
    force = stepper.field.force(amplitudes, inputs.at(0)) if line is None else line.force
    return exponential_step(amplitudes, force, factors, stepper.field, inputs).amplitudes


def linear_step(
    matrix: Float[Array, "modes modes"],
    rates: Float[Array, " modes"],
    amplitudes: Float[Array, "modes columns"],
    forces: Float[Array, "stages modes columns"],
    size: Float[Array, ""],
) -> Float[Array, "modes columns"]:
    r"""Computes the amplitudes after a step for forces that are linear in them, of several columns
    side by side: $\dot z = (M - \Lambda) z + f(t)$.

    **Arguments:**

    - `matrix`: $M$. `rates`: the diagonal of $\Lambda$, 1/s.
    - `amplitudes`: those at the start of the step.
    - `forces`: $f$ at the start, in the middle and at the end of the step.
    - `size`: the length of the step, s.
    """
    factors, field = step_factors(rates, size), _LinearField(matrix)

    def column(
        amplitudes: Float[Array, " modes"], forces: Float[Array, "stages modes"]
    ) -> Float[Array, " modes"]:
        inputs = StepInputs(forces[0, :0], size, forces)
        first = field.force(amplitudes, inputs.at(0))
        return exponential_step(amplitudes, first, factors, field, inputs).amplitudes

    return jax.vmap(column, in_axes=(1, 2), out_axes=1)(amplitudes, forces)


@final
class _LinearField(eqx.Module):
    """Forces that are linear in the amplitudes, and those from outside."""

    matrix: Float[Array, "modes modes"]

    def force(
        self, amplitudes: Float[Array, " modes"], inputs: StepInputs
    ) -> Float[Array, " modes"]:
        assert inputs.heat is not None
        return self.matrix @ amplitudes + inputs.heat
