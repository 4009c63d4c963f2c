"""Observes a recording: the state of the rig at each sample, given the readings up to it."""

import dataclasses
import os
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._compilation import persistent_jit_unoptimised
from .._jax_settings import own_settings
from ..errors import ObserverError, SimulationError
from ..io import Experiment, as_experiment, gap_sentences, separate_recordings
from ..matching import Fit
from ..physics import System, Twin
from ..simulation import Stepper, assembled, checked_channels
from ._augmented_model import AugmentedModel
from ._filter_run import estimated, filtered, samples_of, started
from ._kalman_filter import ExtendedKalmanFilter
from ._moving_horizon import HORIZON, MovingHorizonEstimator
from ._observed import Observed
from ._process_noise import ProcessNoise
from ._start import first_reading
from ._state_bounds import StateBounds
from ._uncertain_values import room_spread, uncertain_directions, uncertainty_of_fit

# The longest step of a filter, s.
MAX_STEP = 10.0

# A usual size of heat that the twin does not explain, as a part of the heat at full duty.
UNEXPLAINED_HEAT_FRACTION = 0.003

# The shortest time between two commands of a live rig that are told apart, s.
LIVE_SPACING = 0.1


def observe(
    fit: Twin | Fit,
    experiment: Experiment | str | os.PathLike[str],
    noise: ProcessNoise | None = None,
    *,
    bounds: StateBounds | None = None,
    horizon: int | None = None,
) -> Observed:
    """Follows a recording with an extended Kalman filter, or within bounds with a moving-horizon
    estimator.

    The state of the filter contains the temperatures of all nodes, the room, heats that the twin
    does not explain, the errors of the readings, and the values of the twin that the fit is least
    certain of; see `jaxtwin.observers`.

    **Arguments:**

    - `fit`: a fit, whose uncertainty the filter starts from; or a twin, whose values are taken as
      exact.
    - `experiment`: the recording or its file, matched or not. A missing reading says nothing, each
      by itself.
    - `noise`: the noise of rig and readings, as `jaxtwin.estimate_noise` finds it; None: usual
      levels.
    - `bounds`, `horizon`: what the state cannot be, and the number of steps in the window of a
      `MovingHorizonEstimator`; None for both is the filter alone, None for one of them no bounds,
      or 20 steps.

    **Returns:** what the filter knew after each sample.

    **Raises:** `ObserverError` if the recording has no readings, if a level of the noise is not
    positive, if a bound is not valid, or if the filter diverges; `SimulationError` for a recording
    of another rig, or without a column for one of its inputs.
    """
    rig = (fit.twin if isinstance(fit, Fit) else fit).rig
    experiment = as_experiment("observe: experiment", experiment, ObserverError, rig)
    if noise is None:
        noise = usual_noise(fit, [experiment])
    kalman = filter_for(fit, experiment, noise)
    samples, is_sample = samples_of(kalman, experiment)
    estimator = None
    if bounds is not None or horizon is not None:
        steps = HORIZON if horizon is None else horizon
        estimator = MovingHorizonEstimator(kalman, steps, bounds)
    with own_settings():
        first, idle = np.asarray(first_reading(experiment)), np.zeros_like(samples.duty[0])
        if estimator is None:
            run = filtered(kalman, started(kalman, first, idle), samples)
        else:
            run = estimated(estimator, first, idle, samples)
    wrong = ~np.isfinite(np.asarray(run.states.mean)).all(axis=1)
    if wrong.any():
        at = experiment.time[0] + float(np.cumsum(samples.dt)[int(wrong.argmax())])
        raise ObserverError(
            f"{experiment.name or 'experiment'}: the filter diverged at {at:g} s; expected values "
            "and noise with which the twin follows the recording"
        )
    return Observed(experiment, kalman, samples, is_sample, run, estimator)


def live_observer(
    twin: Twin,
    noise: ProcessNoise | None = None,
    sample_time: float = 1.0,
    *,
    stepper: Stepper | None = None,
) -> ExtendedKalmanFilter:
    """Makes a filter for a rig that is read as it runs, with the values of the twin taken as exact
    but for those that the noise names.

    **Arguments:**

    - `twin`: the twin; all of its channels are read.
    - `noise`: the levels of the noise; None: usual ones.
    - `sample_time`: the time between two readings, s.
    - `stepper`: a stepper of the twin with fewer modes, from `reduce_stepper`, for a device with
      little memory; None for all modes.

    **Raises:** `ObserverError` if a level of the noise is not positive, or for unknown names.
    """
    levels = _usual_levels(twin, sample_time) if noise is None else noise
    levels.check()
    step = min(sample_time, MAX_STEP)
    if stepper is None:
        stepper, step = stable_stepper(twin, step)
    none = np.zeros((0, 0))
    directions = uncertain_directions(twin, {}, none, None, levels.names)
    with own_settings():
        columns = range(len(twin.channels))
        spread = room_spread(twin)
        model = AugmentedModel(twin, directions, levels.as_arrays(), columns, stepper, spread)
        return ExtendedKalmanFilter(model, step, min(sample_time, LIVE_SPACING))


def usual_noise(
    fit: Twin | Fit, experiments: Sequence[Experiment], names: Sequence[str] = ()
) -> ProcessNoise:
    """The levels before any recording was looked at: those of the rig file's sensors, and times
    that are uncertain by a part of the time between samples, and a part of the heat at full
    duty."""
    twin = fit.twin if isinstance(fit, Fit) else fit
    sample = float(
        np.median(np.concatenate([np.diff(experiment.time) for experiment in experiments]))
    )
    return _usual_levels(twin, sample, names)


def _full_heat(twin: Twin) -> float:
    """The heat into the nodes that cells or heaters heat at full duty, in the mean, W."""
    with own_settings():
        return float(_mean_full_heat(assembled(twin)))


@persistent_jit_unoptimised
def _mean_full_heat(system: System) -> Float[Array, ""]:
    count = len(system.wiring.cold)
    sides = jnp.broadcast_to(jnp.asarray(system.ambient_temperature), (2 * count,))
    return jnp.mean(jnp.abs(system.cell_heat(sides, jnp.ones(count, sides.dtype)).cold))


def _usual_levels(twin: Twin, sample_time: float, names: Sequence[str] = ()) -> ProcessNoise:
    rig = twin.rig
    heat = UNEXPLAINED_HEAT_FRACTION * _full_heat(twin)
    noise = ProcessNoise(
        heat=heat,
        disturbance=heat,
        reading=rig.noise or 0.1,
        reading_time=0.1 * sample_time,
        command_time=0.3 * sample_time,
        names=tuple(names),
    )
    error = rig.common_error
    if error is None:
        return noise
    # Corrections that are too small to be detected are part of what all channels share.
    common = float(np.hypot(error.drift, error.jump / 3))
    time = float(np.mean([error.drift_time, *error.relaxation]))
    return dataclasses.replace(noise, common=common, common_time=time, jump=error.jump)


def filter_for(
    fit: Twin | Fit, experiment: Experiment, noise: ProcessNoise
) -> ExtendedKalmanFilter:
    """The filter for a recording."""
    if experiment.temperatures is None or not experiment.sampled.any():
        raise ObserverError(f"{experiment.name or 'experiment'}: expected readings, got none")
    if len(separate_recordings(experiment)) > 1:
        raise ObserverError(
            "observe: expected a recording whose gaps are short enough to hold the duty, got "
            f"{gap_sentences(experiment)[-1]}; Experiment.between gives what is before and behind "
            "it"
        )
    noise.check()
    channels = checked_channels(fit.twin if isinstance(fit, Fit) else fit, experiment)
    if isinstance(fit, Fit):
        # A filter finds by itself what `twin_for` estimates of a recording that was not matched.
        is_matched = experiment.fingerprint in fit.fingerprints
        twin = fit.twin_for(experiment) if is_matched else fit.twin_of_group(experiment.group)
        known, covariance = uncertainty_of_fit(fit, experiment)
    else:
        twin, known, covariance = fit, {}, np.zeros((0, 0))
    columns = [twin.channels.index(name) for name in channels]
    sample_time = float(np.median(np.diff(experiment.time)))
    stepper, step = stable_stepper(twin, min(sample_time, MAX_STEP))
    directions = uncertain_directions(twin, known, covariance, experiment, noise.names)
    with own_settings():
        spread = room_spread(fit)
        model = AugmentedModel(twin, directions, noise.as_arrays(), columns, stepper, spread)
        return ExtendedKalmanFilter(model, step, float(np.diff(experiment.time).min()))


def stable_stepper(twin: Twin, step: float) -> tuple[Stepper, float]:
    """A stepper with the longest step of at most `step` seconds that is stable: a half, a quarter,
    ... of it; and that step."""
    for _ in range(12):
        try:
            return Stepper(twin, step), step
        except SimulationError:
            step /= 2
    return Stepper(twin, step), step
