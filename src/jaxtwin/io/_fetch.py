"""Fetches the authors' recordings from the site on which they published them."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

from ..errors import RecordingError

# Each address names a commit, so that the files agree with the checksums.
_TWO_CELL_URL = (
    "https://raw.githubusercontent.com/tartanus/digital-twin-MIMO-peltier/"
    "e9e1f150f0ee3d278e11738eb07f0759c6317ef4/"
)
_SINGLE_CELL_URL = (
    "https://raw.githubusercontent.com/tartanus/DigitalTwinSLDOPeltier/"
    "46ac76e1bdcaa8f19c69c8eb92fafad818a8dfda/"
)


@final
@dataclass(frozen=True)
class PublishedRecording:
    """A file that the authors published.

    **Arguments:**

    - `name`: the path in a folder of recordings, with forward slashes.
    - `url`: the address from which it is fetched.
    - `sha256`: the SHA-256 of its bytes, as hexadecimal digits.
    """

    name: str
    url: str
    sha256: str


def _two_cell(file: str, sha256: str) -> PublishedRecording:
    return PublishedRecording(file, _TWO_CELL_URL + file, sha256)


def _single_cell(file: str, sha256: str) -> PublishedRecording:
    return PublishedRecording(f"single-cell/{file}", _SINGLE_CELL_URL + file, sha256)


TWO_CELL = (
    _two_cell(
        "peltierMIMOStepSecA.mat",
        "3759d961ec6d3d400c615cef9d5f6a13df0c81f36725f8db239b97abebfdd0d1",
    ),
    _two_cell(
        "peltierMIMOStepSecB.mat",
        "af223252cfb0d37f7d9f5e6d31d55fd16605468716829d30d6967df404a2592b",
    ),
    _two_cell(
        "peltierMIMOStepSecC.mat",
        "466301644f94b1ef19ecf76682040d91343544b3e9ac810727f2b0abb6c6740a",
    ),
)
"""The paper's rig: zones A, B and C, duty 128/255 and from 500 s on 200/255."""

SINGLE_CELL = (
    _single_cell(
        "BMData1_022722.mat", "cf3db06b9651b3ec4b8022430bc85d7df71c6092fc6cc072bc21f536858eb857"
    ),
    _single_cell(
        "BMData2_022722.mat", "cea65e10d094bfd5a5fe7f718d77d9992bd0243747187f58a02c9e1bf78bc0ce"
    ),
    _single_cell(
        "BMData3_022722.mat", "c36d910cd2d53c9131c499ea1c07538ba4f12bd2ddfcca47ad8f2c1ab74745e5"
    ),
    _single_cell(
        "BMData4_022722.mat", "0f4667338cea88dd8a8ff37bcac8566e44d14c311074c2807802af600bbe5f46"
    ),
)
"""The authors' rig with one cell: an hour each in closed loop, duty -1 to 1."""


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


def fetch_recordings(
    folder: str | Path | None = None,
    recordings: Sequence[PublishedRecording] = TWO_CELL + SINGLE_CELL,
    *,
    on_progress: Callable[[str], None] | None = None,
) -> tuple[Path, ...]:
    """Fetches recordings that do not exist yet, and checks each recording by its SHA-256.

    **Arguments:**

    - `folder`: the folder for the recordings; the default is a cache folder that `find_recordings`
      searches.
    - `recordings`: the recordings to fetch; the default is all of the authors' recordings that
      jaxtwin knows.
    - `on_progress`: called with a line of text before each file.

    **Returns:**

    The path of each recording, in their order.

    **Raises:**

    `RecordingError` if a file cannot be fetched or has another checksum. Files that were fetched
    before remain. Nothing remains of the file that failed, and an older file in its place is
    unchanged.
    """
    import pooch

    target = cache_folder() if folder is None else Path(folder)
    logger = pooch.get_logger()
    level = logger.level
    logger.setLevel("ERROR")  # `on_progress` reports instead
    try:
        paths = []
        for number, recording in enumerate(recordings, start=1):
            if on_progress is not None:
                on_progress(f"{recording.name} ({number} of {len(recordings)})")
            paths.append(_fetch(recording, target))
        return tuple(paths)
    finally:
        logger.setLevel(level)


def _fetch(recording: PublishedRecording, target: Path) -> Path:
    import pooch

    path = target / recording.name
    try:
        pooch.retrieve(
            recording.url,
            known_hash=f"sha256:{recording.sha256}",
            path=path.parent,
            fname=path.name,
        )
    except OSError as error:  # the network's errors are among them, and some are ValueErrors too
        raise RecordingError(
            f"{path}: cannot be fetched from {recording.url} ({type(error).__name__}). Fetch it by "
            "hand and name its folder"
        ) from None
    except ValueError:
        raise RecordingError(
            f"{path}: not fetched: what {recording.url} gives has another SHA-256 than "
            f"{recording.sha256}"
        ) from None
    return path
