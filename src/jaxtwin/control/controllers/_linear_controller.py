"""A controller as a linear system about a steady state, and its margins on the model of its
design."""

from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Complex, Float

from ..._compilation import persistent_jit_unoptimised
from ..._jax_settings import own_settings
from ..linear._margins import USUAL_PEAK, disk_margin, margins_text, sensitivity_peak
from ._controller import AbstractController, DutyLimits
from ._duty_limits import bounds_of
from ._lqi import LQI
from ._mpc import MPC

# The lowest frequency that is evaluated, rad/s.
MIN_OMEGA = 1e-4

# The number of frequencies up to half the sample rate, in equal ratios: 4 % apart at a sample time
# of 1 s.
FREQUENCIES = 160

# The smallest distance of the duty at rest from the limits, relative to their width, so that the
# controller is linear there.
DISTANCE_FROM_LIMITS = 0.02

Matrix: TypeAlias = Float[np.ndarray, "..."]

# A, B, C and D. Matrices of draws have a leading axis; derivatives have a last axis for parameters.
Matrices: TypeAlias = tuple[Matrix, Matrix, Matrix, Matrix]


class SteadyReadings(NamedTuple):
    """What a controller reads in the steady state: its outputs, and what it watches, degC."""

    outputs: Float[Array | np.ndarray, " outputs"]
    watched: Float[Array | np.ndarray, " watched"]


@persistent_jit_unoptimised
def linear_steps(
    controller: AbstractController,
    duty: Float[Array | np.ndarray, " cells"],
    at: SteadyReadings,
) -> tuple[Array, Array, Array, Array]:
    """Computes Ac, Bc, Cc and Dc from outputs to duty about the steady state."""
    rest, unravel = ravel_pytree(controller.init(duty, jnp.concatenate(at)))
    outputs = jnp.asarray(at.outputs)
    ahead = controller.preview_samples
    references = jnp.tile(outputs, (ahead, 1)) if ahead else outputs

    def step(state: Array, read: Array) -> tuple[Array, Array]:
        measurement = jnp.concatenate([read, jnp.asarray(at.watched)])
        asked, later = controller.step(unravel(state), references, measurement)
        return ravel_pytree(later)[0], asked

    (A, B), (C, D) = jax.jacfwd(step, (0, 1))(rest, outputs)
    return A, B, C, D


def response(
    matrices: Matrices, z: Complex[np.ndarray, " frequency"]
) -> Complex[np.ndarray, "*draws frequency outputs inputs"]:
    """Computes the frequency response of discrete matrices."""
    A, B, C, D = (matrix[..., None, :, :] for matrix in matrices)
    moved = np.linalg.solve(z[:, None, None] * np.eye(A.shape[-1]) - A, B)
    return C @ moved + D


def frequencies(interval: float) -> Float[np.ndarray, " frequency"]:
    """The frequencies at which loops with a sample time are evaluated, rad/s."""
    return np.geomspace(MIN_OMEGA, np.pi / interval, FREQUENCIES)


def clip_away_from_limits(
    duty: Float[Array | np.ndarray, " cells"], limits: DutyLimits
) -> Float[np.ndarray, " cells"]:
    """A duty so far from the limits that a controller is linear there."""
    low, high = bounds_of(limits)
    distance = DISTANCE_FROM_LIMITS * (high - low)
    return np.clip(np.asarray(duty), low + distance, high - distance)


def design_summary(controller: AbstractController) -> tuple[str, bool] | None:
    """Says how far from instability the loop of an `LQI` or an `MPC` is on its own model, at its
    operating point, and whether it is fragile; None for other controllers, and for an `MPC` that is
    not linear."""
    if not (isinstance(controller, LQI | MPC) and controller.is_linear):
        return None
    if isinstance(controller, MPC) and controller.points is not None:
        return None
    at_watched = controller.watched.at if isinstance(controller, MPC) else np.zeros(0)
    at = SteadyReadings(np.asarray(controller.outputs), np.asarray(at_watched))
    duty = clip_away_from_limits(controller.duty, controller.limits)
    with own_settings():
        result: Any = jax.tree.map(np.asarray, linear_steps(controller, duty, at))

    def loop(omega: Float[np.ndarray, " frequency"]) -> Complex[np.ndarray, "frequency n n"]:
        z = np.exp(1j * omega * controller.sample_time_s)
        return -np.asarray(controller.model.frequency_response(omega)) @ response(result, z)

    omega = frequencies(controller.sample_time_s)
    peak, at_omega = sensitivity_peak(loop, omega=omega)
    return margins_text(peak, at_omega, disk_margin(loop, omega=omega)), peak > USUAL_PEAK
