"""`jaxtwin design`: the duty schedule whose recording is the most informative."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ._options import (
    JsonOption,
    NoiseOption,
    ParameterFileOption,
    RigArgument,
    SeedOption,
    SetOption,
)
from ._output import check_json, check_output, say, say_written, write_json
from ._show_progress import show_progress
from ._sources import open_fit, open_recordings, open_twin

if TYPE_CHECKING:
    from ..experiment_design import DiagnosisDesign, ExperimentDesign
    from ..matching import Fit
    from ..physics import Twin
    from ..rig import Rig


def design(
    rig: RigArgument,
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help="The schedule, for 'jaxtwin drive --plan'; .csv."
        ),
    ],
    recordings: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="RECORDING",
            help="The recordings of the fit, to compare with their steps and to keep their duty "
            "cycles as bounds.",
        ),
    ] = None,
    purpose: Annotated[
        Literal["match", "diagnosis"],
        typer.Option(help="match: parameters with small errors; diagnosis: tell faults apart."),
    ] = "match",
    fault: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Of a diagnosis: a fault, such as 'loosen P1'; two or more. 'jaxtwin diagnose' "
            "names them.",
        ),
    ] = None,
    noise: NoiseOption = None,
    parameter_file: ParameterFileOption = None,
    set_name: SetOption = None,
    duration: Annotated[
        float, typer.Option(metavar="S", help="Of the recording, 3600 s at most.")
    ] = 1200.0,
    hold: Annotated[float, typer.Option(metavar="S", help="Of each step.")] = 60.0,
    bounds: Annotated[
        str | None,
        typer.Option(
            metavar="LOW:HIGH",
            help="Lowest and highest duty cycle; by default those of the recordings.",
        ),
    ] = None,
    levels: Annotated[int, typer.Option(min=2, help="Duty cycles to choose from.")] = 5,
    criterion: Annotated[
        Literal["D", "A"],
        typer.Option(help="D: smallest confidence ellipsoid; A: smallest mean variance."),
    ] = "D",
    interest: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Parameter of interest; may be repeated. By default all of the rig's.",
        ),
    ] = None,
    group: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Group of the new recording; by default a new one."),
    ] = None,
    margin: Annotated[
        float, typer.Option(metavar="K", help="Stay so far below the limits of the rig.")
    ] = 5.0,
    starts: Annotated[int, typer.Option(min=1, help="Searches from different schedules.")] = 1,
    seed: SeedOption = 0,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="A picture, .png.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Find the duty schedule whose recording is the most informative about the parameters of a rig.

    With a saved fit as --parameters its standard errors are what is known today; otherwise the
    priors of the rig file are. With --purpose diagnosis it is the schedule that tells faults apart
    soonest.
    """
    check_output(out, ".csv")
    if plot is not None:
        check_output(plot, ".png")
    check_json(json)
    between = None if bounds is None else _bounds(bounds)
    with show_progress() as progress:
        progress.step("reading")
        from ..experiment_design import DiagnosisDesign, ExperimentDesign, design_experiment
        from ..observers import ProcessNoise
        from ..rig import load_rig

        loaded = load_rig(rig)
        known = _known(loaded, parameter_file, set_name, recordings or [])
        progress.step(f"designing {duration:g} s for {loaded.name}")
        settings: dict[str, Any] = {
            "duration": duration,
            "hold": hold,
            "bounds": between,
            "levels": levels,
            "criterion": criterion,
            "names": interest,
            "group": group,
            "margin": margin,
            "starts": starts,
            "seed": seed,
            "on_progress": lambda step: progress.update(str(step)),
        }
        if purpose == "diagnosis" or fault or noise is not None:
            levels_of_noise = None if noise is None else ProcessNoise.load(noise)
            settings |= {"purpose": purpose, "faults": fault or [], "noise": levels_of_noise}
        result: ExperimentDesign | DiagnosisDesign = design_experiment(known, **settings)
        progress.step(f"writing {out}")
        result.save(out)
        if plot is not None:
            _draw(result, plot)
    say(result.summary(), json)
    say_written(out, plot, json_path=json)
    write_json(json, result.to_dict())


def _known(
    rig: "Rig", parameter_file: Path | None, set_name: str | None, recordings: list[str]
) -> "Fit | Twin":
    fit = open_fit(rig, parameter_file)
    if fit is None:
        if recordings:
            raise typer.BadParameter(
                "recordings: expected a saved fit of them as --parameters, got none; "
                "'jaxtwin match' makes it"
            )
        return open_twin(rig, set_name, parameter_file)
    if parameter_file is None or not recordings:
        return fit
    from ..matching import Fit

    return Fit.load(parameter_file, rig=rig, experiments=open_recordings(rig, recordings))


def _bounds(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise typer.BadParameter(
            f"--bounds: expected LOW:HIGH such as -0.5:0.8, got {text!r}"
        ) from None
    return low, high


def _draw(result: "ExperimentDesign | DiagnosisDesign", path: Path) -> None:
    from .._whole_file import write_whole_file
    from ..errors import JaxtwinError
    from ..plots import plot_design, to_png

    write_whole_file(path, to_png(plot_design(result)), JaxtwinError)
