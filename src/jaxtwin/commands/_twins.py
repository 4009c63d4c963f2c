"""`jaxtwin twins`: a store of twins looked at, and its champion changed by a person."""

from pathlib import Path
from typing import Annotated

import typer

from ._options import JsonOption, NoiseOption
from ._output import check_json, check_output, say, write_json
from ._sources import open_store

StoreArgument = Annotated[Path, typer.Argument(metavar="STORE", help="A store of twins, .db.")]
ReasonOption = Annotated[str, typer.Option(metavar="TEXT", help="Why, in a sentence; it is kept.")]


def list_versions(store: StoreArgument, json: JsonOption = None) -> None:
    """List the versions of a store with their aliases."""
    check_json(json)
    twins = open_store(store)
    say(twins.summary(), json)
    numbers = [version.to_dict() for version in twins.versions]
    write_json(json, {"versions": numbers, "aliases": twins.aliases})


def show(
    store: StoreArgument,
    version: Annotated[str, typer.Argument(help="An alias or a number.")] = "champion",
    json: JsonOption = None,
) -> None:
    """Show what is known of a version: its parameters, recordings, reason, tags, and the moves of
    its aliases."""
    check_json(json)
    twins = open_store(store)
    result = twins.version(version)
    moves = [move for move in twins.history() if result.number in (move.before, move.after)]
    lines = [result.summary(), *(f"  {move}" for move in moves), result.fit().summary()]
    say("\n".join(lines), json)
    write_json(json, {**result.to_dict(), "fit": result.fit().to_dict()})


def diff(
    store: StoreArgument,
    old: Annotated[str, typer.Argument(help="An alias or a number.")] = "previous",
    new: Annotated[str, typer.Argument(help="An alias or a number.")] = "champion",
    json: JsonOption = None,
) -> None:
    """Compare two versions: how many standard errors their parameters are apart, recordings, rig
    file and software."""
    check_json(json)
    difference = open_store(store).diff(old, new)
    say(difference.summary(), json)
    write_json(json, difference.to_dict())


def add(
    store: StoreArgument,
    fit: Annotated[Path, typer.Argument(metavar="FIT", help="A fit that match wrote, .toml.")],
    reason: ReasonOption = "added by hand",
    noise: NoiseOption = None,
) -> None:
    """Add a saved fit to a store, which is made where there is none. The first version is the
    champion; another one is the challenger."""
    from ..matching import Fit
    from ..observers import ProcessNoise
    from ..twin_store import TwinStore

    check_output(store, ".db")
    loaded = Fit.load(fit)
    levels = None if noise is None else ProcessNoise.load(noise)
    twins = TwinStore(store)
    has_champion = "champion" in twins.aliases
    added = twins.add(
        loaded,
        reason=reason,
        noise=levels,
        parent="champion" if has_champion else None,
        aliases=["challenger" if has_champion else "champion"],
    )
    say(f"{store}: version {added.number} [{', '.join(added.aliases)}]")


def promote(
    store: StoreArgument,
    version: Annotated[str, typer.Argument(help="An alias or a number.")] = "challenger",
    reason: ReasonOption = "promoted by hand",
) -> None:
    """Make a version the champion; the champion so far is 'previous' from then on."""
    champion = open_store(store).promote(version, reason=reason)
    say(f"{store}: the champion is version {champion.number}")


def rollback(store: StoreArgument, reason: ReasonOption = "rolled back by hand") -> None:
    """Make the previous champion the champion again; a second rollback takes it back."""
    champion = open_store(store).rollback(reason=reason)
    say(f"{store}: the champion is version {champion.number}")
