"""Finds recordings on this machine."""

import os
from collections.abc import Sequence
from pathlib import Path

from ..errors import RecordingError
from ._published import TWO_CELL

VARIABLE = "JAXTWIN_RECORDINGS"


def find_recordings(
    folder: str | Path | None = None,
    names: Sequence[str] = tuple(recording.name for recording in TWO_CELL),
) -> tuple[Path, ...]:
    """Finds recordings by name, all of them in one folder.

    If a folder is given, only this folder is searched; otherwise the folder in the environment
    variable `JAXTWIN_RECORDINGS`. Without this variable, the first of the following folders that
    holds all recordings is used: `shared/recordings` beside the current directory,
    `shared/recordings` beside the checkout, where several checkouts can share it, and the cache of
    `fetch_recordings`.

    **Arguments:**

    - `folder`: a folder of recordings.
    - `names`: files in it; `single-cell/BMData1_022722.mat` is also found without its folder. The
        default is the paper's three step recordings.

    **Returns:**

    The path of each name, in their order.

    **Raises:**

    `RecordingError` that lists the folders, and the files that each of them lacks.
    """
    folders = [Path(folder)] if folder is not None else _usual_folders()
    lacks = []
    for candidate in folders:
        result = [_file_in(candidate, name) for name in names]
        paths = tuple(path for path in result if path is not None)
        if len(paths) == len(names):
            return paths
        if candidate.is_dir():
            missing = [name for name, path in zip(names, result, strict=True) if path is None]
            lacks.append(f"{candidate} (without {', '.join(missing)})")
        else:
            lacks.append(f"{candidate} (no such folder)")
    raise RecordingError(
        f"recordings not found; looked in: {'; '.join(lacks)}. Name their folder, set "
        f"{VARIABLE}, or fetch them with 'jaxtwin data fetch'"
    )


def cache_folder() -> Path:
    """The folder in which `fetch_recordings` puts recordings, by the convention of the system."""
    import pooch

    return Path(pooch.os_cache("jaxtwin")) / "recordings"


def _usual_folders() -> list[Path]:
    if given := os.environ.get(VARIABLE):
        return [Path(given)]  # a folder that was asked for is never silently replaced by another
    folders = [Path.cwd().parent / "shared" / "recordings"]
    checkout = Path(__file__).resolve().parents[3]
    if (checkout / "pyproject.toml").is_file():
        folders.append(checkout.parent / "shared" / "recordings")
    return list(dict.fromkeys([*folders, cache_folder()]))


def _file_in(folder: Path, name: str) -> Path | None:
    for path in (folder / name, folder / Path(name).name):
        if path.is_file():
            return path
    return None
