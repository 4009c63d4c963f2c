"""How well do rig files of at most 45 lines describe devices that others built?

    python -m benchmarks.devices FOLDER_WITH_RECORDINGS

The heated box of the INTO-CPS incubator (`incubator/`) is matched to two recordings of different
days, and predicts a third, of another day, until its lid is opened. A heater of a Temperature
Control Lab (`tclab/`), in a room that nobody measured, is matched to a whole recording, and to the
first 60 % of it, which predict the rest. Rig files: `benchmarks/rigs`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import jaxtwin as jt

from ._devices import BOX, HEATER, LID, box_recordings
from ._machine import machine
from ._results import parser_of, write_results
from ._tables import table

GIVEN = (60.0, 120.0, 180.0, 240.0)
"""The parts of the third recording that the box's group of values is estimated from, s."""
SPLIT = 0.6


def main() -> None:
    """Writes `results/devices.json` and `devices.md`."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    answer = {
        "machine": machine(),
        "box": box(given.folder / "incubator"),
        "heater": heater(given.folder / "tclab" / "tclab-train.csv"),
    }
    write_results(given.out / "devices.json", answer, page(answer))


def box(folder: Path) -> dict[str, Any]:
    """The fit of the matched recordings, and predictions of the third."""
    rig, known, third = box_recordings(folder)
    fit = jt.match(jt.Twin(rig), known)
    third = third.between(None, LID[0][0])
    predicted = {
        f"{seconds:g}": judged(jt.validate(fit, third, given=seconds)) for seconds in GIVEN
    }
    return {
        "lines": lines_of(BOX),
        "matched": {name: mean_fit(fit.fit_percent, name) for name in fit.recordings},
        "rmse_K": float(fit.rmse),
        "seconds": fit.wall_time,
        "predicted": predicted,
    }


def heater(recording: Path) -> dict[str, Any]:
    """The fit of the whole recording, and the prediction of its end."""
    rig = jt.load_rig(HEATER)
    whole = jt.read_recording(recording, rig=rig)
    fit = jt.match(jt.Twin(rig), whole)
    split = jt.validate_split(jt.Twin(rig), whole, SPLIT * whole.duration)
    return {
        "lines": lines_of(HEATER),
        "matched": {whole.name: mean_fit(fit.fit_percent, whole.name)},
        "rmse_K": float(fit.rmse),
        "seconds": fit.wall_time,
        "predicted": {f"{SPLIT:.0%}": judged(split)},
    }


def judged(found: jt.validation.Validation) -> dict[str, float]:
    """How near a prediction was, and its band."""
    return {
        "fit_percent": found.mean_fit_percent,
        "rmse_K": float(found.rmse),
        "inside_percent": 100 * found.coverage,
        "band_K": found.band_width,
    }


def mean_fit(fits: Mapping[tuple[str, str], float], name: str) -> float:
    """The mean over the channels of a recording, %."""
    return float(np.mean([fit for (recording, _), fit in fits.items() if recording == name]))


def lines_of(file: Path) -> int:
    """The length of a file."""
    return len(file.read_text().splitlines())


def page(answer: dict[str, Any]) -> str:
    """The results as Markdown."""
    where, devices = answer["machine"], {"heated box": "box", "TCLab, one heater": "heater"}
    matched = [
        (device, answer[key]["lines"], name, f"{fit:.1f}", f"{answer[key]['seconds']:.1f}")
        for device, key in devices.items()
        for name, fit in answer[key]["matched"].items()
    ]
    predicted = [
        (device, f"{given} s" if key == "box" else given, f"{one['fit_percent']:.1f}",
         f"{one['rmse_K']:.2f}", f"{one['inside_percent']:.1f}", f"{one['band_K']:.2f}")
        for device, key in devices.items()
        for given, one in answer[key]["predicted"].items()
    ]  # fmt: skip
    return (
        f"# Devices that others built, measured {where['date']}\n\n"
        f"{where['processor']}; `python -m benchmarks.devices FOLDER`. Fits are means over the "
        "channels. A match of both recordings of the box takes the time of both rows together.\n\n"
        + table(("device", "lines of the rig file", "matched", "fit, %", "match, s"), matched)
        + "\n`lid-jan`, a third day of the box, until its lid is opened, predicted after a first "
        "part from which the values of its day are estimated; and the last 40 % of the heater's "
        "recording, predicted from the rest:\n\n"
        + table(
            ("device", "given", "predicted, %", "RMSE, K", "inside the 95 % band, %", "band, K"),
            predicted,
        )
    )


if __name__ == "__main__":
    main()
