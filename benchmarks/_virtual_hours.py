"""Hours of the virtual two-cell rig that a monitor and a diagnosis watch, healthy or with a fault.

A rig has values that differ from those of the twin by a draw, a room and a random duty of its own,
errors of each channel and of all of them, a camera that corrects itself, and noise.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import jaxtwin as jt
from jaxtwin._jax_settings import own_settings
from jaxtwin.matching import posterior_draws
from jaxtwin.observers import (
    ExtendedKalmanFilter,
    FilterSamples,
    KalmanState,
    Observed,
    filtered,
    first_reading,
    samples_of,
    started,
)
from jaxtwin.physics import FAULT_MODELS, Recalibrations

LENGTH = 3600
"""How long an hour is, s."""
LASTS = 245
"""A fault begins so long before the end of the hour, s, or up to 40 s later."""
WATCHED = 760
"""The number of samples at the end of an hour that are diagnosed, which is most of the work."""
CORRECTED = 164.0
"""The time between two corrections of the camera, s."""
LARGEST = 2.5
"""The largest multiple of a standard deviation by which a value of a rig differs."""


class FaultCase(NamedTuple):
    """A fault of a rig: its model, the part, the size, and how long it lasts at most, s."""

    model: str
    part: str
    size: float
    lasts: int = LASTS

    @property
    def suspect(self) -> str:
        """The name of the suspect that it is."""
        return f"{self.model} {self.part}"


def template(twin: jt.Twin) -> jt.Experiment:
    """A recording for which a filter is made."""
    times, cells = np.arange(LENGTH + 1.0), len(twin.rig.driven)
    duty = np.repeat([[0.3], [0.8], [0.5]], len(times) // 3 + 1, axis=0)[: len(times)]
    return jt.simulate(
        twin, jt.Experiment(times, np.tile(duty, cells), channels=twin.channels)
    ).to_recording(noise=0.05)


def values_of_filter(kalman: ExtendedKalmanFilter, seed: int) -> dict[str, float]:
    """Values of a rig that differ from the twin as the filter takes them to: in the directions of
    the posterior that the readings show."""
    random = np.random.default_rng([seed, 2])
    directions = kalman.model.directions
    assert directions is not None
    with own_settings():
        amounts = np.clip(random.normal(size=directions.count), -LARGEST, LARGEST)
        amounts = amounts * directions.spreads(kalman.model.noise)
        return {name: float(one) for name, one in directions.changed(jnp.asarray(amounts)).items()}


def values_of_posterior(fit: jt.Fit, seed: int) -> dict[str, float]:
    """Values of a rig from the whole posterior of the match."""
    return {name: float(one[0]) for name, one in posterior_draws(fit, 1, seed=seed).items()}


def hour(
    kalman: ExtendedKalmanFilter, values: dict[str, float], fault: FaultCase | None, seed: int
) -> tuple[jt.Experiment, int]:
    """An hour of a rig with some values, and when its fault begins."""
    random = np.random.default_rng(seed)
    twin = kalman.model.twin.with_values(values)
    rig, cells = twin.rig, len(twin.rig.driven)
    last = LASTS if fault is None else fault.lasts
    onset, duty = plan_of(random, last, cells)
    stepper = jt.Stepper(twin, 1.0)
    room = float(stepper.ambient) + random.normal(0, 1.0)
    with own_settings():
        begin = stepper.start(room)
        states, healthy = _path(stepper, begin, duty[:LENGTH], room)
        start = np.asarray(stepper.channels(begin, room))
        clean = np.concatenate([start[None], healthy])
        if fault is not None:
            before = jax.tree.map(lambda leaf: np.asarray(leaf)[onset - 1], states)
            change = FAULT_MODELS[fault.model](twin, fault.part, fault.size)
            faulty = jt.Stepper(change(stepper.system), 1.0)
            _, after = _path(faulty, before, duty[onset : onset + last], room)
            clean[onset + 1 :] = after[: LENGTH - onset]
    readings = clean + _errors(kalman, rig, clean.shape, seed, random)
    time = np.arange(len(clean), dtype=float)
    recorded = jt.Experiment(
        time, duty[: len(clean)], channels=twin.channels, temperatures=readings, name=str(seed)
    )
    return recorded, onset


def plan_of(
    random: np.random.Generator, last: int, cells: int
) -> tuple[int, Float[np.ndarray, "times cells"]]:
    """When a fault begins that lasts so long, s, and a duty that changes every one to three
    minutes."""
    onset = LENGTH - last + int(random.integers(40))
    switches = np.cumsum(random.uniform(60, 200, LENGTH // 60 + 10)).astype(int)
    levels = random.uniform(0.1, 1.0, (len(switches) + 1, cells))
    # The fault is simulated for the same time whenever it begins, so that programs are shared.
    duty = levels[np.searchsorted(switches, np.arange(LENGTH + last), side="right")]
    duty[: int(random.uniform(0, 60))] = 0.0
    return onset, duty


def _errors(
    kalman: ExtendedKalmanFilter,
    rig: jt.Rig,
    shape: tuple[int, ...],
    seed: int,
    random: np.random.Generator,
) -> Float[np.ndarray, "times channels"]:
    """Errors of the readings, K."""
    level = kalman.model.noise.levels()
    camera = Recalibrations(CORRECTED, seed, rig.common_error)
    errors = random.normal(0, level["reading"], shape)
    own = random.normal(0, level["channel"], shape)
    memory = np.exp(-1 / level["channel_time"])
    for at in range(1, len(own)):
        own[at] = memory * own[at - 1] + np.sqrt(1 - memory**2) * own[at]
    for at in range(len(errors)):
        camera.advance(float(at))
        errors[at] += camera.offset(float(at))
    return errors + own


@jax.jit
def _path(
    stepper: jt.Stepper, state: jt.simulation.StepperState, duty: np.ndarray, room: float
) -> tuple[jt.simulation.StepperState, jax.Array]:
    """The states and the readings after each command."""

    def take(
        now: jt.simulation.StepperState, command: jax.Array
    ) -> tuple[jt.simulation.StepperState, tuple[jt.simulation.StepperState, jax.Array]]:
        after = stepper.step(now, command, room)
        return after, (after, stepper.channels(after, room))

    return jax.lax.scan(take, state, jnp.asarray(duty))[1]


def begun(
    kalman: ExtendedKalmanFilter, experiment: jt.Experiment
) -> tuple[KalmanState, FilterSamples, np.ndarray]:
    """The state of a filter before a recording, the samples of it, and which of them it has."""
    samples, is_sample = samples_of(kalman, experiment)
    with own_settings():
        first = np.asarray(first_reading(experiment))
        return started(kalman, first, np.zeros_like(samples.duty[0])), samples, is_sample


def follow(kalman: ExtendedKalmanFilter, experiment: jt.Experiment) -> Observed:
    """Follows a recording with a filter that is there already."""
    start, samples, is_sample = begun(kalman, experiment)
    with own_settings():
        return Observed(experiment, kalman, samples, is_sample, filtered(kalman, start, samples))
