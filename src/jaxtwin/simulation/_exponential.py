r"""One step of exponential time differencing in the modes of a thermal network.

With $x = V z$ (see `_modes`),

$$\dot z = -\Lambda z + V^T (q(V z, u) + S V z),$$

whose linear part is integrated exactly, however stiff, and whose nonlinear part acts through the
few rows of $V$ that belong to the cells, and to the plate where its losses are nonlinear.
Each step is Krogstad's ETDRK4-B (J. Comput. Phys. 203 (2005) 72-88, eq. 51), which keeps more of
its order where forces are stiff than the scheme of Cox and Matthews does; its functions of
$\Lambda h$ are elementwise here.

Derivatives do not pass through the eigenvectors, whose derivative does not exist where
eigenvalues repeat, as they do on every symmetric plate.
The basis is held fixed and the change of $G$ and $C$ acts as one more force, which is exact for
the equations and leaves the values alone.
"""

import math
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..physics import System
from ._modes import Modes


@final
class Inputs(eqx.Module):
    """What drives the rig during a step: duty cycles and the ambient's deviation, K.

    Where the driver lags behind its command the duty cycles change within the step, and there is
    one row each for its start, its middle and its end; likewise where the ambient drifts. In a
    table of many steps both have a leading axis for the steps.

    `heat` is what else flows into the modes during the step, V^T q, None for nothing.
    """

    duty: Float[Array, "*steps_and_stages cells"]
    ambient: Float[Array, "*steps_stages"]
    heat: Float[Array, "*stages modes"] | None = None

    def at(self, stage: int) -> "Inputs":
        """At the start (0), in the middle (1) or at the end (2) of the step."""
        duty = self.duty if self.duty.ndim == 1 else self.duty[stage]
        ambient = self.ambient if self.ambient.ndim == 0 else self.ambient[stage]
        heat = self.heat if self.heat is None or self.heat.ndim == 1 else self.heat[stage]
        return Inputs(duty, ambient, heat)


@final
class ModalField(eqx.Module):
    """The vector field of a network in its modes.

    `surroundings` is V^T g_amb, the force per kelvin of the ambient's deviation, and `held` the
    constant force by what is held at a temperature of its own, None for none.
    `stiffness` and `mass` are V^T (G - G0) V and V^T (C - C0) V, with G0 and C0 what the modes
    were made of: zero in value, but not in their derivatives.
    """

    system: System
    modes: Modes
    reference: Float[Array, ""]
    surroundings: Float[Array, " modes"]
    held: Float[Array, " modes"] | None
    stiffness: Float[Array, "modes modes"]
    mass: Float[Array, "modes modes"]

    @classmethod
    def of(cls, system: System, modes: Modes, reference: Float[Array, ""]) -> "ModalField":
        """The field of a system in its own modes."""
        V = modes.shapes
        conductance = system.conductance - jax.lax.stop_gradient(system.conductance)
        capacitance = system.capacitance - jax.lax.stop_gradient(system.capacitance)
        return cls(
            system=system,
            modes=modes,
            reference=reference,
            surroundings=V.T @ system.ambient_conductance,
            held=None if system.reservoirs is None else V.T @ system.reservoirs.heat(reference),
            stiffness=V.T @ conductance @ V,
            mass=V.T * capacitance @ V,
        )

    def force(self, amplitudes: Float[Array, " modes"], inputs: Inputs) -> Float[Array, " modes"]:
        """What the modes feel beside their own decay: cells and a changing ambient, K/s."""
        system, modes = self.system, self.modes
        deviation = modes.sides @ amplitudes
        heat = system.cell_heat(deviation + self.reference, inputs.duty)
        flow = jnp.concatenate([-heat.cold, heat.hot]) + modes.linearised_conductance @ deviation
        force = modes.sides.T @ flow + self.surroundings * inputs.ambient
        if self.held is not None:
            force = force + self.held
        if inputs.heat is not None:
            force = force + inputs.heat
        linearised = modes.linearised_loss
        if system.loss is not None and modes.plate is not None and linearised is not None:
            plate = modes.plate @ amplitudes
            lost = system.loss.heat(plate - inputs.ambient, self.reference + inputs.ambient)
            force = force + modes.plate.T @ (linearised * plate - lost)
        # Twice, since the change of C acts on a slope that has the changes in it: exact up to
        # second derivatives.
        bent = _vanishing(self.stiffness, amplitudes)
        slope = force - modes.rates * amplitudes
        slope = slope - bent - _vanishing(self.mass, slope)
        return force - bent - _vanishing(self.mass, slope)


@jax.custom_jvp
def _vanishing(matrix: Array, vector: Array) -> Array:
    """Product with a matrix that is zero in value, but not in its derivative."""
    del matrix
    return jnp.zeros_like(vector)


@_vanishing.defjvp
def _vanishing_jvp(primals: Any, tangents: Any) -> Any:
    (matrix, vector), (d_matrix, d_vector) = primals, tangents
    return _vanishing(matrix, vector), d_matrix @ vector + _vanishing(matrix, d_vector)


@final
class StepFactors(eqx.Module):
    """Elementwise factors of one step: functions of rate times step size.

    The amplitudes decay by `half_decay` and `decay`; forces count by `half` in the first half step,
    by `half_start` and `half_middle` in the second try at it, by `whole_start` and `whole_middle`
    in the first try at the whole step, and by `first`, `middle` and `last` in the end.
    """

    half_decay: Float[Array, "*sizes modes"]
    half: Float[Array, "*sizes modes"]
    half_start: Float[Array, "*sizes modes"]
    half_middle: Float[Array, "*sizes modes"]
    decay: Float[Array, "*sizes modes"]
    whole_start: Float[Array, "*sizes modes"]
    whole_middle: Float[Array, "*sizes modes"]
    first: Float[Array, "*sizes modes"]
    middle: Float[Array, "*sizes modes"]
    last: Float[Array, "*sizes modes"]


def step_factors(rates: Float[Array, " modes"], sizes: Float[Array, "*sizes"]) -> StepFactors:
    """The factors for one or several step sizes."""
    h = jnp.asarray(sizes, rates.dtype)[..., None]
    half_growth = jnp.expm1(-rates * h / 2)
    growth = half_growth * (half_growth + 2)  # that of the whole step, without another expm1
    phi1, phi2, phi3 = _phi(rates * h, growth)
    half_phi1, half_phi2, _ = _phi(rates * h / 2, half_growth)
    return StepFactors(
        half_decay=1 + half_growth,
        half=h / 2 * half_phi1,
        half_start=h * (half_phi1 / 2 - half_phi2),
        half_middle=h * half_phi2,
        decay=1 + growth,
        whole_start=h * (phi1 - 2 * phi2),
        whole_middle=2 * h * phi2,
        first=h * (phi1 - 3 * phi2 + 4 * phi3),
        middle=h * (2 * phi2 - 4 * phi3),
        last=h * (4 * phi3 - phi2),
    )


def exponential_step(
    amplitudes: Float[Array, " modes"],
    force_0: Float[Array, " modes"],
    factors: StepFactors,
    field: ModalField,
    inputs: Inputs,
) -> tuple[Float[Array, " modes"], Float[Array, " modes"]]:
    """One step.

    **Arguments:**

    - `amplitudes`, `force_0`: at the start of the step, the force under its `inputs`.

    **Returns:** the amplitudes at its end, and its error estimate: by how much they would differ
    with the first of the two forces in the middle of the step in place of both, which is of third
    order in its size.
    """
    halfway, decayed = factors.half_decay * amplitudes, factors.decay * amplitudes
    force_a = field.force(halfway + factors.half * force_0, inputs.at(1))
    b = halfway + factors.half_start * force_0 + factors.half_middle * force_a
    force_b = field.force(b, inputs.at(1))
    c = decayed + factors.whole_start * force_0 + factors.whole_middle * force_b
    force_c = field.force(c, inputs.at(2))
    end = (
        decayed
        + factors.first * force_0
        + factors.middle * (force_a + force_b)
        + factors.last * force_c
    )
    return end, factors.middle * (force_b - force_a)


def _phi(
    x: Float[Array, "*shape"], growth: Float[Array, "*shape"]
) -> tuple[Float[Array, "*shape"], ...]:
    r"""$\varphi_k(-x)$, $k = 1, 2, 3$, from x and its growth $e^{-x} - 1$.

    $\varphi_{k+1}(y) = (\varphi_k(y) - 1/k!) / y$ cancels for small arguments: there the last one
    is a series, and the others follow from it.
    """
    small = jnp.abs(x) < 0.3
    tiny, large = jnp.where(small, x, 0.0), jnp.where(small, 1.0, x)
    phi1 = -jnp.where(small, 0.0, growth) / large
    phi2 = (1 - phi1) / large
    phi3 = (0.5 - phi2) / large
    series = jnp.zeros_like(x)
    for power in reversed(range(10)):
        series = series * -tiny + 1 / math.factorial(power + 3)
    phi3 = jnp.where(small, series, phi3)
    phi2 = jnp.where(small, 0.5 - tiny * series, phi2)
    phi1 = jnp.where(small, 1 - tiny * (0.5 - tiny * series), phi1)
    return phi1, phi2, phi3
