"""`jaxtwin backup`: a copy of a recording, also while it grows."""

from pathlib import Path
from typing import Annotated

import typer

from ._output import check_output, say


def backup(
    recording: Annotated[Path, typer.Argument(metavar="FILE", help="What 'record' writes.")],
    copy: Annotated[Path, typer.Argument(metavar="COPY", help="Where to, .db.")],
) -> None:
    """Copy a recording while it is recorded into, with a checksum in COPY.sha256."""
    from ..io import backup_session

    check_output(copy, ".db")
    checksum = backup_session(recording, copy)
    say(f"{copy}: {copy.stat().st_size} bytes, sha256 {checksum}")
