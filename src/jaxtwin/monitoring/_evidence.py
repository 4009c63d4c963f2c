"""What a monitor gets at each sample, and what it says of it."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from ..observers import KalmanState


class ObservedSample(NamedTuple):
    """A sample of an observed rig.

    - `readings`: NaN where there is none. `expected`: what was expected of them before. degC.
    - `whitened`: the standardised innovations, 0 where there is no reading.
    - `mean`: the observer's state after the readings. `slope`: the expected change of the readings,
      K/s.
    - `duty`: the duty that reached the cells. `ambient`: NaN if it is not measured, degC.
    - `dt`: the time since the sample before, s.
    - `since_correction`: that since the camera was last seen to correct itself, infinite if never.
    - `rejected`: the innovations of the readings that the filter rejected, which are missing in
      `readings`, K; 0 for all others. `is_inside`: whether a reading is inside the filter's gate.
    """

    readings: Float[ArrayLike, "*times channels"]
    expected: Float[ArrayLike, "*times channels"]
    whitened: Float[ArrayLike, "*times channels"]
    mean: Float[ArrayLike, "*times state"]
    slope: Float[ArrayLike, "*times channels"]
    duty: Float[ArrayLike, "*times cells"]
    ambient: Float[ArrayLike, "*times"]
    dt: Float[ArrayLike, "*times"]
    since_correction: Float[ArrayLike, "*times"] = np.inf
    rejected: Float[ArrayLike, "*times channels"] = 0.0
    is_inside: Bool[ArrayLike, "*times channels"] = True


def observed_sample(
    state: KalmanState,
    expected: Float[ArrayLike, "*times channels"],
    readings: Float[ArrayLike, "*times channels"],
    ambient: Float[ArrayLike, "*times"],
    dt: Float[ArrayLike, "*times"],
) -> ObservedSample:
    """What a monitor gets from an extended Kalman filter, corrected by the readings."""
    innovation = jnp.asarray(readings) - jnp.asarray(expected)
    return ObservedSample(
        readings=jnp.where(state.is_rejected, jnp.nan, readings),
        expected=expected,
        whitened=jnp.where(jnp.isfinite(jnp.asarray(readings)), state.whitened, 0.0),
        mean=state.mean,
        slope=state.slope,
        duty=state.duty,
        ambient=ambient,
        dt=dt,
        since_correction=state.since_correction,
        rejected=jnp.where(state.is_rejected, innovation, 0.0),
        is_inside=state.rejected == 0,
    )


class Evidence(NamedTuple):
    """What one test says of each channel, state or parameter.

    - `score`: the statistic as a multiple of its threshold: 1 and more is a finding.
    - `age`: the time since the likely onset, s.
    - `size`: how large the change is, in the unit of the test.
    """

    score: Float[Array | np.ndarray, "*times members"]
    age: Float[Array | np.ndarray, "*times members"]
    size: Float[Array | np.ndarray, "*times members"]


class Evidences(NamedTuple):
    """What all tests say.

    - `sum`, `ratio`: the cumulative sums and the likelihood ratio of each channel, K.
    - `joint`: the likelihood ratio of all channels together, K; empty for a single channel.
    - `energy`: its mean square innovation; the size is a multiple of the usual spread.
    - `state`: the observer's slow states: the multiples of the uncertain directions (the size is
      the relative change of their main parameter, or its change if it may be negative), the room,
      K, and the unexplained heats, W.
    - `error`: the error of each channel by itself, K; empty for a single channel.
    - `frozen`: equal readings in sequence. `gone`: readings at the room while a cell is driven.
    - `impossible`: readings that were rejected, once the next one is as expected, K.
    - `changed`: parameters against the recordings of the match, likewise.
    """

    sum: Evidence
    ratio: Evidence
    joint: Evidence
    energy: Evidence
    state: Evidence
    error: Evidence
    frozen: Evidence
    gone: Evidence
    impossible: Evidence
    changed: Evidence

    def __repr__(self) -> str:
        return f"<Evidences: {', '.join(self._fields)}>"


def joined(evidences: Evidences) -> Evidence:
    """What all tests say of a sample, one behind the other: three arrays, which a program returns
    faster than many small ones."""
    return Evidence(*map(jnp.concatenate, zip(*evidences, strict=True)))
