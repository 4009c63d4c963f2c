"""`jaxtwin health`: how the parameters of a rig change over sessions."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ._exit_codes import ALARMED, NOT_CONVERGED
from ._options import JsonOption
from ._output import check_json, check_output, say, say_written, write_json
from ._show_progress import show_progress
from ._sources import open_store

if TYPE_CHECKING:
    from ..matching import Fit
    from ..twin_store import TwinStore


def health(
    sessions: Annotated[
        list[Path],
        typer.Argument(
            metavar="STORE|FIT...",
            help="A store of twins, .db; or fits of three sessions or more, .toml, each matched by "
            "itself, in the order of time.",
        ),
    ],
    times: Annotated[
        str | None,
        typer.Option(
            metavar="LIST",
            help="When the sessions were, with commas between: dates such as 2026-01-31, or days.",
        ),
    ] = None,
    limit: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE", help="A value that a parameter should not pass; may be repeated."
        ),
    ] = None,
    within: Annotated[
        float | None,
        typer.Option(
            min=0,
            metavar="N",
            help="How far ahead: days; sessions if no times are given. Otherwise as far as the "
            "sessions reach back.",
        ),
    ] = None,
    probability: Annotated[
        float,
        typer.Option(min=0, max=1, help="An alarm if a limit is passed at least so likely."),
    ] = 0.5,
    name: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="A parameter to look at; may be repeated. Else all."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="A chart, .png.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Find how the parameters of a rig change over sessions: the trend of each with its standard
    error, the spread between sessions, what changed most, and how likely a limit is passed.

    The exit code is 5 if a limit is passed with the probability that --probability names or a
    higher one, and 4 if the match of a session did not converge.
    """
    from .._whole_file import write_whole_file
    from ..errors import JaxtwinError
    from ..prognostics import health as found_health

    check_output(out, ".png")
    check_json(json)
    pairs = [_limit(text) for text in limit or []]
    limits = dict(pairs)
    if len(limits) < len(pairs):
        raise typer.BadParameter("--limit: expected each parameter once")
    when = None if times is None else [_time(part) for part in times.split(",")]
    with show_progress() as progress:
        progress.step("reading")
        result = found_health(
            _sessions(sessions), when, limits=limits, within=within, names=name or None
        )
        if out is not None:
            from ..plots import to_png

            progress.step(f"drawing {out}")
            write_whole_file(out, to_png(result.plot()), JaxtwinError)
    say(result.summary(), json)
    say_written(out, json_path=json)
    write_json(json, result.to_dict())
    if any(value >= probability for value in result.probabilities.values()):
        raise typer.Exit(ALARMED)
    if not all(result.converged):
        raise typer.Exit(NOT_CONVERGED)


def _sessions(paths: list[Path]) -> "TwinStore | dict[str, Fit]":
    from ..matching import Fit

    if len(paths) == 1 and paths[0].suffix == ".db":
        return open_store(paths[0])
    names = [path.stem for path in paths]
    if len(set(names)) < len(names):
        names = [str(path) for path in paths]
    return {name: Fit.load(path) for name, path in zip(names, paths, strict=True)}


def _limit(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise typer.BadParameter(
            f"--limit {text}: expected a parameter and a number, such as R_E=2.6"
        ) from None


def _time(text: str) -> str | float:
    try:
        return float(text)
    except ValueError:
        return text.strip()
