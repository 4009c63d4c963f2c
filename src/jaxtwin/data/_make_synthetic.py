"""Makes the synthetic recordings: `python -m jaxtwin.data._make_synthetic [FOLDER]`.

The twin of `paper-2024` with the parameters below is driven as the real rig was, 1000 s at 128 and
then 200 of 255 counts, and read by a camera with 0.1 K noise (normal, independent) and a
resolution of 0.01 K.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..io import Experiment
from ..physics import Twin
from ..rig import Parameter, load_rig, write_parameters
from ._synthetic import SYNTHETIC, synthetic_truth

RIG = "paper-2024"
SEED = 2024
NOISE = 0.1  # K
RESOLUTION = 2  # decimals of a degree
COUNTS, LEVELS, SWITCH, DURATION = 255, (128, 200), 500, 1000

CHANNELS = {
    "synthetic-A": ("T11", "T12", "T21", "T22", "TAM"),
    "synthetic-B": ("T13", "T14", "T23", "T24", "TBM"),
    "synthetic-C": ("T15", "T16", "T25", "T26", "TCM"),
}

# A cell like the datasheet's, the plate's links as 1 mm to 3 mm of copper would have them, faces
# that lose 10 to 25 W/(m^2 K) and more towards the right. No value comes from a recording.
TRUTH = {
    "C_esp": 1100.0,
    "R_Th": 1.7,
    "R_E": 2.3,
    "R_Tfx": 1.2,
    "R_Tez": 14.0,
    "R_Tez1": 60.0,
    "R_Tez2": 9.0,
    "R_Tez3": 6.0,
    "R_Tey": 160.0,
    "R_Tex1": 150.0,
    "R_Tey1": 600.0,
    "R_Tey2": 230.0,
    "R_Tey3": 350.0,
    "R_ph": 0.4,
    "R_pc": 0.35,
    "R_Tfx2": 0.9,
}

# Three days: the rig is at rest in surroundings of this temperature (degC) when a recording starts.
AMBIENT = {"synthetic-A": 15.3, "synthetic-B": 17.4, "synthetic-C": 16.1}


def make_recording(name: str) -> tuple[Experiment, Float[np.ndarray, "times channels"]]:
    """Makes a synthetic recording.

    **Arguments:**

    - `name`: one of `SYNTHETIC`.

    **Returns:** the drive, and the temperatures with noise at the camera's resolution, degC.
    """
    twin = Twin(load_rig(RIG), TRUTH | {"T_amb": AMBIENT[name], "T_start": AMBIENT[name]})
    time = np.arange(DURATION + 1.0)
    duty = np.where(time < SWITCH, *LEVELS)[:, None] / COUNTS * np.ones(2)
    experiment = Experiment(time, duty, channels=CHANNELS[name])
    exact = twin.simulate(experiment).temperatures
    noise = np.random.default_rng([SEED, SYNTHETIC.index(name)]).normal(0.0, NOISE, exact.shape)
    return experiment, np.round(exact + noise, RESOLUTION)


def main(folder: Path) -> None:
    """Writes the recordings and their truth.

    **Arguments:**

    - `folder`: the folder of the files.
    """
    for name in SYNTHETIC:
        _write_csv(folder / f"{name}.csv", *make_recording(name))
    table = load_rig(RIG).parameters
    write_parameters(
        folder / synthetic_truth().name,
        [replace(table[row], value=value) for row, value in TRUTH.items()]
        + [_recording_parameter(table[row]) for row in ("T_amb", "T_start")],
        {name: {"T_amb": value, "T_start": value} for name, value in AMBIENT.items()},
        comment=f"What the synthetic recordings were made with: rig {RIG}, seed {SEED}, camera "
        f"noise {NOISE} K.\nParameters that are not here have the rig's own values.",
    )


def _recording_parameter(parameter: Parameter) -> Parameter:
    return replace(parameter, value=AMBIENT[SYNTHETIC[0]])


def _write_csv(
    path: Path, experiment: Experiment, temperatures: Float[np.ndarray, "times channels"]
) -> None:
    """Writes hundredths of a degree, and duty cycles with all digits."""
    titles = [f"{name}_degC" for name in experiment.channels]
    lines = [
        f"# Synthetic: made by the twin of {RIG} with the parameters in synthetic-truth.toml and",
        f"# camera noise of {NOISE} K (seed {SEED}). No rig was measured.",
        ",".join(["time_s", "duty_P1", "duty_P2", *titles]),
    ]
    for time, duty, row in zip(experiment.time, experiment.duty, temperatures, strict=True):
        parts = (repr(float(part)).removesuffix(".0") for part in duty)
        readings = (f"{value:.{RESOLUTION}f}" for value in row)
        lines.append(",".join([f"{time:g}", *parts, *readings]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else synthetic_truth().parent)
