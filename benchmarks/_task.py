"""The work that every way is given: a rig, its experiment, random draws around it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

import jaxtwin as jt
from jaxtwin.sensitivity_analysis import normal_draws

SPREAD, SEED = 0.25, 0
HELD = ("T_amb", "T_start", "t_delay", "d_x", "d_y", "s_view", "r_view")
"""Not drawn. With one delay for all draws, every draw's input changes at samples, which peers that
step all draws on one grid need; with the camera's registration all draws share the channels'
weights."""


@dataclass(frozen=True)
class Task:
    """A rig around one of its parameter sets, or around its own values.

    All resistances, heat capacities, constants of cells and gains are drawn; 1000 s at 1 Hz with
    the recordings' drive, 128 and then 200 counts; 15 channels.
    """

    rig: str
    parameter_set: str | None = None
    inputs: str = "steps"
    """Which of `drives`."""

    @property
    def name(self) -> str:
        """For tables."""
        named = (self.rig, self.parameter_set, None if self.inputs == "steps" else self.inputs)
        return ", ".join(part for part in named if part is not None)

    @cached_property
    def twin(self) -> jt.Twin:
        """What the draws are spread around."""
        rig = jt.load_rig(self.rig)
        values = {} if self.parameter_set is None else rig.parameter_sets[self.parameter_set]
        return jt.Twin(rig, values)

    @property
    def drive(self) -> jt.Experiment:
        """What drives it, without a recording."""
        return drives(len(self.twin.wiring.cold))[self.inputs]

    @cached_property
    def experiment(self) -> jt.Experiment:
        """With what the twin itself answers as its recording, so that there is a cost."""
        drive = self.drive
        run = self.twin.simulate(drive)
        return replace(drive, channels=run.channels, temperatures=run.temperatures)

    def draws(self, count: int) -> dict[str, Float[np.ndarray, " draws"]]:
        """The first so many draws."""
        names = [name for name in self.twin.values if name not in HELD]
        values = {name: float(self.twin.values[name]) for name in names}
        return normal_draws(values, SPREAD, SEED, count)

    def twins(self, count: int) -> list[jt.Twin]:
        """The first so many draws as a twin each."""
        draws = self.draws(count)
        return [
            self.twin.with_values({name: values[k] for name, values in draws.items()})
            for k in range(count)
        ]


def drives(cells: int, samples: int = 1001) -> Mapping[str, jt.Experiment]:
    """The drive of the recordings, and inputs that change at every sample: a duty as a PI
    controller commands it, in counts and with the noise of its readings; one that is drawn anew, at
    every sample or, of two levels, every ten seconds;
    and rooms that drift, with noise of 0.1 K, with a resolution of 0.1 K, and with an open door."""
    steps, random = drive_of_the_recordings(cells, samples), np.random.default_rng(0)
    time = steps.time
    settling = 0.5 + 0.3 * np.exp(-(time % 400) / 60) * np.where(time % 800 < 400, 1, -1)
    noise = random.normal(0, 0.01, (samples, cells))
    loop = np.round(255 * (settling[:, None] + noise)) / 255
    slow = 22 + 2 * np.sin(2 * np.pi * time / 5000)
    noisy = slow + random.normal(0, 0.1, samples)
    levels = np.random.default_rng(1).choice([0.3, 0.7], (samples // 10 + 1, cells))
    is_open = (time > 0.4 * time[-1]) & (time < 0.6 * time[-1])
    return {
        "steps": steps,
        "closed loop": jt.Experiment(time, loop),
        "two levels": jt.Experiment(time, levels[np.arange(samples) // 10]),
        "random duty": jt.Experiment(time, random.uniform(-0.6, 0.8, (samples, cells))),
        "slow room": replace(steps, ambient=slow),
        "noisy room": replace(steps, ambient=noisy),
        "rounded room": replace(steps, ambient=noisy.round(1)),
        "open door": replace(steps, ambient=slow - 8 * is_open),
        "closed loop, noisy room": jt.Experiment(time, loop, ambient=noisy),
    }


PUBLISHED, STARTUP = Task("paper-2024", "published"), Task("paper-2024", "startup")
DUAL_CELL = Task("dual-cell")


def drive_of_the_recordings(cells: int = 2, samples: int = 1001) -> jt.Experiment:
    """What the published step recordings were driven with, at any number of samples."""
    time = np.arange(float(samples))
    duty = np.where(time < samples // 2, 128 / 255, 200 / 255)
    return jt.Experiment(time, np.repeat(duty[:, None], cells, axis=1))
