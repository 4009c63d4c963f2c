"""`jaxtwin netlist`: the thermal network that a rig becomes."""

from pathlib import Path
from typing import Annotated

import typer

from .._whole_file import write_whole_file
from ..errors import JaxtwinError
from ._options import JsonOption, ParameterFileOption, RigArgument, SetOption
from ._output import check_json, check_output, say, say_written, write_json
from ._rigs import network_line
from ._show_progress import show_progress
from ._sources import open_twin


def netlist(
    rig: RigArgument,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="A picture of it, .png.")
    ] = None,
    spice: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The circuit for ngspice, with a 1000 s step run."),
    ] = None,
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    json: JsonOption = None,
) -> None:
    """Turn a rig into its network: count, draw, or export to SPICE."""
    from ..io import Experiment
    from ..physics import network_counts
    from ..rig import load_rig

    check_output(out, ".png")
    check_output(spice, option="--spice")
    check_json(json)
    with show_progress() as progress:
        progress.step(f"reading {rig}")
        loaded = load_rig(rig)
        twin = open_twin(loaded, set_name, parameter_file)
        numbers = network_counts(twin.netlist, loaded)
        if out is not None:
            from ..plots import plot_netlist, to_png

            progress.step(f"drawing into {out}")
            write_whole_file(out, to_png(plot_netlist(twin)), JaxtwinError)
        if spice is not None:
            from ..spice import to_spice

            progress.step(f"writing {spice}")
            step = Experiment.schedule("0:0.5,500:0.78", duration=1000.0, cells=len(loaded.driven))
            write_whole_file(spice, to_spice(twin, step).encode(), JaxtwinError)
    say(f"{loaded.name}: {network_line(numbers)}", json)
    say_written(out, spice, json_path=json)
    write_json(json, {"rig": loaded.name, "network": numbers})
