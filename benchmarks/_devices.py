"""Recordings of devices that others built, and rig files of them, written from the docs."""

from pathlib import Path

import numpy as np

import jaxtwin as jt

RIGS = Path(__file__).parent / "rigs"
BOX, HEATER = RIGS / "incubator.toml", RIGS / "one_heater.toml"
RECORDINGS = ("f24-semi", "ctl-exp2", "lid-jan")
LID = ((659.3, 719.3), (1220.3, 1286.3))
"""When the lid of the box was open in `lid-jan`, s."""


def box_recordings(folder: Path) -> tuple[jt.Rig, list[jt.Experiment], jt.Experiment]:
    """The rig of the heated box, the recordings that it is matched to, and that of the lid."""
    rig = jt.load_rig(BOX)
    first, second, third = (_of_box(folder, name, rig) for name in RECORDINGS)
    return rig, [first, second], third


def _of_box(folder: Path, name: str, rig: jt.Rig) -> jt.Experiment:
    """A recording of the box while its fan ran; without the fan it is another device."""
    fan = np.genfromtxt(folder / f"{name}.fan.csv", delimiter=",", names=True)
    time = fan["time_s"][fan["fan"] > 0]
    return jt.read_recording(folder / f"{name}.csv", rig=rig).between(time[0], time[-1])
