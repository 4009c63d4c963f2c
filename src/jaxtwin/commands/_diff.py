"""`jaxtwin diff`: the differences between two saved fits."""

from pathlib import Path
from typing import Annotated

import typer

from ._options import JsonOption
from ._output import check_json, say, write_json


def diff(
    old: Annotated[Path, typer.Argument(metavar="OLD", help="A saved fit, .toml.")],
    new: Annotated[Path, typer.Argument(metavar="NEW", help="Another fit of the rig.")],
    json: JsonOption = None,
) -> None:
    """Compare two saved fits: how many standard errors their parameters are apart."""
    from ..matching import Fit, compare_fits

    check_json(json)
    difference = compare_fits(Fit.load(old), Fit.load(new))
    say(difference.summary(), json)
    write_json(json, difference.to_dict())
