"""`jaxtwin match`: parameters from recordings."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ._exit_codes import NOT_CONVERGED
from ._options import (
    GapsOption,
    JsonOption,
    ParameterFileOption,
    RecordingsArgument,
    RigArgument,
    SeedOption,
    SetOption,
)
from ._output import check_json, check_output, say, say_written, write_json
from ._show_progress import show_progress
from ._sources import open_fit, open_recordings, open_twin

if TYPE_CHECKING:
    from ..matching import Iteration


def match(
    rig: RigArgument,
    recordings: RecordingsArgument,
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="The matched parameters, .toml.")
    ],
    free: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Match this parameter, instead of those that the rig calls free; may be repeated.",
        ),
    ] = None,
    fixed: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Hold this parameter; may be repeated."),
    ] = None,
    shared: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Match this parameter too, one value for all recordings; may be repeated.",
        ),
    ] = None,
    per_recording: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Match this parameter too, one value for each recording; may be repeated.",
        ),
    ] = None,
    group: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Group of a recording, such as its day: once for each recording, in their order.",
        ),
    ] = None,
    gaps: GapsOption = "hold",
    starts: Annotated[int, typer.Option(min=1, help="Starting points; the best end counts.")] = 1,
    seed: SeedOption = 0,
    max_iterations: Annotated[int, typer.Option(min=1, help="Of each start.")] = 200,
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    json: JsonOption = None,
) -> None:
    """Match the free parameters of a rig to recordings; start at its own or given values.

    The exit code is 4 if the match did not converge; the file is written all the same.
    """
    check_output(out, ".toml")
    check_json(json)
    with show_progress() as progress:
        progress.step("reading")
        from .. import matching  # which takes a second
        from ..rig import load_rig

        loaded = load_rig(rig)
        experiments = open_recordings(loaded, recordings)
        twin = open_fit(loaded, parameter_file) or open_twin(loaded, set_name, parameter_file)

        def show(iteration: "Iteration") -> None:
            where = f"start {iteration.start + 1} of {starts}, " if starts > 1 else ""
            progress.update(f"{where}{iteration}")

        progress.step(f"matching {loaded.name} to {len(experiments)} recordings")
        fit = matching.match(
            twin,
            experiments,
            free=free or None,
            fixed=fixed or [],
            shared=shared or [],
            per_recording=per_recording or [],
            groups=group or None,
            gaps=gaps,
            starts=starts,
            seed=seed,
            max_iterations=max_iterations,
            on_progress=show,
        )
        progress.step(f"writing {out}")
        fit.save(out)
    say(fit.summary(), json)
    say_written(out, json_path=json)
    write_json(json, fit.to_dict())
    if not fit.converged:
        raise typer.Exit(NOT_CONVERGED)
