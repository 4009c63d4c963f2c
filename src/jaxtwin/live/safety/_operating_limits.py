"""Limits of a rig and of plausible readings: those of the rig file, with defaults from physics."""

import math
from dataclasses import dataclass
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..._celsius import ZERO_CELSIUS
from ..._compilation import persistent_jit_unoptimised
from ...errors import JaxtwinError
from ...physics import Twin
from ...simulation import Stepper, StepperState

# The lowest temperature that a module of a single stage reaches, degC.
MIN_MODULE_DEGC = -73.0

# The limit of a reading's rate divided by the fastest change of the twin: contacts may be better
# than the rig file says.
RATE_FACTOR = 3.0

# The steps of the twin in a second, while its fastest change is found.
PROBES_PER_SECOND = 10

# Time for which the twin is driven to find its fastest change, s.
PROBE_SECONDS = 120

_CAMERA_JUMP = 4.0  # K; a recalibration moves all of an uncooled camera's readings by up to 2 K
_COMMAND_DELAY = 1.0
_DEVIATION = 10.0
_FROZEN_CAMERA = 5.0  # s at full duty; a mean of many noisy pixels is never twice the same
_FROZEN_SENSOR = 15.0  # s at full duty; a sensor's steps may be as coarse as 0.25 K

# The largest difference between the room and that of the rig file, K.
MAX_ROOM_DIFFERENCE_KELVIN = 30.0


@final
@dataclass(frozen=True)
class OperatingLimits:
    """All limits of a rig as numbers, temperatures in degC.

    **Arguments:**

    - `hottest`, `lowest`: the limits of a reading.
    - `cell`: the limit of a cell's sides in the twin; infinite for heaters, unless the file states
      one.
    - `rate`: the fastest change of a reading, K/s in the time of the rig.
    - `jump`: largest change at once, by noise and recalibrations of a camera, K.
    - `frozen`: longest time at full duty, or its multiple at a lower one, for which a reading may
      stay the same, s of the rig.
    - `deviation`: the largest deviation of a reading from the twin, in addition to half of its
      rise, K.
    - `command_delay`: longest time until a command is applied, s.
    - `room`: the ambient temperature in the rig file, from which a measured one cannot differ much.
    """

    hottest: float
    lowest: float
    cell: float
    rate: float
    jump: float
    frozen: float
    deviation: float
    command_delay: float
    room: float

    @classmethod
    def of(cls, twin: Twin) -> "OperatingLimits":
        """Returns the limits of a twin's rig.

        **Raises:** `JaxtwinError` if its file states no limit of temperature.
        """
        rig = twin.rig
        given = rig.limits
        if given is None:
            raise JaxtwinError(
                f"{rig.source}: limits.temperature: expected the temperature at which the cells "
                'are switched off, such as "90 degC", got none; a rig is not driven without it'
            )
        room = float(rig.ambient_temperature.evaluate(twin.numbers_si)) - ZERO_CELSIUS
        lowest = _lowest(twin, room) if given.lowest is None else given.lowest - ZERO_CELSIUS
        # A reading without any noise may stay the same.
        frozen = _FROZEN_CAMERA if rig.camera is not None else _FROZEN_SENSOR
        frozen = frozen if rig.noise > 0 else math.inf
        return cls(
            hottest=given.temperature - ZERO_CELSIUS,
            lowest=lowest,
            cell=min(rig.maximum_side_temperatures, default=math.inf) - ZERO_CELSIUS,
            rate=_rate(twin) if given.rate is None else given.rate,
            jump=6 * rig.noise + (0.0 if rig.camera is None else _CAMERA_JUMP),
            frozen=frozen if given.frozen is None else given.frozen,
            deviation=_DEVIATION if given.deviation is None else given.deviation,
            command_delay=_COMMAND_DELAY if given.command_delay is None else given.command_delay,
            room=room,
        )


def _lowest(twin: Twin, room: float) -> float:
    r"""The lowest temperature of a cell's cold side, $T_h - \frac12 Z T_c^2$, in a room that is
    colder than the rig file says.

    A rig of heaters alone cannot cool: the result is the temperature of that colder room.
    """
    hot = room - MAX_ROOM_DIFFERENCE_KELVIN + ZERO_CELSIUS
    coldest = hot - ZERO_CELSIUS
    for cell in twin.rig.cells:
        module = twin.module(cell.name)
        seebeck, resistance = module.seebeck_coefficient, module.electrical_resistance
        merit = _number(seebeck) ** 2 * _number(module.thermal_resistance) / _number(resistance)
        coldest = min(coldest, 2 * hot / (1 + math.sqrt(1 + 2 * merit * hot)) - ZERO_CELSIUS)
    return max(coldest, MIN_MODULE_DEGC)


def _number(value: ArrayLike) -> float:
    return np.asarray(value).item()


def _rate(twin: Twin) -> float:
    with jax.enable_x64(True):
        return float(_fastest(Stepper(twin, 1 / PROBES_PER_SECOND)))


@persistent_jit_unoptimised
def _fastest(stepper: Stepper) -> Float[Array, ""]:
    """`RATE_FACTOR` times the fastest change of any reading, K/s, while the twin is heated at full
    duty, then driven at its lowest duty, then heated again."""
    lowest = stepper.system.wiring.lowest_duty
    duties = jnp.repeat(
        jnp.array([jnp.ones_like(lowest), lowest, jnp.ones_like(lowest)]), PROBE_SECONDS, axis=0
    )

    def second(state: StepperState, duty: Array) -> tuple[StepperState, Array]:
        state = stepper.step(state, duty, steps=PROBES_PER_SECOND)
        return state, stepper.channels(state)

    start = stepper.start()
    _, after = jax.lax.scan(second, start, duties)
    readings = jnp.concatenate([stepper.channels(start)[None], after])
    return RATE_FACTOR * jnp.abs(jnp.diff(readings, axis=0)).max()
