"""Fetches the authors' recordings from the site on which they published them."""

from collections.abc import Callable, Sequence
from pathlib import Path

from ..errors import RecordingError
from ._locate import cache_folder
from ._published import SINGLE_CELL, TWO_CELL, PublishedRecording


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
