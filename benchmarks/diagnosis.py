"""What does a diagnosis say of the recordings of a heated box?

Its lid was opened twice in one of three recordings (`incubator/`): match, noise and what is healthy
come from the two others. `benchmarks.faults` has the faults of a virtual rig.

    python -m benchmarks.diagnosis FOLDER_WITH_RECORDINGS box.toml [--fits KEPT]
"""

import argparse
from pathlib import Path

import numpy as np

import jaxtwin as jt
from benchmarks._machine import processor
from benchmarks.monitor import fitted


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("box", type=Path, help="the rig file of the heated box")
    parser.add_argument("--fits", type=Path, help="a folder that keeps fits and noise")
    given = parser.parse_args()
    print(f"{processor()}\n")
    if given.fits is not None:
        given.fits.mkdir(exist_ok=True)
    box(given.folder / "incubator", given.box, given.fits)


def box(folder: Path, rig_file: Path, kept: Path | None) -> None:
    """The heated box: its lid was opened at 659.3 and 1220.3 s and closed at 719.3 and 1286.3 s."""
    rig = jt.load_rig(rig_file)
    runs = {
        name: _while_fan_runs(folder, name, rig) for name in ("f24-semi", "ctl-exp2", "lid-jan")
    }
    known = [runs["f24-semi"], runs["ctl-exp2"]]
    fit, noise = fitted("incubator", known, (), kept, rig)
    print("## A heated box\n")
    for one in runs.values():
        found = jt.diagnose(fit, one, noise=noise, healthy=known)
        print(found.summary(), flush=True)
    print()


def _while_fan_runs(folder: Path, name: str, rig: jt.Rig) -> jt.Experiment:
    """A recording while the fan ran; without it the box is another device."""
    fan = np.genfromtxt(folder / f"{name}.fan.csv", delimiter=",", names=True)
    time = fan["time_s"][fan["fan"] > 0]
    return jt.read_recording(folder / f"{name}.csv", rig=rig).between(time[0], time[-1])


if __name__ == "__main__":
    main()
