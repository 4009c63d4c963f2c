"""The report of a fit: any rig, any recordings."""

import os
import time
from pathlib import Path
from typing import Any

from .. import __version__
from .._arguments import of_kind, path_of, whole_number
from .._json_values import json_value
from .._progress import NullProgress, Progress
from ..errors import JaxtwinError
from ..matching import Fit
from ..physics import Twin, network_counts
from ..plots import plot_netlist, to_png
from ..rig import bundled_rigs
from ._page import (
    PAGE,
    Block,
    KeyNumbers,
    ReportPicture,
    Section,
    Text,
    check_folder,
    environment_section,
    files_table,
    new_folder,
    page_html,
    write_page,
)
from ._parameters import fit_numbers, parameters_section, sensitivity_section
from ._recordings import agreement_section, recordings_blocks, residuals_section, uniformity_section

FILES = {
    "fit.toml": "the fit: parameters with their uncertainties, for `--parameters` and `Fit.load`",
    "numbers.json": "the numbers of this page",
    "*.png": "the pictures of this page",
}
DRAWS = {"sensitivity.nc": "draws, costs and indices of the sensitivity analysis"}


def write_report(
    fit: Fit, path: str | os.PathLike[str], *, draws: int = 0, progress: Progress | None = None
) -> Path:
    """Writes a fit as a page: rig, recordings, parameters, residuals.

    **Arguments:**

    - `fit`: a match with its recordings.
    - `path`: the folder of the report. An older report there is replaced.
    - `draws`: the number of draws of a sensitivity analysis; 0 leaves it out.
    - `progress`: shows the progress.

    **Returns:** the path of the page, `index.html`, with its pictures inside. The fit, the pictures
    and all numbers are files beside it.

    **Raises:** `MatchError` if the fit was loaded without its recordings; `JaxtwinError` if
    the folder holds something else or cannot be written. Then nothing is written.
    """
    of_kind("fit", fit, Fit, "a Fit, which match(...) and Fit.load(path) return", JaxtwinError)
    draws = whole_number("draws", draws, 0, JaxtwinError)
    folder = path_of("path", path, JaxtwinError)
    check_folder(folder)
    experiments = fit.experiments
    progress = progress or NullProgress()
    began = time.perf_counter()
    with new_folder(folder) as part:
        progress.step("drawing rig and recordings")
        rig, counts = rig_section(fit.twin, "The rig")
        sections = [rig, Section("The recordings", recordings_blocks(experiments))]
        progress.step("drawing recorded beside simulated temperatures")
        sections += [
            agreement_section(fit, "Recorded and simulated temperatures"),
            parameters_section(fit, "Parameters"),
            residuals_section(fit, "Residuals"),
        ]
        numbers: dict[str, Any] = {
            "jaxtwin": __version__,
            "network": counts,
            "fit": fit.to_dict(),
        }
        has_zones = all(len(run.channels) > 1 for run in fit.runs.values())
        if has_zones and fit.twin.rig.has_plate:
            progress.step("drawing the plate")
            even, evenness = uniformity_section(fit)
            sections.append(even)
            numbers["uniformity"] = json_value(evenness)
        files = FILES
        if draws:
            sensed, analysis = sensitivity_section(fit, draws, progress)
            sections.append(sensed)
            numbers["sensitivity"] = analysis.to_dict()
            analysis.save(part / "sensitivity.nc")
            files = FILES | DRAWS
        progress.step("writing the report")
        numbers["wall_time_s"] = time.perf_counter() - began
        sections += [_files(fit, files), environment_section(numbers["wall_time_s"])]
        title = f"{fit.twin.rig.name} matched to {_count(len(experiments), 'recording')}"
        page = page_html(title, _lead(fit), sections, f"Made by jaxtwin {__version__}.")
        write_page(part, page, sections, numbers)
        fit.save(part / "fit.toml")
    return folder / PAGE


def _lead(fit: Fit) -> list[Block]:
    rows = [row for row in fit.parameters.values() if row.free]
    warned = [row.name for row in rows if row.warnings]
    marked = _count(len(warned), "parameter")
    words = f"{marked} of {len(rows)} free ones have warnings: {', '.join(warned)}."
    blocks: list[Block] = [
        Text(
            f"{fit.twin.rig.title or fit.twin.rig.name}, matched to {', '.join(fit.recordings)} on "
            f"{fit.date[:10]}. The match ended with: {fit.status}."
        ),
        fit_numbers(fit),
    ]
    if warned:
        blocks.append(Text(words))
    return blocks


def _files(fit: Fit, files: dict[str, str]) -> Section:
    rig = fit.twin.rig
    source = rig.name if rig.name in bundled_rigs() else rig.source
    return Section(
        "How to use the matched twin",
        (
            Text("Commands and Python take the file of the fit:"),
            Text(
                f"`jaxtwin simulate {source} --parameters fit.toml --duty 0:0.5 --duration 600 "
                "--out run.nc`"
            ),
            Text('`jaxtwin.Fit.load("fit.toml")`'),
            files_table(files),
        ),
    )


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"


# Count of a network, its form, and what it is.
_COUNTS = (
    ("plate_nodes", "{:.0f}", "plate elements"),
    ("plate_resistances", "{:.0f}", "resistances on the plate"),
    ("states", "{:.0f}", "states"),
    ("resistances", "{:.0f}", "resistances"),
    ("plate_capacitance_J_per_K", "{:.1f} J/K", "heat capacity of the plate"),
    ("plate_to_ambient_W_per_K", "{:.3f} W/K", "plate to ambient"),
    ("capacitance_J_per_K", "{:.1f} J/K", "heat capacity"),
    ("to_ambient_W_per_K", "{:.3f} W/K", "to ambient"),
)


def rig_section(
    twin: Twin, title: str, *, note: str = "", caption: str = "The thermal network of the rig."
) -> tuple[Section, dict[str, float | int]]:
    """The rig's description and its network.

    **Arguments:**

    - `twin`: a twin of the rig.
    - `title`: the title of the section.
    - `note`: a paragraph that follows the description.
    - `caption`: the caption of the picture.

    **Returns:** the section, and the network's numbers.
    """
    rig = twin.rig
    counts = network_counts(twin.netlist, rig)
    words = (" ".join(rig.description.split()) or rig.title, note)
    section = Section(
        title,
        (
            *(Text(paragraph) for paragraph in words if paragraph),
            KeyNumbers(
                tuple(
                    (form.format(counts[key]), words)
                    for key, form, words in _COUNTS
                    if key in counts
                )
            ),
            ReportPicture("netlist", to_png(plot_netlist(twin)), caption),
        ),
    )
    return section, counts
