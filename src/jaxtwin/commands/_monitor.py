"""`jaxtwin monitor`: what changes in a rig during recordings."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ._exit_codes import ALARMED
from ._options import JsonOption, NoiseOption, RecordingsArgument
from ._output import (
    check_folder,
    check_json,
    check_output,
    say,
    say_written,
    write_json,
    write_pictures,
)
from ._show_progress import show_progress
from ._sources import open_continuous

if TYPE_CHECKING:
    from ..monitoring import Monitored


def monitor(
    fit: Annotated[Path, typer.Argument(metavar="FIT", help="A fit that match wrote, .toml.")],
    recordings: RecordingsArgument,
    noise: NoiseOption = None,
    healthy: Annotated[
        list[str] | None,
        typer.Option(
            metavar="RECORDING",
            help="A healthy recording from which thresholds follow, such as one of the match; may "
            "be repeated.",
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="What is healthy, as --save wrote it."),
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option("--save", metavar="FILE", help="Keep what --healthy found, .toml."),
    ] = None,
    days: Annotated[
        float, typer.Option(metavar="N", help="Mean time between two false alarms, days.")
    ] = 30.0,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="A folder for timelines, .png.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Find what changes in a rig: sudden changes, frozen, drifting and gone channels, states that
    no healthy rig has, and parameters that differ from the recordings of the match.

    The exit code is 5 where there was an alarm. A parameter that has changed is a notice.
    """
    from ..matching import Fit
    from ..monitoring import DAY, MonitorCalibration, calibrate_monitor
    from ..monitoring import monitor as monitored
    from ..observers import ProcessNoise

    if healthy and calibration is not None:
        raise typer.BadParameter("give one of --healthy and --calibration")
    if save is not None and not healthy:
        raise typer.BadParameter("--save keeps what --healthy finds; give both")
    if not math.isfinite(days):
        raise typer.BadParameter(f"--days: expected a finite number, got {days:g}")
    check_folder(out)
    check_output(save, ".toml", option="--save")
    check_json(json)
    with show_progress() as progress:
        progress.step("reading")
        loaded = Fit.load(fit)
        rig = loaded.twin.rig
        experiments, gaps = open_continuous(rig, recordings)
        levels = None if noise is None else ProcessNoise.load(noise)
        known = None if calibration is None else MonitorCalibration.load(calibration)
        if healthy:
            progress.step(f"calibrating on {len(healthy)} recordings")
            known = calibrate_monitor(loaded, open_continuous(rig, healthy)[0], levels)
            if save is not None:
                known.save(save)
        result: list[Monitored] = []
        for recording in experiments:
            progress.step(f"monitoring {recording.name}")
            result.append(
                monitored(loaded, recording, levels, calibration=known, false_alarm_time=DAY * days)
            )
        if out is not None:
            progress.step(f"drawing into {out}")
            names = [experiment.name or number for number, experiment in enumerate(experiments, 1)]
            plots = (monitored.plot() for monitored in result)
            write_pictures(out, zip(map(str, names), plots, strict=True))
    say("\n".join([*gaps, *(monitored.summary() for monitored in result)]), json)
    say_written(save, out, json_path=json)
    write_json(json, {"recordings": [monitored.to_dict() for monitored in result]})
    if any(monitored.alarms for monitored in result):
        raise typer.Exit(ALARMED)
