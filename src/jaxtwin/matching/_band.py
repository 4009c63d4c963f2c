"""What a match does not know, carried on to what it predicts."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Float

from .._arguments import finite_number, of_kind, whole_number
from .._errors import MatchError
from ..io import Experiment
from ..simulation import simulate_batch
from ._fit import Fit


@final
@dataclass(frozen=True, eq=False)
class Band:
    """Where a prediction lies with a given probability.

    - `time`: s, `(times,)`. `channels`: names.
    - `lower`, `middle`, `upper`: quantiles of the channels' temperatures without the camera's
      common error and noise, `(times, channels)`, degC; of the draws that stay finite.
    """

    time: Float[np.ndarray, " times"]
    channels: tuple[str, ...]
    lower: Float[np.ndarray, "times channels"]
    middle: Float[np.ndarray, "times channels"]
    upper: Float[np.ndarray, "times channels"]


def prediction_band(
    fit: Fit,
    recording: str | None = None,
    *,
    experiment: Experiment | None = None,
    draws: int = 200,
    level: float = 0.95,
    seed: int = 0,
    on_progress: Callable[[int], None] | None = None,
) -> Band:
    """Draws the matched parameters from their joint distribution and simulates each draw.

    **Arguments:**

    - `fit`: a match.
    - `recording`: whose own values (ambient, start) to draw; by default the first.
    - `experiment`: inputs to predict; by default that recording's.
    - `draws`, `seed`: of the sample.
    - `level`: probability inside the band.
    - `on_progress`: called with the number of newly finished simulations.

    **Returns:** the band at the experiment's times, for the channels that it names, else all. Draws
    whose temperatures do not stay finite are left out of the quantiles.

    **Raises:** `MatchError` for a recording that was not matched, a level outside 0 to 1, or fewer
    than two draws; `SimulationError` for an experiment of another rig.
    """
    of_kind("prediction_band: fit", fit, Fit, "a Fit, as match gives it", MatchError)
    recording = fit.recordings[0] if recording is None else recording
    if recording not in fit.recordings:
        raise MatchError(f"recording: found {recording!r}, allowed are {', '.join(fit.recordings)}")
    whole_number("prediction_band: draws", draws, 2, MatchError)
    whole_number("prediction_band: seed", seed, 0, MatchError)
    if not 0 < finite_number("prediction_band: level", level, MatchError) < 1:
        raise MatchError(
            f"prediction_band: level: found {level!r}, allowed is a level between 0 and 1"
        )
    number = fit.recordings.index(recording)
    unknowns = fit.setting.unknowns
    covariance = np.nan_to_num(fit.uncertainty.entries)
    values, directions = np.linalg.eigh(covariance)
    root = directions * np.sqrt(np.maximum(values, 0.0))
    normal = np.random.default_rng(seed).standard_normal((draws, len(values)))
    vectors = np.clip(fit.vector + normal @ root.T, unknowns.lower(), unknowns.upper())
    sample = unknowns.values(vectors)[number]
    twin = fit.twins[recording]
    experiment = fit.experiments[number] if experiment is None else experiment
    runs = simulate_batch(twin, experiment, sample, on_progress=on_progress)
    below, above = (1 - level) / 2, (1 + level) / 2
    lower, middle, upper = np.nanquantile(runs, [below, 0.5, above], axis=0)
    return Band(experiment.time, experiment.channels or twin.channels, lower, middle, upper)
