"""Detects a camera's corrections in the differences between recordings and twin."""

from collections.abc import Iterable

import numpy as np

from ..matching._camera_error import detect_events
from ..simulation import Run
from ._recordings import recorded

# The number of corrections that make a sawtooth; a single jump may have another cause.
SAWTOOTH = 3


def shows_sawtooth(runs: Iterable[Run]) -> bool:
    """Whether in one of the recordings all channels jump together repeatedly. A plate cannot do so,
    but an infrared camera that corrects itself does.

    **Arguments:**

    - `runs`: the runs of recordings by a twin with small residuals.
    """
    return any(len(_corrections(run)) >= SAWTOOTH for run in runs)


def _corrections(run: Run) -> tuple[float, ...]:
    difference = recorded(run.experiment) - run.temperatures
    complete = np.asarray(np.isfinite(difference).all(axis=1))
    common = np.where(complete, difference.mean(axis=1), 0.0)
    return detect_events(run.time, common, complete)
