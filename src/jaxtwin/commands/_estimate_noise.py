"""`jaxtwin estimate-noise`: the noise of a rig and its readings, for an observer."""

from pathlib import Path
from typing import Annotated

import typer

from ._options import JsonOption, OverwriteOption, RecordingsArgument
from ._output import check_json, check_new_output, say, say_written, write_json
from ._show_progress import show_progress
from ._sources import open_continuous


def estimate_noise(
    fit: Annotated[Path, typer.Argument(metavar="FIT", help="A saved fit, .toml.")],
    recordings: RecordingsArgument,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Where to: .toml.")],
    name: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A parameter that drifts from week to week, e.g. R_E."),
    ] = None,
    horizon: Annotated[
        list[float],
        typer.Option(metavar="S", help="A time ahead at which forecasts are judged; repeatable."),
    ] = [60.0, 300.0],  # noqa: B006  typer copies it
    overwrite: OverwriteOption = False,
    json: JsonOption = None,
) -> None:
    """Find the noise with which an observer expects the readings of recordings best."""
    from .. import observers
    from ..matching import Fit

    check_new_output(out, overwrite, ".toml")
    check_json(json)
    with show_progress() as progress:
        progress.step("reading fit and recordings")
        fitted = Fit.load(fit)
        experiments, gaps = open_continuous(fitted.twin.rig, recordings)
        progress.step("estimating the noise")
        noise = observers.estimate_noise(fitted, experiments, names=name or (), horizons=horizon)
        noise.save(out)
    say("\n".join([*gaps, noise.summary()]), json)
    say_written(out, json_path=json)
    write_json(json, {"levels": noise.levels(), "standard_errors": noise.standard_errors})
