"""Checks before a closed loop is run: whether the controller is one for the cells of the rig,
whether the rig can hold the references, and whether the sample time is short enough."""

from itertools import chain, islice, product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._compilation import persistent_jit_unoptimised
from ...errors import ControlError
from ...physics import System
from ...rig import Rig
from ...simulation import network_modes
from ..controllers._controller import AbstractChannelGroupController, AbstractController, DutyLimits
from ..controllers._duty_limits import bounds_of, check_limits_of_heaters
from ..controllers._function_controller import FunctionController
from ._references import representative_samples

# The equal duty cycles that are tried, because a cell cools best with less than full duty.
DUTY_LEVELS = 17

# The largest excess of a reference over the reachable range that counts as rounding, K.
REACH_TOLERANCE = 1e-6

# The largest distance of several outputs from their references at the same time, K.
JOINT_TOLERANCE = 0.1

# The errors of JAX for Python that needs the number of a traced array.
_NEED_NUMBERS = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
)

# The largest number of starts of the search for the duty that holds several outputs.
SEARCH_STARTS = 64


class OutOfReachError(ControlError):
    """No duty within the limits of the controller can hold the references."""


def check_reach(
    system: System,
    weights: Float[np.ndarray, "outputs channels"],
    reference: Float[np.ndarray, "samples outputs"],
    times: Float[np.ndarray, " samples"],
    ambient: Float[np.ndarray, "rows substeps"],
    limits: DutyLimits,
) -> None:
    """Refuses references that the duty cannot hold at rest within the controller's limits.

    Each output by itself must be within the range of equal duty cycles of all cells. Several
    outputs, at most as many as there are cells, must also be reached at the same time; of many
    references, the lowest, the highest and some between them are checked.

    **Arguments:**

    - `limits`: the lowest and the highest duty of the controller, for each cell and heater if they
      differ.

    **Raises:** `OutOfReachError` that names the reference, its time, the limits and the reachable
    range.
    """
    low, high = _bounds_of_cells(system, limits)
    levels = np.linspace(low.min(), high.max(), DUTY_LEVELS)
    equal = np.clip(levels[:, None], low, high)
    reached = weights @ np.asarray(_steady_rises(system, equal)).T
    lowest = reached.min(axis=1) + float(ambient.min())
    highest = reached.max(axis=1) + float(ambient.max())
    held_by = f"a duty of {low.min():g} to {high.max():g}"
    wrong = (reference < lowest - REACH_TOLERANCE) | (reference > highest + REACH_TOLERANCE)
    if wrong.any():
        sample, output = np.argwhere(wrong)[0]
        raise OutOfReachError(
            f"references: expected {lowest[output]:.1f} to {highest[output]:.1f} degC, which "
            f"{held_by} can hold, got {reference[sample, output]:.1f} degC at {times[sample]:g} s"
        )
    if not 1 < len(weights) <= len(system.wiring.cold):
        return
    middle, ambient_range = (ambient.min() + ambient.max()) / 2, np.ptp(ambient)
    for sample in representative_samples(reference):
        aim = reference[sample] - middle
        start = equal[np.argmin(np.abs(reached - aim[:, None]).max(axis=0))]
        nearest = weights @ _rises(system, _nearest(system, weights, aim, start, limits))
        if np.abs(nearest - aim).max() > JOINT_TOLERANCE + ambient_range:
            wanted, result = (
                "/".join(f"{value:.4g}" for value in values + middle) for values in (aim, nearest)
            )
            raise OutOfReachError(
                f"references: expected temperatures that {held_by} can hold at the same time, got "
                f"{wanted} degC at {times[sample]:g} s; the nearest are {result} degC"
            )


def check_cells(where: str, controller: AbstractController, rig: Rig, outputs: int) -> None:
    """Refuses a controller that does not command as many cells and heaters as the rig has, or that
    cools with heaters alone.

    **Raises:** `ControlError` that says what the controller commands.
    """
    cells = len(rig.driven)
    # A function has no limits of its own. In a rig that has cells too, a heater's part of a
    # negative duty is 0.
    if not rig.cells and not isinstance(controller, FunctionController):
        check_limits_of_heaters(f"{where}: controller", controller.limits, rig)
    preview = (controller.preview_samples,) if controller.preview_samples else ()
    channels = [channel.name for channel in rig.channels]
    readings = len(controller.reading_weights(channels)) + controller.reads_room

    def commanded() -> Array | None:
        measurement = jnp.zeros(readings)
        state = controller.init(jnp.zeros(cells), measurement)
        return controller.step(state, jnp.zeros((*preview, outputs)), measurement)[0]

    expected = (
        f"{where}: controller: expected the duty of {cells} {'cells' if cells > 1 else 'cell'}"
    )
    try:
        duty = jax.eval_shape(commanded)
    except _NEED_NUMBERS as problem:
        raise ControlError(
            f"{where}: controller: expected a function of arrays that JAX can trace, got Python's "
            "if, while, float() or NumPy on temperatures or times in it; use jnp.where(condition, "
            "duty, other), jnp.clip and functions of jax.numpy"
        ) from problem
    except (TypeError, ValueError) as problem:
        # The error may come from a function of the user and have any cause.
        if not isinstance(controller, AbstractChannelGroupController):
            raise
        raise ControlError(
            f"{expected}, got a {type(controller).__name__} whose gains do not fit; "
            "give one output for all cells, or an output and a gain for each cell"
        ) from problem
    shape = getattr(duty, "shape", None)
    if shape != (cells,):
        got = "None" if shape is None else f"an array of shape {shape}"
        raise ControlError(
            f"{expected}, got {got} from {type(controller).__name__}, which "
            f"has {outputs} {'outputs' if outputs > 1 else 'output'}"
        )


def check_sample_time(system: System, sample_time_s: float) -> None:
    """Refuses a controller whose sample time is longer than the slowest time constant of the rig.

    **Raises:** `ControlError`.
    """
    if sample_time_s <= float(_lumped_time_constant(system)):
        return
    slowest = float(slowest_time_constant(system))
    if sample_time_s > slowest:
        raise ControlError(
            f"sample_time_s: expected at most the rig's longest time constant, {slowest:.0f} s (a "
            f"tenth of it is usual), got {sample_time_s:g} s"
        )


def _nearest(
    system: System,
    weights: Float[np.ndarray, "outputs channels"],
    aim: Float[np.ndarray, " outputs"],
    start: Float[np.ndarray, " cells"],
    limits: DutyLimits,
) -> Float[np.ndarray, " cells"]:
    """Computes the duty whose steady rises of the outputs are nearest to an aim, K.

    A small cooling duty may warm the plate, so that a search can end at a duty of 0 although more
    cooling would be nearer. It therefore starts at several places.
    """

    def off(duty: Float[np.ndarray, " cells"]) -> Any:
        return weights @ _rises(system, duty) - aim

    from scipy.optimize import least_squares

    low, high = _bounds_of_cells(system, limits)
    places = np.quantile([low, high], [0.98, 0.02, 0.75, 0.25], axis=0)
    others = islice(product(*places.T), SEARCH_STARTS)
    best, least = low, np.inf
    for begin in chain([start], others):
        optimum = least_squares(off, begin, bounds=(low, high), diff_step=1e-4)
        if np.abs(optimum.fun).max() < least:
            best, least = optimum.x, np.abs(optimum.fun).max()
        if least <= JOINT_TOLERANCE:
            break
    return best


def _bounds_of_cells(
    system: System, limits: DutyLimits
) -> tuple[Float[np.ndarray, " cells"], Float[np.ndarray, " cells"]]:
    """The lowest and the highest duty of each cell and heater."""
    lowest, highest = bounds_of(limits)
    low = np.maximum(lowest, system.wiring.lowest_duty)
    return low, np.broadcast_to(highest, low.shape)


def _rises(system: System, duty: Float[np.ndarray, " cells"]) -> Float[np.ndarray, " channels"]:
    """The steady rises of the channels with a duty, K."""
    return np.asarray(_steady_rises(system, duty[None]))[0]


@persistent_jit_unoptimised
def _steady_rises(
    system: System, duty: Float[Array | np.ndarray, "points cells"]
) -> Float[Array, "points channels"]:
    """Computes the steady rises of the channels above the surroundings, K."""
    reference = jnp.asarray(system.ambient_temperature)

    def rises(duty: Float[Array, " cells"]) -> Float[Array, " channels"]:
        return system.channel_temperatures(system.steady_state(duty, reference))

    return jax.vmap(rises)(jnp.asarray(duty, reference.dtype))


@persistent_jit_unoptimised
def _lumped_time_constant(system: System) -> Float[Array, ""]:
    """Computes the time constant of the rig as one lump, s: Rayleigh's quotient of a uniform rise,
    which is at most the slowest time constant. It needs no eigenproblem."""
    reference = jnp.asarray(system.ambient_temperature)
    idle = jnp.zeros(len(system.wiring.cold), reference.dtype)

    def heat(deviation: Float[Array, " nodes"]) -> Float[Array, " nodes"]:
        return system.heat_into_nodes(deviation, idle, reference)

    capacitance = jnp.asarray(system.capacitance)
    ones = jnp.ones_like(capacitance)
    _, slope = jax.jvp(heat, (jnp.zeros_like(ones),), (ones,))
    return jnp.sum(capacitance) / -jnp.sum(slope)


@persistent_jit_unoptimised
def slowest_time_constant(system: System) -> Float[Array, ""]:
    """Computes the slowest time constant of the rig, s."""
    return 1 / network_modes(system, None, jnp.asarray(system.ambient_temperature)).rates[0]
