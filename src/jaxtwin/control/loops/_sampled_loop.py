r"""The loop of a sampled controller and a linear plant, exact at the sample times.

The plant under a held duty is that of `StateSpace.discretise`, with the driver's delay and lag;
the controller is the linearisation of its `step` about the steady state. With
$z = e^{j \omega h}$

$$L(z) = -G(z) K(z), \quad
K(z) = C_c (z I - A_c)^{-1} B_c + D_c, \quad M_s = \max_\omega \lVert (I + L)^{-1} \rVert$$

$K$ is the response of the duty to the outputs and contains the sign of the feedback, hence the
minus. What a controller only watches keeps its value of the steady state. The derivative of $M_s$
is that of the singular value at the frequency and in the draw where it is largest.
"""

import copy
from collections.abc import Mapping
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ..._compilation import persistent_jit_unoptimised
from ...physics import Twin
from ..controllers._controller import AbstractController
from ..controllers._design_vector import ControllerVector, DesignVector
from ..controllers._linear_controller import (
    Matrices,
    SteadyReadings,
    clip_away_from_limits,
    frequencies,
    linear_steps,
    response,
)
from ..linear._linearize import model_at_rest
from ..linear._operating_point import Target
from ..linear._zero_order_hold import zero_order_hold

# The distance from the unit circle that a pole may have by rounding. Two integrals of the same
# output keep their initial difference, which is a pole at 1.
ROUNDING = 1e-6


class SensitivityPeak(NamedTuple):
    """The sensitivity peak of a controller over all draws of the plant.

    - `value`: the largest $M_s$. `slope`: its derivatives with respect to the parameters.
    - `is_stable`: whether all loops are stable, which the value does not show.
    """

    value: float
    slope: Float[np.ndarray, " parameters"]
    is_stable: bool


@final
class SampledLoops:
    """The linear loops of a controller with a plant, or with draws of it, about a steady state.

    **Arguments:**

    - `twin`: the twin; parameters that are not drawn keep its values.
    - `draws`: name of a parameter -> values `(draws,)` in the unit of the rig's table; empty for
      the twin without draws.
    - `vector`: the map from the vector to the controller.
    - `weights`: the weights of the channels in the controller's outputs.
    - `outputs`: the outputs in the steady state, degC.
    - `longest_delay`: the longest delay of the driver in all draws, s.
    - `sensor_delay`: the delay of the readings, s.
    """

    def __init__(
        self,
        twin: Twin,
        draws: dict[str, Float[np.ndarray, " draws"]],
        vector: ControllerVector | DesignVector,
        weights: Float[np.ndarray, "outputs channels"],
        outputs: Float[np.ndarray, " outputs"],
        *,
        longest_delay: float,
        sensor_delay: float,
    ):
        interval = vector.controller.sample_time_s
        cells = len(twin.netlist.cells)
        directions = np.eye(cells) if len(outputs) >= cells else np.ones((cells, 1))
        if not draws:  # a single draw with the twin's value
            name, value = next(iter(twin.values.items()))
            draws = {name: np.array([float(value)])}
        shifts = int(np.ceil(longest_delay / interval * (1 - 1e-9)))
        target = Target(weights, outputs, directions, twin.wiring.lowest_duty)
        result = _sampled_plants(twin, draws, target, jnp.asarray(interval), shifts)
        matrices, duty, channels = jax.tree.map(np.asarray, result)
        self._plants: Matrices = matrices
        self._outputs, self._names = outputs, twin.channels
        self._at_rest = np.median(duty, axis=0), np.median(channels, axis=0)
        self.omega = frequencies(interval)
        self._interval, self._sensor_delay = interval, sensor_delay
        self._z = np.exp(1j * self.omega * interval)
        self._response = self._plant_response(self.omega)
        self._close(vector)

    def _close(self, vector: ControllerVector | DesignVector) -> None:
        """Linearises the controller where the plants rest."""
        duty, channels = self._at_rest
        watched = vector.controller.reading_weights(self._names)[len(self._outputs) :]
        self._vector = vector
        self._at = SteadyReadings(self._outputs, watched @ channels)
        self._duty = clip_away_from_limits(duty, vector.controller.limits)

    def with_controller(self, controller: AbstractController) -> "SampledLoops":
        """Returns the loops of another controller, of the same outputs and sample time, with the
        same plants, which take nearly all of the time."""
        loops = copy.copy(self)
        loops._close(ControllerVector(controller, ()))
        return loops

    def sensitivity(
        self, values: Float[np.ndarray, " parameters"]
    ) -> Float[np.ndarray, "draws frequency"]:
        r"""Computes $\lVert (I + L)^{-1} \rVert$ of each draw."""
        matrices, _ = self._controller(values)
        return 1 / _smallest(self._distance(response(matrices, self._z)))[0]

    def peak(self, values: Float[np.ndarray, " parameters"]) -> SensitivityPeak:
        """Computes the sensitivity peak of a controller with given parameters."""
        matrices, slopes = self._controller(values)
        distance = self._distance(response(matrices, self._z))
        smallest, left, right = _smallest(distance)
        draw, frequency = np.unravel_index(np.argmin(smallest), smallest.shape)
        at = self._z[frequency]
        by_parameters = _response_slopes(matrices, slopes, at)
        moved = -np.einsum("oc,cip->oip", self._response[draw, frequency], by_parameters)
        u, v = left[draw, frequency], right[draw, frequency]
        change = np.real(np.einsum("o,oip,i->p", u.conj(), moved, v))
        value = 1 / float(smallest[draw, frequency])
        return SensitivityPeak(value, -change * value**2, self._is_stable(matrices))

    def loop(
        self, omega: Float[np.ndarray, " frequency"]
    ) -> Complex[np.ndarray, "draws frequency outputs outputs"]:
        """Computes the response of the loop, plant times controller without the minus sign of the
        feedback, with the controller as it is."""
        controller = self._linear(self._vector.controller)
        z = np.exp(1j * omega * self._interval)
        return -self._plant_response(omega) @ response(controller, z)

    def _plant_response(
        self, omega: Float[np.ndarray, " frequency"]
    ) -> Complex[np.ndarray, "draws frequency outputs cells"]:
        late = np.exp(-1j * omega * self._sensor_delay)
        return response(self._plants, np.exp(1j * omega * self._interval)) * late[:, None, None]

    def _linear(self, controller: AbstractController) -> Matrices:
        return jax.tree.map(np.asarray, linear_steps(controller, self._duty, self._at))

    def _controller(self, values: np.ndarray) -> tuple[Matrices, Matrices]:
        vector = self._vector
        if isinstance(vector, ControllerVector):
            result = _linear_controller(*vector, values, self._duty, self._at)
            return jax.tree.map(np.asarray, result)
        # The controllers of designs have no exact derivatives of their derivatives.
        beside = vector.neighbours(values)

        def change(pair: tuple[AbstractController, AbstractController], apart: float) -> Matrices:
            more, less = (self._linear(abstract_controller) for abstract_controller in pair)
            return jax.tree.map(lambda a, b: (a - b) / apart, more, less)

        changes = map(change, beside.controllers, beside.apart)
        slopes = jax.tree.map(lambda *parts: np.stack(parts, axis=-1), *changes)
        return self._linear(vector.controller_at(values)), slopes

    def _distance(
        self, controller: Complex[np.ndarray, "frequency cells outputs"]
    ) -> Complex[np.ndarray, "draws frequency outputs outputs"]:
        return np.eye(len(self._at.outputs)) - self._response @ controller

    def _is_stable(self, controller: Matrices) -> bool:
        """Whether all poles of the closed loops are inside the unit circle."""
        return bool(self._radius(controller) < 1 + ROUNDING)

    def peaks(self) -> Float[np.ndarray, " draws"]:
        """Computes the sensitivity peak of each draw, with the controller as it is."""
        distance = self._distance(response(self._linear(self._vector.controller), self._z))
        return 1 / np.linalg.svd(distance, compute_uv=False)[..., -1].min(axis=1)

    def growth(self) -> float:
        """Computes the factor by which deviations from the steady state grow in a sample: the
        largest absolute value of a pole of the closed loops. A loop is stable up to `1 +
        ROUNDING`."""
        return self._radius(self._linear(self._vector.controller))

    def _radius(self, controller: Matrices) -> float:
        (A, B, C, D), (Ac, Bc, Cc, Dc) = self._plants, controller
        # u = Cc xc + Dc y and y = C x + D u; the delay of the readings is neglected.
        unit = np.eye(B.shape[-1])
        inner = np.linalg.inv(unit - Dc @ D)
        by_plant, by_controller = inner @ Dc @ C, inner @ Cc
        y_plant, y_controller = C + D @ by_plant, D @ by_controller
        top = np.concatenate([A + B @ by_plant, B @ by_controller], axis=-1)
        bottom = np.concatenate([Bc @ y_plant, Ac + Bc @ y_controller], axis=-1)
        poles = np.linalg.eigvals(np.concatenate([top, bottom], axis=-2))
        return float(np.abs(poles).max())


@persistent_jit_unoptimised
def _sampled_plants(
    twin: Twin,
    draws: Mapping[str, Float[Array | np.ndarray, " draws"]],
    target: Target,
    interval: Float[Array, ""],
    shifts: int,
) -> tuple[tuple[Any, ...], Float[Array, "draws cells"], Float[Array, "draws channels"]]:
    """Computes the discrete plants from duty to outputs, with their duty and their channels at
    rest."""

    def of_draw(
        values: Mapping[str, Array],
    ) -> tuple[tuple[Any, ...], Float[Array, " cells"], Float[Array, " channels"]]:
        model, _, _ = model_at_rest(twin.with_values(values), None, target, None)
        weights = jnp.asarray(target.channels)
        matrices = model.A, model.B, weights @ model.C, weights @ model.D
        lag = model.lag_s if model.is_lagged else None
        plant = zero_order_hold(matrices, model.delay_s, lag, interval, shifts)
        point = model.operating_point
        return plant, jnp.asarray(point.duty), jnp.asarray(point.outputs)

    return jax.vmap(of_draw)({name: jnp.asarray(values) for name, values in draws.items()})


@persistent_jit_unoptimised
def _linear_controller(
    controller: AbstractController,
    shapes: tuple[tuple[str, tuple[int, ...]], ...],
    values: Float[Array | np.ndarray, " parameters"],
    duty: Float[Array | np.ndarray, " cells"],
    at: SteadyReadings,
) -> tuple[tuple[Array, Array, Array, Array], tuple[Array, Array, Array, Array]]:
    """Computes Ac, Bc, Cc and Dc from outputs to duty about the steady state, and their
    derivatives with respect to the parameters, which have a last axis."""

    def matrices(values: Array) -> tuple[Array, Array, Array, Array]:
        return linear_steps(ControllerVector(controller, shapes).apply(values), duty, at)

    return matrices(jnp.asarray(values)), jax.jacfwd(matrices)(jnp.asarray(values))


def _response_slopes(
    matrices: Matrices, slopes: Matrices, z: complex
) -> Complex[np.ndarray, "outputs inputs parameters"]:
    """Computes the derivatives of a frequency response at one frequency."""
    A, B, C, _ = matrices
    dA, dB, dC, dD = slopes
    inverse = np.linalg.inv(z * np.eye(len(A)) - A)
    states, gains = inverse @ B, C @ inverse
    return (
        np.einsum("osp,si->oip", dC, states)
        + np.einsum("os,stp,ti->oip", gains, dA, states)
        + np.einsum("os,sip->oip", gains, dB)
        + dD
    )


def _smallest(
    matrix: Complex[np.ndarray, "*shape n n"],
) -> tuple[
    Float[np.ndarray, "*shape"], Complex[np.ndarray, "*shape n"], Complex[np.ndarray, "*shape n"]
]:
    """Computes the smallest singular value with its left and right singular vectors."""
    if matrix.shape[-1] == 1:
        value = np.abs(matrix[..., 0, 0])
        return value, matrix[..., 0] / value[..., None], np.ones_like(matrix[..., 0])
    left, values, right = np.linalg.svd(matrix)
    return values[..., -1], left[..., -1], right[..., -1, :].conj()
