r"""One step of exponential time differencing in the modes of a thermal network.

With $x = V z$ (see `_modes`),

$$\dot z = -\Lambda z + V^T (q(V z, u) + S V z),$$

where $q$ are the heat flows of the cells and of nonlinear losses and $S$ is their linearisation,
which the modes already contain. The linear part is integrated exactly, however stiff it is. The
nonlinear part needs only the rows of $V$ that belong to the cells, and to the plate if its losses
are nonlinear. Each step is ETDRK4-B of S. Krogstad (J. Comput. Phys. 203 (2005) 72-88, eq. 51). The
more common ETDRK4 of Cox and Matthews is not used, because it loses more of its order where the
forces are stiff. The functions of $\Lambda h$ are elementwise here.

Derivatives do not pass through the eigenvectors, because their derivative does not exist where
eigenvalues repeat, as they do on every symmetric plate. Instead the basis is held fixed, and the
change of $G$ and $C$ enters as another force. This force is zero in value, and its derivative is
exactly that of the equations.
"""

import math
from typing import Any, NamedTuple, Protocol, final, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from .._jax_settings import in_precision
from ..physics import Conditions, System
from ._modes import LossShapes, Modes


@final
class StepInputs(eqx.Module):
    """The inputs during a step: duty cycles, and the ambient's deviation from the reference, K.

    If the driver has a lag, the duty cycles change within the step, and have one row each for its
    start, its middle and its end; likewise the ambient if it drifts. In a table of many steps, both
    have a leading axis for the steps.

    `heat` is an additional heat flow into the modes, $V^T q$; None for none. `conditions` are what
    the rig's other inputs change during the step; None for a rig without any.
    """

    duty: Float[Array, "*steps_and_stages cells"]
    ambient: Float[Array, "*steps_stages"]
    heat: Float[Array, "*stages modes"] | None = None
    conditions: Conditions | None = None

    def at(self, stage: int) -> "StepInputs":
        """Returns the inputs at the start (0), in the middle (1) or at the end (2) of the step."""
        duty = self.duty if self.duty.ndim == 1 else self.duty[stage]
        ambient = self.ambient if self.ambient.ndim == 0 else self.ambient[stage]
        heat = self.heat if self.heat is None or self.heat.ndim == 1 else self.heat[stage]
        return StepInputs(duty, ambient, heat, self.conditions)


@runtime_checkable
class Field(Protocol):
    """The forces on the modes."""

    def force(
        self, amplitudes: Float[Array, " modes"], inputs: StepInputs
    ) -> Float[Array, " modes"]: ...


@final
class ModalField(eqx.Module):
    r"""The vector field of a network in its modes, the equations of `System.heat_into_nodes`.

    - `reference`: the temperature from which deviations are counted, K.
    - `surroundings`: the force for each kelvin of the ambient's deviation, $V^T g_\text{amb}$.
    - `reservoir_force`: the constant force of bodies at a fixed temperature (`Reservoirs`), None
      for none.
    - `reservoir_shapes`: the force for each kelvin of their temperatures, if inputs change these.
    - `stiffness`, `mass`: $V^T (G - G_0) V$ and $V^T (C - C_0) V$, where the modes are those of
      $G_0$ and $C_0$. Both are zero in value, but their derivatives are not.
    - `loss_dtype`: the type in which the losses that are not linear are computed, None for that of
      the modes. These losses are a small part of the heat flows.
    """

    system: System
    modes: Modes
    reference: Float[Array, ""]
    surroundings: Float[Array, " modes"]
    reservoir_force: Float[Array, " modes"] | None
    stiffness: Float[Array, "modes modes"]
    mass: Float[Array, "modes modes"]
    reservoir_shapes: Float[Array, "modes reservoirs"] | None = None
    loss_dtype: DTypeLike | None = eqx.field(static=True, default=None)

    @classmethod
    def of(
        cls,
        system: System,
        modes: Modes,
        reference: Float[Array, ""],
        loss_dtype: DTypeLike | None = None,
    ) -> "ModalField":
        """Makes the field of a system in its own modes."""
        V = modes.shapes
        conductance = system.conductance - jax.lax.stop_gradient(system.conductance)
        capacitance = system.capacitance - jax.lax.stop_gradient(system.capacitance)
        return cls(
            system=system,
            modes=modes,
            reference=reference,
            surroundings=V.T @ system.ambient_conductance,
            reservoir_force=None
            if system.reservoirs is None
            else V.T @ system.reservoirs.heat(reference),
            stiffness=V.T @ conductance @ V,
            mass=V.T * capacitance @ V,
            reservoir_shapes=None
            if system.reservoirs is None or not system.wiring.inputs
            else V.T @ system.reservoirs.conductance.T,
            loss_dtype=loss_dtype,
        )

    @eqx.filter_jit  # traced once for all stages of a step
    def force(
        self, amplitudes: Float[Array, " modes"], inputs: StepInputs
    ) -> Float[Array, " modes"]:
        """Computes the right-hand side without the decay of the modes: the heat of the cells, of
        the surroundings and of nonlinear losses."""
        system, modes, conditions = self.system, self.modes, inputs.conditions
        if conditions is not None:
            system = system.under(conditions)
        deviation = modes.sides @ amplitudes
        heat = system.cell_heat(deviation + self.reference, inputs.duty)
        flow = jnp.concatenate([-heat.cold, heat.hot]) + modes.linearised_conductance @ deviation
        force = modes.sides.T @ flow + self.surroundings * inputs.ambient
        if self.reservoir_force is not None:
            force = force + self.reservoir_force
        if conditions is not None and self.reservoir_shapes is not None:
            force = force + self.reservoir_shapes @ conditions.reservoirs
        if modes.switched is not None:
            force = force - modes.switched.T @ self._switched_heat(system, amplitudes, inputs)
        if inputs.heat is not None:
            force = force + inputs.heat
        if modes.losses is not None:
            force = force + self._losses(amplitudes, inputs.ambient)
        # The change of C acts on the slope, which itself contains the change. Two rounds of this
        # substitution are exact up to second derivatives.
        turned = tangent_product(self.stiffness, amplitudes)
        slope = force - modes.rates * amplitudes
        slope = slope - turned - tangent_product(self.mass, slope)
        return force - turned - tangent_product(self.mass, slope)

    def _switched_heat(
        self, system: System, amplitudes: Float[Array, " modes"], inputs: StepInputs
    ) -> Float[Array, " links"]:
        """Computes the heat in the links that inputs change, beyond the modes' network, W."""
        assert self.modes.switched is not None
        change = system.conductance_change
        nodes = self.modes.switched @ amplitudes
        heat = jnp.zeros_like(nodes)
        if self.modes.linearised_change is not None:
            heat = -self.modes.linearised_change * nodes
        if change is None:
            return heat
        return heat + change * (nodes + system.held_differences(self.reference, inputs.ambient))

    def _losses(
        self, amplitudes: Float[Array, " modes"], ambient: Float[Array, ""]
    ) -> Float[Array, " modes"]:
        """Computes the losses beyond the modes' linear losses, as a force."""
        modes = self.modes
        assert modes.losses is not None
        assert modes.linearised_loss is not None
        return loss_force(
            modes.losses, modes.linearised_loss, self.system, self.reference, amplitudes, ambient,
            self.loss_dtype,
        )  # fmt: skip


def loss_force(
    shapes: LossShapes,
    linearised: Float[Array, " paths"],
    system: System,
    reference: Float[Array, ""],
    amplitudes: Float[Array, " modes"],
    ambient: Float[Array, ""],
    dtype: DTypeLike | None,
) -> Float[Array, " modes"]:
    """Computes the losses beyond the modes' linear losses, as a force.

    **Arguments:**

    - `shapes`: the modes at the paths of the losses.
    - `linearised`: the linear losses that the modes contain, W/K. `system`: the equations.
    - `reference`: the temperature from which deviations are counted, K.
    - `ambient`: the ambient's deviation from it, K.
    - `dtype`: the type in which they are computed, None for that of the numbers.
    """
    paths, far = system.wiring.loss_paths, system.far_ends(reference)
    assert paths is not None
    given: Any = (shapes, linearised, system.loss, far, reference, amplitudes, ambient)
    if dtype is not None:
        given = in_precision(given, dtype)
    shapes, linearised, law, far, reference, amplitudes_, room = given
    across = shapes.across @ amplitudes_
    at_far = None if shapes.at_far is None else shapes.at_far @ amplitudes_
    lost = law.heat(*paths.ends(across, at_far, far, reference, room))
    return (shapes.across.T @ (linearised * across - lost)).astype(amplitudes.dtype)


@jax.custom_jvp
def tangent_product(matrix: Array, vector: Array) -> Array:
    """Multiplies by a matrix that is zero in value, while its derivative is not."""
    del matrix
    # Not `zeros_like`, which has no batch axis where `vector` has one: JAX (0.10.2) then cannot
    # differentiate a derivative.
    return 0.0 * vector


@tangent_product.defjvp
def tangent_product_jvp(primals: Any, tangents: Any) -> Any:
    (matrix, vector), (d_matrix, d_vector) = primals, tangents
    return tangent_product(matrix, vector), d_matrix @ vector + tangent_product(matrix, d_vector)


@final
class StepFactors(eqx.Module):
    """The elementwise coefficients of a step: functions of rate times step size.

    `half_decay` and `decay` multiply the amplitudes. The other coefficients multiply forces: `half`
    in the second stage, `half_start` and `half_middle` in the third, `whole_start` and
    `whole_middle` in the fourth, and `first`, `middle` and `last` in the result.
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


@final
class DecayFunctions(eqx.Module):
    r"""The functions of $y = -\lambda h / 2$ from which the `StepFactors` follow: the decay over
    half a step, $e^y$, and $h \varphi_k(y)$ for $k = 1, 2, 3$."""

    half_decay: Float[Array, "*sizes modes"]
    phi_1: Float[Array, "*sizes modes"]
    phi_2: Float[Array, "*sizes modes"]
    phi_3: Float[Array, "*sizes modes"]

    def factors(self) -> StepFactors:
        r"""Computes the coefficients of a step.

        The functions of half a step give those of a whole one,

        $$2^k \varphi_k(2 y) = e^y \varphi_k(y) + \sum_{j=1}^{k} \frac{\varphi_j(y)}{(k - j)!}.$$

        A loop over many steps keeps these four functions and calls this in each step: a table of
        all ten coefficients takes longer to write and to read than they take to compute.
        """
        phi_1, phi_2, phi_3 = self.phi_1, self.phi_2, self.phi_3
        both = 1 + self.half_decay
        both_1, both_2, both_3 = both * phi_1, both * phi_2, both * phi_3
        return StepFactors(
            half_decay=self.half_decay,
            half=phi_1 / 2,
            half_start=phi_1 / 2 - phi_2,
            half_middle=phi_2,
            decay=self.half_decay**2,
            whole_start=(both_1 - both_2 - phi_1) / 2,
            whole_middle=(phi_1 + both_2) / 2,
            first=(both_1 + both_3 + phi_2 - phi_1) / 2 - 0.75 * both_2,
            middle=phi_1 / 4 - phi_2 / 2 + (both_2 - both_3) / 2,
            last=(phi_2 + both_3) / 2 - both_2 / 4,
        )


def decay_functions(rates: Float[Array, " modes"], sizes: Float[Array, "*sizes"]) -> DecayFunctions:
    """Computes the functions of the modes' decay for one or several step sizes, s."""
    h = jnp.asarray(sizes, rates.dtype)[..., None]
    growth = jnp.expm1(-rates * h / 2)
    return DecayFunctions(1 + growth, *(h * phi for phi in _phi(rates * h / 2, growth)))


def step_factors(rates: Float[Array, " modes"], sizes: Float[Array, "*sizes"]) -> StepFactors:
    """Computes the coefficients for one or several step sizes, s."""
    return decay_functions(rates, sizes).factors()


class ExponentialStep(NamedTuple):
    """The result of a step.

    - `amplitudes`: those at the end of the step.
    - `last_force`: the force from which they follow, that of the last stage. `last_force - rates *
      amplitudes` is the slope at the end of a step. The force at `amplitudes` themselves is more
      accurate, but the slope of a fast mode is the small difference of two large numbers, in which
      an error of the amplitude would count rate times step size as much.
    - `error`: an error estimate, the change of the result if the first of the two forces in the
      middle of the step replaced both. It is of third order in the step size.
    """

    amplitudes: Float[Array, " modes"]
    last_force: Float[Array, " modes"]
    error: Float[Array, " modes"]


def exponential_step(
    amplitudes: Float[Array, " modes"],
    force_0: Float[Array, " modes"],
    factors: StepFactors,
    field: Field,
    inputs: StepInputs,
) -> ExponentialStep:
    """Computes one step.

    **Arguments:**

    - `amplitudes`: those at the start of the step.
    - `force_0`: the force at the start, under the inputs of this step.
    - `factors`: the coefficients of the step size.
    - `field`, `inputs`: the vector field and its inputs during the step.
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
    return ExponentialStep(end, force_c, factors.middle * (force_b - force_a))


def _phi(
    x: Float[Array, "*shape"], growth: Float[Array, "*shape"]
) -> tuple[Float[Array, "*shape"], ...]:
    r"""Computes $\varphi_k(-x)$, $k = 1, 2, 3$, from $x$ and its growth $e^{-x} - 1$.

    The recursion $\varphi_{k+1}(y) = (\varphi_k(y) - 1/k!) / y$ cancels for small arguments. There
    $\varphi_3$ is a series, and the others follow from it.
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
