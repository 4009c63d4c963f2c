"""`jaxtwin rigs`, `check` and `schema`: a list of the rigs, and the check of a rig file."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._display import aligned
from ._options import JsonOption, RigArgument
from ._output import STDOUT, check_json, check_output, say, say_written, write_json
from ._show_progress import show_progress

if TYPE_CHECKING:
    from ..rig import Rig
    from ..simulation import GridConvergence


def rigs(json: JsonOption = None) -> None:
    """List the bundled rigs."""
    from ..rig import bundled_rigs, load_rig

    check_json(json)
    result = [load_rig(name) for name in bundled_rigs()]
    if json != STDOUT:
        print(aligned([(rig.name, rig.title) for rig in result]))
    write_json(json, {rig.name: {"title": rig.title} for rig in result})


def check(
    rig: RigArgument,
    grid: Annotated[
        float | None,
        typer.Option(
            metavar="K",
            help="Refine the grid of the plate until readings hardly change, and say which "
            "resolution keeps them to this number of kelvins.",
        ),
    ] = None,
    duty: Annotated[
        str, typer.Option(metavar="SCHEDULE", help="Duty cycles for --grid, as of simulate.")
    ] = "0:0.5",
    duration: Annotated[float, typer.Option(metavar="S", help="Of the schedule.")] = 600.0,
    json: JsonOption = None,
) -> None:
    """Check a rig file: say what is wrong, or what was understood."""
    from ..physics import build_netlist, network_counts
    from ..rig import load_rig

    check_json(json)
    loaded = load_rig(rig)
    counts = network_counts(build_netlist(loaded), loaded)
    say(str(loaded), json)
    say(f"  network: {network_line(counts)}", json)
    free = [name for name, row in loaded.parameters.items() if row.free]
    result: dict[str, Any] = {"rig": loaded.name, "free": free, "network": counts}
    if grid is not None:
        convergence = _grid_convergence(loaded, grid, duty, duration)
        say(f"\n{convergence.summary()}", json)
        rows = convergence.to_dataframe().to_dict("records")
        result["grid"] = {"resolution_m": convergence.resolution, "grids": rows}
    write_json(json, result)


def _grid_convergence(
    rig: "Rig", tolerance: float, duty: str, duration: float
) -> "GridConvergence":
    from ..io import Experiment
    from ..physics import Twin
    from ..simulation import grid_convergence

    experiment = Experiment.schedule(duty, duration=duration, cells=len(rig.driven))
    with show_progress() as progress:
        progress.step("refining the grid")
        return grid_convergence(Twin(rig), experiment, tolerance=tolerance)


def schema(
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="A file, .json; - is standard output.")
    ] = STDOUT,
) -> None:
    """Write the JSON Schema of rig files, with which editors complete and check them.

    An editor with Even Better TOML or Taplo reads it from the first line of a rig file:
    #:schema ./rig.schema.json
    """
    from ..rig import json_schema

    if out != STDOUT:
        check_output(out, ".json")
    write_json(out, json_schema())
    if out != STDOUT:
        say_written(out)


def network_line(counts: dict[str, float | int]) -> str:
    """The counts of a network for a person."""
    from ..physics import network_text

    if "plate_nodes" not in counts:
        return (
            f"{network_text(counts)}, {counts['capacitance_J_per_K']:.1f} J/K, "
            f"{counts['to_ambient_W_per_K']:.4g} W/K to ambient"
        )
    return (
        f"{network_text(counts)}, "
        f"{counts['plate_capacitance_J_per_K']:.1f} J/K in the plate, "
        f"{counts['plate_to_ambient_W_per_K']:.4g} W/K from the plate to ambient"
    )
