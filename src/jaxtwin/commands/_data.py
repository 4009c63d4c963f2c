"""`jaxtwin data`: recordings, listed and fetched."""

from pathlib import Path
from typing import Annotated

import typer

from .._display import aligned
from ._options import JsonOption
from ._output import check_json, say, write_json
from ._show_progress import show_progress


def list_recordings(json: JsonOption = None) -> None:
    """List the known recordings and where they are."""
    from ..data import synthetic_recordings
    from ..io import SINGLE_CELL, TWO_CELL

    check_json(json)
    rows = {path.stem: ("made by a twin", str(path)) for path in synthetic_recordings()}
    for kind, known in (("two cells", TWO_CELL), ("one cell", SINGLE_CELL)):
        for recording in known:
            rows[Path(recording.name).stem] = (kind, _place(recording.name))
    say(aligned([(name, *row) for name, row in rows.items()]), json)
    if any(not place for _, place in rows.values()):
        say("'jaxtwin data fetch' downloads what is missing", json)
    write_json(json, {name: {"kind": k, "path": p or None} for name, (k, p) in rows.items()})


def fetch(
    folder: Annotated[
        Path | None,
        typer.Option("--to", metavar="DIR", help="A folder; default: the user's cache."),
    ] = None,
) -> None:
    """Download the authors' recordings and compare their checksums."""
    from ..io import fetch_recordings

    with show_progress() as progress:
        paths = fetch_recordings(folder, on_progress=progress.step)
    for path in paths:
        print(path)


def _place(name: str) -> str:
    """The path of a published recording; empty if it was not downloaded."""
    from ..errors import RecordingError
    from ..io import find_recordings

    try:
        return str(find_recordings(names=[name])[0])
    except RecordingError:
        return ""
