"""Does the two-cell rig describe its recordings with its cells as squares where they are?

`dual-cell` with a place, a size and one contact for each cell in place of contacts listed by
element, one film coefficient, and the film's exponent, the supply's resistance and the sinks' heat
capacity held, on several grids. The second half is predicted as in `physics_table`. The error of a
grid is that of the three steps with the values matched on it, against elements of 4 mm.

    python -m benchmarks.placed_cells FOLDER_WITH_RECORDINGS
"""

import argparse
import json
import re
import tomllib
from pathlib import Path

import numpy as np

from benchmarks.physics_table import HALF, hottest_cell, row, second_half
from jaxtwin import Twin, match, read_recording
from jaxtwin.data import data_folder
from jaxtwin.matching._fit import solution_of
from jaxtwin.rig import rig_from_tables

PLACES = (["5.75 cm", "4.25 cm"], ["17 cm", "4.25 cm"])
HELD = {"n_film": 0.2, "R_supply": 0.2, "C_sink": 200.0}
RESOLUTIONS = ("2 cm", "1.5 cm", "1.25 cm", "1.1 cm", "1 cm", "0.8 cm")
FINEST = "0.4 cm"


def placed_text(resolution: str) -> str:
    """The rig file of `dual-cell` with placed cells."""
    text = (data_folder() / "rigs" / "dual-cell.toml").read_text()
    for pattern, replacement in CHANGES:
        text = re.sub(f"^{pattern}$", replacement, text, flags=re.MULTILINE)
    return text.replace("RESOLUTION", resolution)


CHANGES = (
    (
        r"columns = .*\nrows = .*",
        'width = "25.5 cm"\nheight = "11.5 cm"\nresolution = "RESOLUTION"',
    ),
    (r"film_coefficient = .*\nfilm_row_factor = .*", 'film_coefficient = "h_A"'),
    (r"(h_B|h_C|f_row1|f_row3|R_pc\d_(row1|end)) = .*", ""),
    *(
        (
            rf"contacts = .* = \"R_pc{number}_.*",
            f'at = {json.dumps(place)}\nsize = "4 cm"\ncontact_resistance = "R_pc{number}"',
        )
        for number, place in enumerate(PLACES, 1)
    ),
    (r"R_pc(\d)_row2 = (.*)", r"R_pc\1 = \2"),
    *(
        (
            rf"{name} = (.*) value = [^,]*(.*) free = true(.*)",
            rf"{name} = \1 value = {value}\2 free = false\3",
        )
        for name, value in HELD.items()
    ),
)
"""Lines of the file and what they become."""


def placed(resolution: str) -> Twin:
    """`dual-cell` with placed cells."""
    return Twin(
        rig_from_tables(tomllib.loads(placed_text(resolution)), "dual-cell with placed cells")
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--resolutions", nargs="+", default=RESOLUTIONS)
    given = parser.parse_args()
    steps = [read_recording(given.folder / f"peltierMIMOStepSec{zone}.mat") for zone in "ABC"]
    other = read_recording(given.folder / "other-day" / "peltierMIMOSecA1.mat")
    heads = ("resolution", "elements", "steps %", "values", "wall s", "both days %", "values")
    heads += ("second half K", "hottest degC", "grid RMS K", "grid largest K")
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for resolution in given.resolutions:
        twin = placed(resolution)
        fit = match(twin, steps)
        fit = match(twin, steps)  # without compilation
        both = match(twin, [*steps, other], groups=[*["steps"] * 3, "full"])
        tail = {
            name: [(float(one.time[one.time > HALF][0]), float(one.time[-1]))]
            for name, one in zip(fit.recordings, steps, strict=True)
        }
        values = {name: one.value for name, one in fit.parameters.items()}
        ends = [
            np.concatenate([Twin(grid.rig, values).simulate(one).temperatures for one in steps])
            for grid in (twin, placed(FINEST))
        ]
        error = ends[0] - ends[1]
        numbers = (
            len(twin.rig.plate.element_names),
            fit.mean_fit_percent,
            len(solution_of(fit).vector),
            fit.wall_time,
            both.mean_fit_percent,
            len(solution_of(both).vector),
            second_half(match(twin, steps, masks=tail)),
            hottest_cell(list(fit.runs.values()), twin),
            float(np.sqrt(np.mean(error**2))),
            float(np.abs(error).max()),
        )
        print(row(resolution, numbers, (0, 2, 0, 1, 2, 0, 2, 0, 3, 3)), flush=True)


if __name__ == "__main__":
    main()
