"""The paper's five steps, end to end, as a report."""

import time
from pathlib import Path
from typing import Any

from .. import __version__
from .._progress import NullProgress, Progress
from ..matching import Fit
from ..physics import Twin
from ..rig import load_rig
from ._demo_match import analyse, match_ambient_per_recording, match_fixed, recover_truth
from ._demo_simulate import Source, dc_sweeps, find_source, plate_map, simulate_published
from ._page import (
    PAGE,
    Block,
    KeyNumbers,
    ReportTable,
    Section,
    Text,
    check_folder,
    environment_section,
    files_table,
    new_folder,
    page_html,
    write_page,
)
from ._recordings import recordings_blocks, uniformity_section
from ._report import rig_section

RIG = "paper-2024"

NETWORK = (
    f"The rig file `{RIG}` holds the circuit exactly as its authors built it. It becomes a network "
    "of heat capacities, thermal resistances and two thermoelectric cells, each with a side at the "
    "plate and a side at its sink."
)

FILES = {
    "numbers.json": "every number of this page",
    "fit-ambient-15.toml": "parameters of the match with the ambient fixed",
    "fit-ambient-per-recording.toml": "parameters of the match with one ambient per recording",
    "sensitivity.nc": "draws, costs and indices of the larger analysis",
    "*.png": "the pictures",
}


def write_demo(
    out: str | Path,
    *,
    recordings: str | Path | None = None,
    draws: int = 10_000,
    progress: Progress | None = None,
) -> Path:
    """Simulates, matches and analyses the paper's rig, and writes the results.

    **Arguments:**

    - `out`: the folder of the report. An older report there is replaced; a folder with other
      contents is refused.
    - `recordings`: the folder of the authors' recordings. With None they are looked for in the
      usual places, and the bundled synthetic ones are used if they are not found.
    - `draws`: the number of draws of the larger of two sensitivity analyses.
    - `progress`: called with each step.

    **Returns:** the path of the page, `index.html`, which needs no other file. The pictures, the
    matched parameters and all numbers are files beside it.

    **Raises:** `JaxtwinError` if the folder holds something else or cannot be written;
    `RecordingError` if `recordings` does not hold them. Then nothing is written.
    """
    folder = Path(out)
    check_folder(folder)
    progress = progress or NullProgress()
    began = time.perf_counter()
    progress.step("reading rig and recordings")
    rig = load_rig(RIG)
    source = find_source(None if recordings is None else Path(recordings))
    with new_folder(folder) as part:
        defined, counts = rig_section(
            Twin(rig),
            "1 Define: the rig and its network",
            note=NETWORK,
            caption="The network with the model file's start-up values.",
        )
        documented = _document(source)
        progress.step("simulating the published twin")
        swept = dc_sweeps()
        published = Twin(rig, rig.parameter_sets["published"])
        simulated, runs, published_numbers = simulate_published(published, source)
        fixed_section, fixed = match_fixed(rig, source, runs, progress)
        own_section, own = match_ambient_per_recording(rig, source, runs, fixed, progress)
        even, evenness = uniformity_section(own, level=3)
        truth_section, truth = recover_truth(rig, progress)
        sensed, few, many = analyse(own, draws, progress)
        progress.step("writing the report")
        wall_time = time.perf_counter() - began
        numbers: dict[str, Any] = {
            "jaxtwin": __version__,
            "recordings": [experiment.name for experiment in source.experiments],
            "real_recordings": source.real,
            "network": counts,
            "published": published_numbers,
            "match_ambient_fixed": fixed.to_dict(),
            "match_ambient_per_recording": own.to_dict(),
            "uniformity": evenness,
            "match_of_known_truth": truth,
            "sensitivity_few": few.to_dict(),
            "sensitivity": many.to_dict(),
            "wall_time_s": wall_time,
        }
        headline = counts | _headline(published_numbers, fixed, own)
        sections = [
            defined,
            documented,
            swept,
            simulated,
            fixed_section,
            own_section,
            plate_map(own),
            even,
            truth_section,
            sensed,
            _deploy(),
            environment_section(wall_time),
        ]
        lead: list[Block] = [
            Text(
                "Two thermoelectric cells heat a copper plate, and an infrared camera watches "
                "fifteen places on it. This page takes the five steps of Araque et al., “Digital "
                "Twin-Enabled Modelling of a Multivariable Temperature Uniformity Control System” "
                "(Electronics 2024, 13, 1419): define, document, simulate, match, deploy."
            ),
            Text(source.note),
            KeyNumbers(
                (
                    (f"{headline['published_mean_fit_percent']:.1f} %", "fit, published values"),
                    (f"{fixed.mean_fit_percent:.1f} %", "fit, matched, ambient 15 °C"),
                    (f"{own.mean_fit_percent:.1f} %", "fit, matched, one ambient per recording"),
                    (f"{wall_time:.0f} s", "for everything on this page"),
                )
            ),
            check_table(headline, source.real),
        ]
        foot = f"Made by jaxtwin {__version__}: `jaxtwin demo`."
        write_page(part, page_html(f"The twin of {RIG}", lead, sections, foot), sections, numbers)
        fixed.save(part / "fit-ambient-15.toml")
        own.save(part / "fit-ambient-per-recording.toml")
        many.save(part / "sensitivity.nc")
    return folder / PAGE


def _headline(published: dict[str, float], fixed: Fit, own: Fit) -> dict[str, float]:
    return {
        "published_mean_fit_percent": published["mean_fit_percent"],
        "published_rmse_K": published["rmse_K"],
        "fixed_mean_fit_percent": fixed.mean_fit_percent,
        "own_mean_fit_percent": own.mean_fit_percent,
    }


def _document(source: Source) -> Section:
    """The section on the recordings."""
    return Section(
        "2 Document: recordings and datasheets",
        (
            Text(source.note),
            *recordings_blocks(
                source.experiments,
                "Recorded temperatures and the duty cycle of both cells (the paper's Fig. 6).",
            ),
            Text(
                "Tables 1 to 4 of the paper are bundled with jaxtwin as data. Where their numbers "
                "disagree with each other or with the authors' model file, "
                '`jaxtwin.data.table(4).column("note")` says so, and docs/paper.md lists it.'
            ),
        ),
    )


def _deploy() -> Section:
    """Step 5 of the paper: the uses of the matched twin."""
    return Section(
        "5 Deploy: what to go on with",
        (
            Text(
                "The matched twin is a file of parameters in the form of a rig file's own table. "
                "Every command takes it, and so does `jaxtwin.read_parameters`:"
            ),
            Text(
                "`jaxtwin simulate paper-2024 --parameters fit-ambient-per-recording.toml --duty "
                "0:0.5,500:0.78 --duration 1000 --out run.nc`"
            ),
            files_table(FILES),
        ),
    )


# Number -> (what it is, what it should be, lowest, highest). Counts and sums are those of the
# authors' model file; the fit of the published values is that of an independent implementation.
EXPECTED_NUMBERS = {
    "plate_nodes": ("plate elements", "24", 24, 24),
    "plate_resistances": ("resistances on the plate", "83", 83, 83),
    "states": ("states", "28", 28, 28),
    "plate_capacitance_J_per_K": ("heat capacity of the plate, J/K", "681.7", 681.6, 681.8),
    "plate_to_ambient_W_per_K": ("plate to ambient, W/K", "4.604", 4.6035, 4.6045),
}
EXPECTED_OF_RECORDINGS = {
    "published_mean_fit_percent": ("mean fit, published values, %", "69.2 ± 0.3", 68.9, 69.5),
    "published_rmse_K": ("RMSE, published values, K", "1.79 ± 0.02", 1.77, 1.81),
    "fixed_mean_fit_percent": ("mean fit, ambient 15 °C, %", "above 69.2", 69.2, 100),
    "own_mean_fit_percent": ("mean fit, one ambient per recording, %", "at least 83", 83, 100),
}


def check_table(numbers: dict[str, float | int], real: bool) -> ReportTable:
    """A table of the demo's numbers beside numbers that are known from elsewhere.

    **Arguments:**

    - `numbers`: the numbers of the demo.
    - `real`: whether the recordings are the paper's; otherwise there is less to compare with.
    """
    expected = EXPECTED_NUMBERS | (EXPECTED_OF_RECORDINGS if real else {})
    rows = []
    for key, (what, should, low, high) in expected.items():
        right = low <= numbers[key] <= high
        rows.append(
            (what, should, f"{numbers[key]:.4g}", "as it should be" if right else "!differs")
        )
    return ReportTable("What can be checked.", ("", "should be", "here", ""), rows)
