r"""The loop that a sampled controller closes about a linear plant, at sample times and exact there.

The plant under a held duty is that of `LinearModel.discretise`, with the driver's delay and lag;
the controller is its own step, linear about its rest. With $z = e^{j \omega h}$

$$L(z) = -G(z) K(z), \quad
K(z) = C_c (z I - A_c)^{-1} B_c + D_c, \quad M_s = \max_\omega \lVert (I + L)^{-1} \rVert$$

The minus sign is that of the feedback, which $K$ has in it: it is the response of the duty to the
measurement. The derivative of $M_s$ is that of the singular value at the frequency, and in the
draw, where it is largest.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Complex, Float

from .._compilation import persistent_jit
from ..physics import Twin
from ._controller import AbstractController
from ._controller_vector import ControllerVector
from ._hold import held
from ._linearize import _linearized
from ._operating_point import Target
from ._references import references_ahead

LOWEST = 1e-4
"""Of the frequencies that are looked at, rad/s."""

FREQUENCIES = 160
"""Up to that of half the sample rate, in equal ratios: 4 % apart at a sample time of 1 s."""

ROUNDING = 1e-6
"""How far outside the unit circle a pole may lie by rounding. Two integrals that follow the same
output differ by what they differed by at the start: a pole at 1 that nothing moves."""

INSIDE = 0.02
"""Of the width of the limits: the duty at rest is at least so far inside, where the controller is
linear."""

Matrix: TypeAlias = Float[np.ndarray, "..."]

Matrices: TypeAlias = tuple[Matrix, Matrix, Matrix, Matrix]
"""A, B, C and D; those of draws have a leading axis, derivatives a last one for the parameters."""


class SensitivityPeak(NamedTuple):
    """Of a controller, over all draws of the plant.

    - `value`: the largest $M_s$. `slope`: its derivatives by the parameters.
    - `is_stable`: whether all loops are, to which the value says nothing.
    """

    value: float
    slope: Float[np.ndarray, " parameters"]
    is_stable: bool


@final
class SampledLoops:
    """A plant, or draws of it, about the rest at some outputs.

    **Arguments:**

    - `twin`: whose other parameters hold. `draws`: name -> values `(draws,)`, in the unit of the
      rig's table; none for the twin alone.
    - `vector`: of the parameters that change the controller.
    - `weights`: of the channels in the controller's outputs.
    - `outputs`: at rest, degC.
    - `longest_delay_s`: of the driver in all draws. `sensor_delay_s`: of the readings.
    """

    def __init__(
        self,
        twin: Twin,
        draws: dict[str, Float[np.ndarray, " draws"]],
        vector: ControllerVector,
        weights: Float[np.ndarray, "outputs channels"],
        outputs: Float[np.ndarray, " outputs"],
        *,
        longest_delay_s: float,
        sensor_delay_s: float,
    ):
        self._vector, self._outputs = vector, outputs
        interval = vector.controller.sample_time_s
        cells = len(twin.netlist.cells)
        directions = np.eye(cells) if len(outputs) >= cells else np.ones((cells, 1))
        if not draws:  # a single draw of what it is anyway
            name, value = next(iter(twin.parameters.items()))
            draws = {name: np.array([float(value)])}
        shifts = int(np.ceil(longest_delay_s / interval * (1 - 1e-9)))
        found = _sampled_plants(
            twin, draws, Target(weights, outputs, directions), jnp.asarray(interval), shifts
        )
        matrices, duty = jax.tree.map(np.asarray, found)
        self._plants: Matrices = matrices
        self.omega = np.geomspace(LOWEST, np.pi / interval, FREQUENCIES)
        self._z = np.exp(1j * self.omega * interval)
        late = np.exp(-1j * self.omega * sensor_delay_s)
        self._response = _response(matrices, self._z) * late[:, None, None]
        low, high = getattr(vector.controller, "limits", (-1.0, 1.0))
        inside = INSIDE * (high - low)
        self._duty = np.clip(np.median(duty, axis=0), low + inside, high - inside)

    def sensitivity(
        self, values: Float[np.ndarray, " parameters"]
    ) -> Float[np.ndarray, "draws frequency"]:
        r"""$\lVert (I + L)^{-1} \rVert$ of each draw."""
        matrices, _ = self._controller(values)
        return 1 / _smallest(self._distance(_response(matrices, self._z)))[0]

    def peak(self, values: Float[np.ndarray, " parameters"]) -> SensitivityPeak:
        """The largest sensitivity of a controller with these parameters."""
        matrices, slopes = self._controller(values)
        distance = self._distance(_response(matrices, self._z))
        smallest, left, right = _smallest(distance)
        draw, frequency = np.unravel_index(np.argmin(smallest), smallest.shape)
        at = self._z[frequency]
        by_parameters = _response_slopes(matrices, slopes, at)
        moved = -np.einsum("oc,cip->oip", self._response[draw, frequency], by_parameters)
        u, v = left[draw, frequency], right[draw, frequency]
        change = np.real(np.einsum("o,oip,i->p", u.conj(), moved, v))
        value = 1 / float(smallest[draw, frequency])
        return SensitivityPeak(value, -change * value**2, self._is_stable(matrices))

    def _controller(self, values: np.ndarray) -> tuple[Matrices, Matrices]:
        vector = self._vector
        found = _linear_controller(
            vector.controller, vector.shapes, values, self._duty, self._outputs
        )
        return jax.tree.map(np.asarray, found)

    def _distance(
        self, controller: Complex[np.ndarray, "frequency cells outputs"]
    ) -> Complex[np.ndarray, "draws frequency outputs outputs"]:
        return np.eye(len(self._outputs)) - self._response @ controller

    def _is_stable(self, controller: Matrices) -> bool:
        """Whether all poles of the closed loops lie inside the unit circle."""
        return bool(self._radius(controller) < 1 + ROUNDING)

    def growth(self) -> float:
        """By how much deviations from the rest grow in a sample, with the controller as it is: the
        largest size of a pole of the closed loops; up to `1 + ROUNDING` they do not."""
        controller = _linear_steps(self._vector.controller, self._duty, self._outputs)
        return self._radius(jax.tree.map(np.asarray, controller))

    def _radius(self, controller: Matrices) -> float:
        (A, B, C, D), (Ac, Bc, Cc, Dc) = self._plants, controller
        # u = Cc xc + Dc y and y = C x + D u; the readings' own delay is left out.
        unit = np.eye(B.shape[-1])
        inner = np.linalg.inv(unit - Dc @ D)
        by_plant, by_controller = inner @ Dc @ C, inner @ Cc
        y_plant, y_controller = C + D @ by_plant, D @ by_controller
        top = np.concatenate([A + B @ by_plant, B @ by_controller], axis=-1)
        bottom = np.concatenate([Bc @ y_plant, Ac + Bc @ y_controller], axis=-1)
        poles = np.linalg.eigvals(np.concatenate([top, bottom], axis=-2))
        return float(np.abs(poles).max())


@persistent_jit
def _sampled_plants(
    twin: Twin,
    draws: Mapping[str, Float[Array | np.ndarray, " draws"]],
    target: Target,
    interval: Float[Array, ""],
    shifts: int,
) -> tuple[tuple[Any, ...], Float[Array | np.ndarray, "draws cells"]]:
    """The discrete plants from duty to outputs, and their duty at rest."""

    def of_draw(
        values: Mapping[str, Array],
    ) -> tuple[tuple[Any, ...], Float[Array | np.ndarray, " cells"]]:
        model, _, _ = _linearized(twin.with_parameters(values), None, target, None)
        weights = jnp.asarray(target.channels)
        matrices = model.A, model.B, weights @ model.C, weights @ model.D
        lag = model.lag_s if model.is_lagged else None
        return held(matrices, model.delay_s, lag, interval, shifts), model.operating_point.duty

    return jax.vmap(of_draw)({name: jnp.asarray(values) for name, values in draws.items()})


@persistent_jit
def _linear_controller(
    controller: AbstractController,
    shapes: tuple[tuple[str, tuple[int, ...]], ...],
    values: Float[Array | np.ndarray, " parameters"],
    duty: Float[Array | np.ndarray, " cells"],
    outputs: Float[Array | np.ndarray, " outputs"],
) -> tuple[tuple[Array, Array, Array, Array], tuple[Array, Array, Array, Array]]:
    """Ac, Bc, Cc and Dc from measurement to duty about the rest, and their derivatives by the
    parameters, which are the last axis."""

    def matrices(values: Array) -> tuple[Array, Array, Array, Array]:
        return _linear_steps(ControllerVector(controller, shapes).apply(values), duty, outputs)

    return matrices(jnp.asarray(values)), jax.jacfwd(matrices)(jnp.asarray(values))


@persistent_jit
def _linear_steps(
    controller: AbstractController,
    duty: Float[Array | np.ndarray, " cells"],
    outputs: Float[Array | np.ndarray, " outputs"],
) -> tuple[Array, Array, Array, Array]:
    """Ac, Bc, Cc and Dc from measurement to duty about the rest."""
    rest, unravel = ravel_pytree(controller.init(duty, outputs))
    (references,) = references_ahead(jnp.asarray(outputs)[None], controller.preview_samples)

    def step(state: Array, measurement: Array) -> tuple[Array, Array]:
        asked, later = controller.step(unravel(state), references, measurement)
        return ravel_pytree(later)[0], asked

    (A, B), (C, D) = jax.jacfwd(step, (0, 1))(rest, jnp.asarray(outputs))
    return A, B, C, D


def _response(
    matrices: Matrices, z: Complex[np.ndarray, " frequency"]
) -> Complex[np.ndarray, "*draws frequency outputs inputs"]:
    A, B, C, D = (matrix[..., None, :, :] for matrix in matrices)
    moved = np.linalg.solve(z[:, None, None] * np.eye(A.shape[-1]) - A, B)
    return C @ moved + D


def _response_slopes(
    matrices: Matrices, slopes: Matrices, z: complex
) -> Complex[np.ndarray, "outputs inputs parameters"]:
    """The derivatives of a response at a frequency."""
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
    """The smallest singular value, and its vectors on the left and on the right."""
    if matrix.shape[-1] == 1:
        value = np.abs(matrix[..., 0, 0])
        return value, matrix[..., 0] / value[..., None], np.ones_like(matrix[..., 0])
    left, values, right = np.linalg.svd(matrix)
    return values[..., -1], left[..., -1], right[..., -1, :].conj()
