"""A fit of `tclab` that takes a second, and controllers of it, for tests of retuning."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import jaxtwin as jt
from jaxtwin.control import PID, ControllerDesign, save_controller

REFERENCES, LENGTH = "0:30,100:36", 200
"""The steps for which its controllers are tuned, degC, and their time, s."""

DESIGN = ControllerDesign(REFERENCES, float(LENGTH), {"integral_absolute_error": 1.0})


@cache
def fit() -> jt.Fit:
    plan = jt.Experiment.schedule("0:0.5/0.2,100:0.2/0.6", duration=300, step=2, cells=2)
    recording = jt.simulate(jt.Twin("tclab"), plan).to_recording(seed=1)
    return jt.match(jt.Twin("tclab"), recording, free=["R_1", "R_2", "T_amb"])


def pid(Kp: float = 0.02) -> PID:
    return PID(Kp=Kp, Ki=Kp / 150, limits=(0, 1), measured=(("T1",), ("T2",)))


def text(controller: PID) -> str:
    """The file of a controller."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "controller.toml"
        save_controller(file, controller, fit().twin.rig, design=DESIGN)
        return file.read_text(encoding="utf-8")
