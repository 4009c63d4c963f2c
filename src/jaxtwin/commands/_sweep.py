"""`jaxtwin sweep`: millions of draws into a folder, in several runs, processes and hosts."""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ._dask import dask_executor
from ._options import JsonOption, ParameterFileOption, RigArgument, SeedOption, SetOption
from ._output import check_json, say, say_written, write_json
from ._show_progress import show_progress
from ._sources import open_recordings, open_twins

if TYPE_CHECKING:
    from ..io import Experiment
    from ..rig import Rig
    from ..sweeps import Sweep


def sweep(
    rig: RigArgument,
    draws: Annotated[int, typer.Option(min=1, help="How many.")],
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="DIR", help="A new folder, or one of this sweep: then it goes on."
        ),
    ],
    recordings: Annotated[
        list[str] | None,
        typer.Argument(metavar="RECORDING", help="Drive it as in these, and compare."),
    ] = None,
    duty: Annotated[
        str | None,
        typer.Option(
            metavar="SCHEDULE", help="Drive it by a schedule: 0:0.5,500:0.78; see simulate."
        ),
    ] = None,
    duration: Annotated[float, typer.Option(metavar="S", help="Of the schedule.")] = 1000.0,
    spread: Annotated[
        float, typer.Option(help="Standard deviation as a part of each value.")
    ] = 0.25,
    seed: SeedOption = 0,
    reductions: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="What to keep, such as cost,energy: names among cost, final, minimum, maximum, "
            "plate_range, plate_std, energy and peak_power. Default: final, and cost with "
            "recordings.",
        ),
    ] = None,
    precision: Annotated[
        Literal["float64", "float32"], typer.Option(help="Of the computation and what is kept.")
    ] = "float64",
    chunk: Annotated[
        int, typer.Option(min=1, help="Draws that are written at a time; a kill costs these.")
    ] = 65536,
    dask: Annotated[
        str | None,
        typer.Option(metavar="HOST:PORT", help="Scheduler of a Dask cluster that computes."),
    ] = None,
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    json: JsonOption = None,
) -> None:
    """Simulate millions of draws and keep reductions of them; run it again to resume."""
    if bool(recordings) == (duty is not None):
        raise typer.BadParameter("give either recordings or --duty")
    check_json(json)
    with show_progress() as progress:
        progress.step("reading")
        from .. import sweep as run  # which takes a second
        from ..rig import load_rig
        from ..sweeps import SweepProgress

        loaded = load_rig(rig)
        experiments = _experiments(loaded, recordings or [], duty, duration)
        twins = open_twins(loaded, set_name, parameter_file, experiments)

        def report(advance: SweepProgress) -> None:
            progress.update(str(advance))

        with ExitStack() as stack:
            executor = None
            if dask is not None:
                progress.step(f"connecting to {dask}")
                executor = stack.enter_context(dask_executor(dask))
            progress.step(f"{draws} draws of {loaded.name} into {out}")
            result = run(
                twins,
                experiments,
                out,
                draws=draws,
                spread=spread,
                seed=seed,
                reductions=None if reductions is None else reductions.split(","),
                precision=precision,
                chunk_size=chunk,
                executor=executor,
                on_progress=report,
            )
    say(_summary(result), json)
    say_written(out, json_path=json)
    write_json(json, result.to_dict())


def _experiments(
    rig: "Rig", recordings: list[str], duty: str | None, duration: float
) -> "list[Experiment]":
    from ..io import Experiment

    if recordings:
        return open_recordings(rig, recordings)
    return [Experiment.schedule(duty or "", duration=duration, cells=len(rig.driven))]


def _summary(result: "Sweep") -> str:
    lines = [
        f"{result.done} of {result.draws} draws are done, {result.failed} of them failed",
        f"this run did {result.new} in {result.wall_time:.1f} s",
    ]
    if result.busy:
        lines.append(f"{result.busy} chunks were left to another process that is at them")
    return "\n".join(lines)
