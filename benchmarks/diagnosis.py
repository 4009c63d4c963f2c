"""What does a diagnosis say of the recordings of a heated box?

Its lid was opened twice in one of three recordings (`incubator/`): match, noise and what is healthy
come from the two others. `benchmarks.faults` has the faults of a virtual rig.

    python -m benchmarks.diagnosis FOLDER_WITH_RECORDINGS [--fits KEPT]
"""

import argparse
from pathlib import Path

import jaxtwin as jt
from benchmarks._devices import LID, box_recordings
from benchmarks._fitted import fitted
from benchmarks._machine import processor


def main() -> None:
    """Prints what is found, as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--fits", type=Path, help="a folder that keeps fits and noise")
    given = parser.parse_args()
    print(f"{processor()}\n")
    box(given.folder / "incubator", given.fits)


def box(folder: Path, kept: Path | None) -> None:
    """The heated box, whose lid was open twice in the last recording."""
    rig, known, third = box_recordings(folder)
    fit, noise = fitted("incubator", known, (), kept, rig)
    spans = " and ".join(f"from {first:g} to {last:g} s" for first, last in LID)
    print(f"## A heated box\n\nIts lid was open in lid-jan {spans}.\n")
    for one in (*known, third):
        found = jt.diagnose(fit, one, noise=noise, healthy=known)
        print(found.summary(), flush=True)
    print()


if __name__ == "__main__":
    main()
