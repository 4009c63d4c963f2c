"""The contents of frames: what was measured, what is estimated and what was found, for JSON."""

from collections.abc import Sequence
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._celsius import ZERO_CELSIUS
from .._compilation import persistent_jit
from .._jax_settings import own_settings
from .._json_values import json_value
from .._statistics import QUANTILE_975
from ..observers import (
    Estimate,
    ExtendedKalmanFilter,
    FilterSamples,
    KalmanState,
    Moment,
    Moments,
    moments,
    samples_between,
)

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


DIGITS = 3


def sample_content(
    time: float,
    measured: Float[np.ndarray, " channels"],
    expected: Float[np.ndarray, " channels"],
    band: Float[np.ndarray, " channels"],
    duty: Float[np.ndarray, " cells"],
    ambient: float | None,
) -> dict[str, Any]:
    """A reading beside what was expected of it. `time` is in s since 1970, `band` in K, all others
    in degC."""
    return {
        "t": round(time, DIGITS),
        "measured": rounded(measured),
        "expected": rounded(expected),
        "band": rounded(band),
        "duty": rounded(duty),
        "ambient": ambient,
    }


def outlook_content(
    outlook: Outlook,
    elements: int,
    time: float,
    times: Sequence[float],
    energy: float,
    parameters: Estimate,
) -> dict[str, Any]:
    """What a twin says of the rig, each estimate with half of its 95 % band.

    **Arguments:**

    - `outlook`: the estimates and the forecast.
    - `elements`: the number of nodes that are elements of the plate, which are the first ones.
    - `time`, `times`: now, and the times of the forecast, s since 1970.
    - `energy`: what the cells have drawn since the server began, J.
    - `parameters`: the uncertain parameters of the twin, in the units of the rig's table.
    """
    now, later = outlook.now, outlook.later
    heats, heats_band = _both(now.heats)
    room, room_band = _both(now.room)
    nodes, nodes_band = _both(now.nodes)
    forecast, forecast_band = _both(outlook.readings)
    nodes_later = rounded(later.nodes.mean)
    return {
        "t": round(time, DIGITS),
        "elements": nodes[:elements],
        "elements_later": nodes_later[:elements],
        "nodes": nodes[elements:],
        "nodes_band": nodes_band[elements:],
        "nodes_later": nodes_later[elements:],
        "channels": rounded(now.channels.mean),
        "channels_later": rounded(later.channels.mean),
        "times": [round(time, DIGITS) for time in times],
        "forecast": forecast,
        "forecast_band": forecast_band,
        "room": room[0],
        "room_band": room_band[0],
        "heats": heats,
        "heats_band": heats_band,
        "power": rounded(outlook.power),
        "energy": round(energy, 1),
        "parameter": significant(parameters.mean),
        "parameter_lower": significant(parameters.lower),
        "parameter_upper": significant(parameters.upper),
    }


def rounded(values: Any) -> Any:
    """Numbers as lists, None where one is missing."""
    return json_value(np.round(np.asarray(values, float), DIGITS))


def significant(values: Any) -> Any:
    """The same with five digits, whatever the unit is."""
    numbers = np.asarray(values, float)
    sizes = np.abs(np.where(np.isfinite(numbers) & (numbers != 0), numbers, 1.0))
    unit = 10.0 ** (np.floor(np.log10(sizes)) - 4)
    # Divided by a whole power of ten, a number is written with as many digits as it has.
    whole = np.round(numbers / unit)
    return json_value(np.where(unit < 1, whole / np.round(1 / np.minimum(unit, 1.0)), whole * unit))


def _both(moment: Moment) -> tuple[list[Any], list[Any]]:
    return rounded(moment.mean), rounded(QUANTILE_975 * moment.spread)
