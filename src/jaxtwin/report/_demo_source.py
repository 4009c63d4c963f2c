"""The recordings that the demo uses: those of the authors, or the bundled synthetic ones."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import final

from ..data import synthetic_recordings
from ..errors import RecordingError
from ..io import Experiment, find_recordings, read_recording

VARIABLE = "JAXTWIN_RECORDINGS"


@final
@dataclass(frozen=True)
class Source:
    """Recordings and their origin.

    **Arguments:**

    - `experiments`: the recordings.
    - `real`: whether they were measured on a rig.
    - `note`: a sentence for the report.
    """

    experiments: tuple[Experiment, ...]
    real: bool
    note: str


def find_source(folder: Path | None) -> Source:
    """Returns the authors' recordings if they are found, else the synthetic ones.

    **Arguments:**

    - `folder`: the folder of the recordings; None to look for them in the usual places.

    **Raises:** `RecordingError` if a folder was given, here or by `JAXTWIN_RECORDINGS`, and does
    not contain them: recordings that were asked for are never silently replaced.
    """
    try:
        paths = find_recordings(folder)
    except RecordingError:
        if folder is not None or os.environ.get(VARIABLE):
            raise
        return synthetic_source(
            "The authors' recordings are not on this machine (`jaxtwin data fetch` downloads them, "
            "`--recordings DIR` names their folder): what follows was done on the synthetic "
            "recordings that come with jaxtwin. No rig was measured, and no number here can be "
            "compared with the paper's."
        )
    return Source(
        tuple(read_recording(path) for path in paths),
        True,
        f"The authors' recordings, found in `{paths[0].parent}`.",
    )


def synthetic_source(note: str = "") -> Source:
    """The synthetic recordings that come with jaxtwin."""
    return Source(tuple(read_recording(path) for path in synthetic_recordings()), False, note)
