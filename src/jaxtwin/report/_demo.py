"""The paper's five steps, end to end, as a report."""

import json
import time
from pathlib import Path
from typing import Any

from .. import __version__
from .._progress import NullProgress, Progress
from ..matching import Fit
from ..physics import Twin
from ..rig import load_rig
from ._blocks import Block, Numbers, Picture, Section, Text
from ._checks import check_table
from ._define import define, document
from ._deploy import deploy, environment
from ._folder import PAGE, check_folder, new_folder
from ._match import match_fixed, match_own, recover_truth
from ._page import page_html
from ._sensitivity import analyse
from ._simulate import dc_sweeps, plate_map, simulate_published
from ._source import find_source
from ._uniformity import uniformity

RIG = "paper-2024"

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
    """Simulates, matches and analyses the paper's rig, and writes what came of it.

    **Arguments:**

    - `out`: the report's folder; an older report there is replaced, anything else is left alone.
    - `recordings`: the folder of the authors' recordings; None: looked for in the usual places, and
      where they are not found the bundled synthetic ones are taken.
    - `draws`: of the larger of two sensitivity analyses.
    - `progress`: told what is going on.

    **Returns:** the path of the page, `index.html`, with everything inside it. Beside it lie the
    pictures, the matched parameters and all numbers.

    **Raises:** `JaxtwinError` where the folder holds something else or cannot be written;
    `RecordingError` where `recordings` does not hold them. Then nothing is written.
    """
    folder = Path(out)
    check_folder(folder)
    progress = progress or NullProgress()
    began = time.perf_counter()
    progress.step("reading rig and recordings")
    rig = load_rig(RIG)
    source = find_source(None if recordings is None else Path(recordings))
    with new_folder(folder) as part:
        defined, counts = define(Twin(rig))
        documented = document(source)
        progress.step("simulating the published twin")
        swept = dc_sweeps()
        published = Twin(rig, rig.parameter_sets["published"])
        simulated, runs, published_numbers = simulate_published(published, source)
        fixed_section, fixed = match_fixed(rig, source, runs, progress)
        own_section, own = match_own(rig, source, runs, fixed, progress)
        even, evenness = uniformity(own)
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
            deploy(FILES),
            environment(wall_time),
        ]
        lead: list[Block] = [
            Text(
                "Two thermoelectric cells heat a copper plate, and an infrared camera watches "
                "fifteen places on it. This page takes the five steps of Araque et al., “Digital "
                "Twin-Enabled Modelling of a Multivariable Temperature Uniformity Control System” "
                "(Electronics 2024, 13, 1419): define, document, simulate, match, deploy."
            ),
            Text(source.note),
            Numbers(
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
        _write(part, page_html(f"The twin of {RIG}", lead, sections, foot), sections, numbers)
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


def _write(folder: Path, page: str, sections: list[Section], numbers: dict[str, Any]) -> None:
    (folder / PAGE).write_text(page, encoding="utf-8")
    text = json.dumps(numbers, indent=2, ensure_ascii=False, allow_nan=False)
    (folder / "numbers.json").write_text(text + "\n", encoding="utf-8")
    for section in sections:
        for block in section.blocks:
            if isinstance(block, Picture):
                (folder / f"{block.name}.png").write_bytes(block.png)
