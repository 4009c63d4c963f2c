"""What an observer says of a rig now, and what it expects of the next minute."""

from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._celsius import ZERO_CELSIUS
from .._compilation import persistent_jit
from .._jax_settings import own_settings
from ..observers import ExtendedKalmanFilter, KalmanState
from ..observers._filter_run import FilterSamples, samples_between
from ..observers._moments import Moment, Moments, moments

# The length of the forecast, s of the rig.
HORIZON = 60.0

# The number of times in it.
STEPS = 12


@final
class Outlook(NamedTuple):
    """The state of a rig as an observer estimates it, and its forecast with the duty held.

    - `now`: what is estimated now. `later`: what is expected at the end of the forecast.
    - `expected_spread`: the standard deviation of the next readings `(channels,)`, K.
    - `readings`: the readings that are expected at each time of the forecast `(STEPS, channels)`,
      degC and K.
    - `power`: the electrical power that each bridge draws now `(cells,)`, W, as the twin says.
    """

    now: Moments
    later: Moments
    expected_spread: Float[np.ndarray | Array, " channels"]
    readings: Moment
    power: Float[np.ndarray | Array, " cells"]


def look_ahead(
    kalman: ExtendedKalmanFilter, state: KalmanState, duty: Float[np.ndarray, " cells"]
) -> Outlook:
    """Computes estimates and forecast from the state of an observer.

    **Arguments:**

    - `kalman`: the observer.
    - `state`: its state.
    - `duty`: the duty of the cells, which is held during the forecast, -1 to 1.
    """
    held = np.repeat(np.asarray(duty, float)[None], STEPS, axis=0)
    with own_settings():
        samples = samples_between(held, HORIZON / STEPS, len(kalman.model.columns), kalman)
        result = jax.tree.map(np.asarray, _outlook(kalman, state, samples))
    each = len(result.readings.mean) // STEPS
    ends = jax.tree.map(lambda part: part[each - 1 :: each], result.readings)
    return result._replace(readings=ends)


@persistent_jit
def _outlook(kalman: ExtendedKalmanFilter, state: KalmanState, samples: FilterSamples) -> Outlook:
    model = kalman.model

    def take(state: KalmanState, sample: FilterSamples) -> tuple[KalmanState, Moment]:
        state = kalman.step(state, sample.duty, sample.dt)
        variance = jnp.diag(kalman.reading_covariance(state))
        return state, Moment(kalman.readings(state, sample.ambient), jnp.sqrt(variance))

    end, readings = jax.lax.scan(take, state, samples)
    now = moments(model, state.mean, state.covariance)
    system = model.stepper.system
    nodes = jnp.asarray(now.nodes.mean) + ZERO_CELSIUS
    cold, hot = (nodes[np.asarray(side)] for side in (system.wiring.cold, system.wiring.hot))
    return Outlook(
        now=now,
        later=moments(model, end.mean, end.covariance),
        expected_spread=jnp.sqrt(jnp.diag(kalman.reading_covariance(state))),
        readings=readings,
        power=system.bridge.supply_power(system.module, state.duty, cold, hot),
    )
