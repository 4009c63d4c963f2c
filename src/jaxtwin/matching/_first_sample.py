"""The temperatures with which a recording begins."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from ..io import Experiment


@final
@dataclass(frozen=True)
class FirstSample:
    """The temperatures with which a recording begins, degC.

    - `reading`: the mean over the channels of the first reading of each.
    - `ambient`: the recorded ambient temperature; None if the recording has none.
    """

    reading: float
    ambient: float | None = None


def first_sample(experiment: Experiment) -> FirstSample:
    """The first sample of a recording that has temperatures."""
    ambient = experiment.ambient
    return FirstSample(
        reading=float(np.nanmean(first_readings(experiment))),
        ambient=None if ambient is None else float(np.ravel(ambient)[0]),
    )


def first_readings(experiment: Experiment) -> Float[np.ndarray, " channels"]:
    """The first reading of each channel that is not missing, degC; NaN if all are missing."""
    assert experiment.temperatures is not None
    rows = experiment.sampled.argmax(axis=0)
    return experiment.temperatures[rows, np.arange(len(rows))]
