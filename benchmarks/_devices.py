"""Recordings of devices that others built, and rig files of them, written from the docs."""

from pathlib import Path

import numpy as np

import jaxtwin as jt

RIGS = Path(__file__).parent / "rigs"
BOX, HEATER = RIGS / "incubator.toml", RIGS / "one_heater.toml"
LID = ((659.3, 719.3), (1220.3, 1286.3))
"""When the lid of the box was open in `lid-jan`, s."""


def of_box(folder: Path, name: str, rig: jt.Rig) -> jt.Experiment:
    """A recording of the heated box while its fan ran; without the fan the box is another
    device."""
    fan = np.genfromtxt(folder / f"{name}.fan.csv", delimiter=",", names=True)
    time = fan["time_s"][fan["fan"] > 0]
    return jt.read_recording(folder / f"{name}.csv", rig=rig).between(time[0], time[-1])
