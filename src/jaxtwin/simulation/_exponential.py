r"""One step of exponential time differencing in the modes of a thermal network.

With $x = V z$ (see `_modes`),

$$\dot z = -\Lambda z + V^T (q(V z, u) + S V z),$$

whose linear part is integrated exactly, however stiff, and whose nonlinear part acts through the
few rows of $V$ that belong to the cells, and to the plate where its losses are nonlinear.
Each step is ETDRK4 (Cox and Matthews, J. Comput. Phys. 176 (2002) 430-455, eqs. 26-29); its
functions of $\Lambda h$ are elementwise here.

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
import numpy as np
from jaxtyping import Array, Float

from ..physics import System
from ._modes import Modes


@final
class Inputs(eqx.Module):
    """What drives the rig during a step: duty cycles and the ambient's deviation, K.

    Where the driver lags behind its command the duty cycles change within the step, and there is
    one row each for its start, its middle and its end; likewise where the ambient drifts. In a
    table of many steps both have a leading axis for the steps.
    """

    duty: Float[Array, "*steps_and_stages cells"]
    ambient: Float[Array, "*steps_stages"]

    def at(self, stage: int) -> "Inputs":
        """At the start (0), in the middle (1) or at the end (2) of the step."""
        duty = self.duty if self.duty.ndim == 1 else self.duty[stage]
        return Inputs(duty, self.ambient if self.ambient.ndim == 0 else self.ambient[stage])


@final
class ModalField(eqx.Module):
    """The vector field of a network in its modes.

    `stiffness` and `mass` are V^T (G - G0) V and V^T (C - C0) V, with G0 and C0 what the modes
    were made of: zero in value, but not in their derivatives.
    """

    system: System
    modes: Modes
    reference: Float[Array, ""]
    stiffness: Float[Array, "modes modes"]
    mass: Float[Array, "modes modes"]

    @classmethod
    def of(cls, system: System, modes: Modes, reference: Float[Array, ""]) -> "ModalField":
        """The field of a system in its own modes."""
        V = modes.shapes
        conductance = system.conductance - jax.lax.stop_gradient(system.conductance)
        capacitance = system.capacitance - jax.lax.stop_gradient(system.capacitance)
        return cls(system, modes, reference, V.T @ conductance @ V, V.T * capacitance @ V)

    def force(self, amplitudes: Float[Array, " modes"], inputs: Inputs) -> Float[Array, " modes"]:
        """What the modes feel beside their own decay: cells and a changing ambient, K/s."""
        system, modes, wiring = self.system, self.modes, self.system.wiring
        sides = modes.shapes[np.concatenate([wiring.cold, wiring.hot])]
        deviation = sides @ amplitudes
        heat = system.cell_heat(deviation + self.reference, inputs.duty)
        flow = jnp.concatenate([-heat.cold, heat.hot]) + modes.relief @ deviation
        force = sides.T @ flow
        if system.loss is not None and modes.film is not None:
            plate = modes.shapes[: wiring.elements]
            rise = plate @ amplitudes - inputs.ambient
            heat = system.loss.heat(rise, self.reference + inputs.ambient)
            force = force - plate.T @ (heat - modes.film * (plate @ amplitudes))
        force = force + modes.shapes.T @ (system.ambient_conductance * inputs.ambient)
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
    """Elementwise factors of one ETDRK4 step: functions of rate times step size."""

    half_decay: Float[Array, "*sizes modes"]
    half: Float[Array, "*sizes modes"]
    decay: Float[Array, "*sizes modes"]
    first: Float[Array, "*sizes modes"]
    middle: Float[Array, "*sizes modes"]
    last: Float[Array, "*sizes modes"]


def step_factors(rates: Float[Array, " modes"], sizes: Float[Array, "*sizes"]) -> StepFactors:
    """The factors for one or several step sizes."""
    h = jnp.asarray(sizes, rates.dtype)[..., None]
    decay, phi1, phi2, phi3 = _phi(rates * h)
    half_decay = jnp.exp(-rates * h / 2)
    return StepFactors(
        half_decay=half_decay,
        # phi1(2 y) = phi1(y) (1 + exp y) / 2.
        half=h * phi1 / (1 + half_decay),
        decay=decay,
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
) -> Float[Array, " modes"]:
    """One ETDRK4 step from amplitudes and the force on them to the amplitudes at its end."""
    decayed = factors.half_decay * amplitudes
    a = decayed + factors.half * force_0
    force_a = field.force(a, inputs.at(1))
    b = decayed + factors.half * force_a
    force_b = field.force(b, inputs.at(1))
    c = factors.half_decay * a + factors.half * (2 * force_b - force_0)
    force_c = field.force(c, inputs.at(2))
    return (
        factors.decay * amplitudes
        + factors.first * force_0
        + factors.middle * (force_a + force_b)
        + factors.last * force_c
    )


def _phi(x: Float[Array, "*shape"]) -> tuple[Float[Array, "*shape"], ...]:
    r"""$e^{-x}$ and $\varphi_k(-x)$, $k = 1, 2, 3$.

    $\varphi_{k+1}(y) = (\varphi_k(y) - 1/k!) / y$ cancels for small arguments: a series there.
    """
    small = jnp.abs(x) < 0.3
    tiny, large = jnp.where(small, x, 0.0), jnp.where(small, 1.0, x)
    phi1 = -jnp.expm1(-large) / large
    phi2 = (1 - phi1) / large
    phi3 = (0.5 - phi2) / large

    def series(k: int) -> Array:
        total = jnp.zeros_like(x)
        for power in reversed(range(10)):
            total = total * -tiny + 1 / math.factorial(power + k)
        return total

    return (
        jnp.exp(-x),
        jnp.where(small, series(1), phi1),
        jnp.where(small, series(2), phi2),
        jnp.where(small, series(3), phi3),
    )
