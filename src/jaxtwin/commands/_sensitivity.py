"""`jaxtwin sensitivity`: which parameters matter."""

from pathlib import Path
from typing import Annotated, Any

import typer

from ._options import (
    JsonOption,
    ParameterFileOption,
    RecordingsArgument,
    RigArgument,
    SeedOption,
    SetOption,
)
from ._output import check_json, check_output, say, say_written, write_json
from ._show_progress import show_progress
from ._sources import open_recordings, open_twins

# The method of the paper.
PAPERS = "correlations"


def sensitivity(
    rig: RigArgument,
    recordings: RecordingsArgument,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Draws, costs, indices: .nc.")],
    method: Annotated[
        str,
        typer.Option(
            help="correlations (the paper's), pearson, spearman, src, prcc, oat, morris, sobol, "
            "shapley, dgsm or pce; docs/sensitivity.md says which answers what."
        ),
    ] = PAPERS,
    draws: Annotated[
        int | None,
        typer.Option(min=3, help="How many; by default 50, as in the paper, or the method's own."),
    ] = None,
    spread: Annotated[
        float, typer.Option(help="Standard deviation as a part of each value.")
    ] = 0.25,
    inputs: Annotated[
        str, typer.Option(help="What is drawn: normal, lognormal, bounds or priors.")
    ] = "normal",
    output: Annotated[
        list[str],
        typer.Option(
            help="What is looked at, beside another method than correlations: cost, final, "
            "minimum, maximum, plate_range, plate_std, energy, peak_power, uniformity or "
            "temperature; may be repeated."
        ),
    ] = ["cost"],  # noqa: B006 - read only
    second_order: Annotated[
        bool, typer.Option("--second-order", help="Interactions S2 too, beside --method sobol.")
    ] = False,
    seed: SeedOption = 0,
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    json: JsonOption = None,
) -> None:
    """Run a rig with other values of its parameters, and say which of them matter."""
    check_output(out, ".nc")
    check_json(json)
    if method == PAPERS and (inputs != "normal" or output != ["cost"]):
        raise typer.BadParameter(
            "--inputs and --output: expected another --method beside them, such as pearson or "
            f"sobol, got {method}"
        )
    if second_order and method != "sobol":
        raise typer.BadParameter(f"--second-order: expected --method sobol beside it, got {method}")
    with show_progress() as progress:
        progress.step("reading")
        from .. import global_sensitivity  # which takes a second
        from .. import sensitivity as papers_analysis
        from ..rig import load_rig
        from ..sensitivity_analysis import Sobol

        loaded = load_rig(rig)
        experiments = open_recordings(loaded, recordings)
        twins = open_twins(loaded, set_name, parameter_file, experiments)
        progress.step(f"{method} on {len(experiments)} recordings")
        options: dict[str, Any] = {"spread": spread, "seed": seed}
        if draws is not None:
            options["draws"] = draws
        if method == PAPERS:
            result = papers_analysis(twins, experiments, **options)
        else:
            options |= {"inputs": inputs, "outputs": tuple(output)}
            options["method"] = Sobol(second_order=True) if second_order else method
            result = global_sensitivity(twins, experiments, **options)
        progress.step(f"writing {out}")
        result.save(out)
    say(result.summary(), json)
    say_written(out, json_path=json)
    write_json(json, result.to_dict())
