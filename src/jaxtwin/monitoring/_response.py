"""How long a driven cell takes to show in the channels: a reading that stays at the room for longer
has gone."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._celsius import ZERO_CELSIUS
from .._compilation import persistent_jit_unoptimised
from .._jax_settings import own_settings
from ..observers import ExtendedKalmanFilter, stable_stepper
from ..simulation import Stepper, StepperState

# The step of the simulated rise, s.
STEP_SECONDS = 2.0

# The number of these steps.
COUNT = 600

# How near to the room a reading must be, as a part of what full duty reaches.
NEAR_ROOM_FRACTION = 0.1

# A rise that is larger than the threshold of nearness by this factor is clear.
CLEAR_RISE_MULTIPLE = 3.0

# A healthy rig takes at most this multiple of its twin's time.
SLOWER = 2.0


class Response(NamedTuple):
    """How a cell at full duty, up and down, shows in the channels.

    - `seconds`: the time after which it must show in a channel, s; infinite if it need not.
    - `near`: how near to the room a channel is then that does not show it, K.
    """

    seconds: Float[Array | np.ndarray, "2 cells channels"]
    near: Float[Array | np.ndarray, " channels"]


def response_of(observer: ExtendedKalmanFilter) -> Response:
    """The response of the observed rig, from rest."""
    model = observer.model
    stepper, step = stable_stepper(model.twin, STEP_SECONDS)
    cells = model.layout.heats
    duties = np.concatenate([np.eye(cells), -np.eye(cells)])
    lowest = np.array(model.twin.rig.lowest_duty)
    with own_settings():
        path = np.asarray(_risen(stepper, duties, round(COUNT * STEP_SECONDS / step)))
    rise = path[:, :, np.asarray(model.columns)]
    far = np.abs(rise[:cells]).max(axis=(0, 1))
    noise = float(np.asarray(model.noise.reading))
    near = np.maximum(
        NEAR_ROOM_FRACTION * far, 3 * noise + 2 * float(np.asarray(model.room_spread))
    )
    near = np.where(CLEAR_RISE_MULTIPLE * near < far, near, -1.0)
    clear = np.abs(rise) >= CLEAR_RISE_MULTIPLE * near
    seconds = SLOWER * step * _last_from(clear)
    can_cool = (lowest < 0)[:, None]
    down = np.where(can_cool, seconds[cells:], np.inf)
    both = np.stack([seconds[:cells], down])
    return Response(np.where(near > 0, both, np.inf), near)


def _last_from(
    clear: Bool[np.ndarray, "runs steps channels"],
) -> Float[np.ndarray, "runs channels"]:
    """The number of steps after which a rise is clear and remains so; infinite for never."""
    unclear = ~clear[:, ::-1]
    back = np.where(unclear.any(axis=1), unclear.argmax(axis=1), clear.shape[1])
    first = clear.shape[1] - back
    return np.where(back > 0, first + 1.0, np.inf)


@persistent_jit_unoptimised
def _risen(
    stepper: Stepper, duties: Float[Array | np.ndarray, "runs cells"], count: int
) -> Float[Array, "runs steps channels"]:
    """The rise of the channels above the room at constant duties, from rest."""
    room = stepper.reference - ZERO_CELSIUS

    def run(duty: Array) -> Array:
        def take(state: StepperState, _: None) -> tuple[StepperState, Array]:
            after = stepper.step(state, duty)
            return after, stepper.channels(after) - room

        return jax.lax.scan(take, stepper.start(room), None, length=count)[1]

    return jax.vmap(run)(jnp.asarray(duties))
