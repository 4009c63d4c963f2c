"""`jaxtwin validate`: predictions of recordings that a match has not seen."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from .._progress import Progress
from ._options import JsonOption, NoiseOption, RecordingsArgument, RigArgument, SetOption
from ._output import check_folder, check_json, say, say_written, write_json, write_pictures
from ._show_progress import show_progress
from ._sources import open_fit, open_recordings, open_twin

if TYPE_CHECKING:
    from ..io import Experiment
    from ..matching import Fit, Iteration
    from ..physics import Twin
    from ..rig import Rig
    from ..validation import Prediction, Validation


def validate(
    rig: RigArgument,
    recordings: RecordingsArgument,
    parameter_file: Annotated[
        Path | None,
        typer.Option(
            "--parameters",
            metavar="FILE",
            help="A saved fit: what is validated; with --split or --leave-one-out the start.",
        ),
    ] = None,
    split: Annotated[
        float | None,
        typer.Option(metavar="S", help="Match what is before this time, predict the rest."),
    ] = None,
    leave_one_out: Annotated[
        bool,
        typer.Option("--leave-one-out", help="Predict each recording from a match to the others."),
    ] = False,
    leave_group_out: Annotated[
        bool,
        typer.Option(
            "--leave-group-out",
            help="Predict the recordings of each group, such as a day, from the other groups.",
        ),
    ] = False,
    warm_up: Annotated[
        float,
        typer.Option(
            metavar="S", help="Part of a recording from which its room and start are estimated."
        ),
    ] = 60.0,
    group: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Group of the recordings, such as their day; with --leave-group-out one for each "
            "recording, in order.",
        ),
    ] = None,
    given: Annotated[
        list[str] | None,
        typer.Option(
            metavar="S|RECORDING",
            help="Estimate what differs between groups from this part of each recording, or from "
            "another recording of the group; recordings may be repeated.",
        ),
    ] = None,
    noise: NoiseOption = None,
    set_name: SetOption = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="A folder for pictures of the residuals, .png."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Predict recordings that a match has not seen: fits, residuals, tests of whiteness."""
    from ..rig import load_rig

    ways = [split is not None, leave_one_out, leave_group_out]
    if sum(ways) > 1:
        raise typer.BadParameter("give one of --split, --leave-one-out and --leave-group-out")
    if not any(ways) and parameter_file is None and set_name is None:
        raise typer.BadParameter(
            "give --parameters, or match with --split, --leave-one-out or --leave-group-out"
        )
    if ((group or given) and (split is not None or leave_one_out)) or (given and leave_group_out):
        raise typer.BadParameter(
            "give --group and --given with --parameters, not with --split or --leave-one-out; "
            "--leave-group-out takes --group alone"
        )
    if noise is not None and (any(ways) or parameter_file is None):
        raise typer.BadParameter("give --noise with --parameters, without --split or --leave-...")
    if len(group or ()) > 1 and not leave_group_out:
        raise typer.BadParameter(
            f"--group: expected one name, got {len(group or ())}; only --leave-group-out takes one "
            "for each recording"
        )
    for option, value in (("--split", split), ("--warm-up", warm_up)):
        if value is not None and not math.isfinite(value):
            raise typer.BadParameter(f"{option}: expected a finite number, got {value:g}")
    check_folder(out)
    check_json(json)
    with show_progress() as progress:
        progress.step("reading")
        loaded = load_rig(rig)
        experiments = open_recordings(loaded, recordings)
        fitted = open_fit(loaded, parameter_file) or open_twin(loaded, set_name, parameter_file)

        day = (group, None if given is None else _given(loaded, given))
        left_out = "group" if leave_group_out else "recording" if leave_one_out else None
        progress.step(f"validating {loaded.name} on {len(experiments)} recordings")
        listener = _ValidationProgress(progress, len(experiments))
        result = _validate(
            fitted,
            experiments,
            split,
            left_out,
            warm_up=warm_up,
            day=day,
            noise=noise,
            on_progress=listener,
        )
        if out is not None:
            progress.step(f"drawing into {out}")
            _draw(result, out)
    say(result.summary(), json)
    say_written(out, json_path=json)
    write_json(json, result.to_dict())


def _given(rig: "Rig", texts: list[str]) -> "float | list[Experiment]":
    """The length of each recording's first part, s, or other recordings."""
    try:
        (span,) = map(float, texts)
    except ValueError:
        return open_recordings(rig, texts)
    return span


def _validate(
    fitted: "Twin | Fit",
    experiments: "list[Experiment]",
    split: float | None,
    left_out: Literal["recording", "group"] | None,
    *,
    warm_up: float,
    day: "tuple[list[str] | None, float | list[Experiment] | None]",
    noise: Path | None,
    on_progress: "_ValidationProgress",
) -> "Validation":
    from .. import validation
    from ..observers import ProcessNoise

    groups, given = day
    if split is not None:
        return validation.validate_split(fitted, experiments, split, on_progress=on_progress)
    if left_out is not None:
        return validation.leave_one_out(
            fitted,
            experiments,
            by=left_out,
            warm_up=warm_up,
            groups=groups,
            on_progress=on_progress,
        )
    return validation.validate(
        fitted,
        experiments,
        warm_up=warm_up,
        group=groups[0] if groups else None,
        given=given,
        noise=None if noise is None else ProcessNoise.load(noise),
        on_progress=on_progress,
    )


class _ValidationProgress:
    """Progress of a validation, as text."""

    def __init__(self, progress: Progress, recordings: int):
        self.progress, self.recordings = progress, recordings
        self.done = 0
        self.progress.update(f"0 of {recordings} predicted")

    def __call__(self, newest: "Iteration | Prediction") -> None:
        """Counts a predicted recording, or a step of a match."""
        from ..matching import Iteration

        matching = isinstance(newest, Iteration)
        self.done += not matching
        tail = f", matching: {newest}" if matching else ""
        self.progress.update(f"{self.done} of {self.recordings} predicted{tail}")


def _draw(result: "Validation", folder: Path) -> None:
    from ..plots import plot_comparison, plot_residual_tests

    runs = list(result.runs.values())
    pictures = {"response": plot_comparison(runs), "residuals": plot_residual_tests(runs)}
    write_pictures(folder, pictures.items())
