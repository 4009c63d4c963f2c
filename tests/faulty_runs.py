"""Runs of the small linear rig `tclab`, with a fault from some time on."""

from functools import cache
from pathlib import Path

import jax
import numpy as np

from jaxtwin import Experiment, Stepper, Twin, match, write_recording
from jaxtwin.physics import FAULT_MODELS

# The length of a run and the onset of a fault, s.
LENGTH, ONSET = 900, 500

# The noise of a reading, K.
SIZE = 0.15


@cache
def bench() -> Twin:
    return Twin("tclab")


@cache
def clean(model: str = "", part: str = "", size: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """The duty of a run, with a set-point change every 120 s, and its readings without noise."""
    random = np.random.default_rng(3)
    duty = np.repeat(random.uniform(0.2, 0.9, (LENGTH // 120 + 1, 2)), 120, axis=0)[: LENGTH + 1]
    stepper = Stepper(bench(), 1.0)
    with jax.enable_x64(True):
        state = stepper.start()
        first = np.asarray(stepper.channels(state))
        state, before = _path(stepper, state, duty[:ONSET])
        if model:
            fault = FAULT_MODELS[model](bench(), part, size)
            stepper = Stepper(fault(stepper.system), 1.0)
        _, after = _path(stepper, state, duty[ONSET:-1])
    return duty, np.concatenate([first[None], before, after])


def recording(
    model: str = "", part: str = "", size: float = 1.0, *, seed: int = 0, name: str = "bench"
) -> Experiment:
    """A run with noise."""
    duty, readings = clean(model, part, size)
    noise = np.random.default_rng(seed).normal(0.0, SIZE, readings.shape)
    return with_readings(readings + noise, duty, name)


def with_readings(readings: np.ndarray, duty: np.ndarray, name: str = "bench") -> Experiment:
    time = np.arange(len(readings), dtype=float)
    return Experiment(time, duty, channels=bench().channels, temperatures=readings, name=name)


@jax.jit
def _path(stepper, state, duty):
    def take(now, command):
        after = stepper.step(now, command)
        return after, stepper.channels(after)

    return jax.lax.scan(take, state, duty)


def write_sessions(folder: Path) -> Path:
    """Writes a fit, two healthy recordings and one with a fault into a folder."""
    runs = [recording(seed=seed, name=f"day{seed}") for seed in (1, 2)]
    match(bench(), runs[0], free=["P_1", "P_2"], max_iterations=3).save(folder / "fit.toml")
    for one in (*runs, recording("gain", "T1", 0.8, name="hurt")):
        write_recording(one, folder / f"{one.name}.csv")
    return folder
