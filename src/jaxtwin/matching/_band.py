"""What a match does not know, carried on to what it predicts."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from .._arguments import finite_number, of_kind, whole_number
from .._errors import MatchError
from ..io import Experiment
from ..physics import Twin
from ..simulation import simulate_batch
from ._fit import Fit
from ._initial_conditions import WARM_UP, estimate_initial_conditions


@final
@dataclass(frozen=True, eq=False)
class Band:
    """Where a reading lies with a given probability.

    - `time`: s, `(times,)`. `channels`: names.
    - `lower`, `middle`, `upper`: quantiles of the channels' readings, `(times, channels)`, degC; of
      the draws that stay finite.
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
    warm_up: float = WARM_UP,
    on_progress: Callable[[int], None] | None = None,
) -> Band:
    """Draws everything that is not known of a run and simulates each draw.

    What is drawn: the matched parameters from their joint distribution; the noise of a reading,
    with what the twin leaves unexplained and the camera's common error in it; and for an experiment
    that the match has not seen, by how much the rig differs from recording to recording
    (`Uncertainty.between_recordings`) and the recording's own values (room, start, delay) as
    `estimate_initial_conditions` finds them in its first `warm_up` seconds, with their covariance.
    Samples in that part are not predicted.

    **Arguments:**

    - `fit`: a match.
    - `recording`: name of a matched recording whose own values to take; by default the first where
      `experiment` has no temperatures either.
    - `experiment`: inputs to predict; by default that recording's.
    - `draws`, `seed`: of the sample.
    - `level`: probability inside the band.
    - `warm_up`: s.
    - `on_progress`: called with the number of newly finished simulations.

    **Returns:** the band at the experiment's times, for the channels that it names, else all. Draws
    whose temperatures do not stay finite are left out of the quantiles.

    **Raises:** `MatchError` for a recording that was not matched, a level outside 0 to 1, fewer
    than two draws, or an experiment too short to begin from; `SimulationError` for an experiment of
    another rig.
    """
    of_kind("prediction_band: fit", fit, Fit, "a Fit, as match gives it", MatchError)
    if recording is not None and recording not in fit.recordings:
        raise MatchError(f"recording: found {recording!r}, allowed are {', '.join(fit.recordings)}")
    whole_number("prediction_band: draws", draws, 2, MatchError)
    whole_number("prediction_band: seed", seed, 0, MatchError)
    if not 0 < finite_number("prediction_band: level", level, MatchError) < 1:
        raise MatchError(
            f"prediction_band: level: found {level!r}, allowed is a level between 0 and 1"
        )
    rng = np.random.default_rng(seed)
    if recording is None and experiment is not None and experiment.temperatures is not None:
        drawn = _unseen(fit, experiment, draws, rng, warm_up)
    else:
        number = 0 if recording is None else fit.recordings.index(recording)
        experiment = fit.experiments[number] if experiment is None else experiment
        drawn = _matched(fit, number, draws, rng)
    runs = simulate_batch(drawn.twin, experiment, drawn.values, on_progress=on_progress)
    runs += _reading_noise(fit) * rng.standard_normal(runs.shape)
    below, above = (1 - level) / 2, (1 + level) / 2
    lower, middle, upper = np.nanquantile(runs, [below, 0.5, above], axis=0)
    channels = experiment.channels or drawn.twin.channels
    return Band(experiment.time, channels, lower, middle, upper)


class _Drawn(NamedTuple):
    """A twin, and draws of its parameters: name -> `(draws,)`."""

    twin: Twin
    values: dict[str, Float[np.ndarray, " draws"]]


def _matched(fit: Fit, number: int, draws: int, rng: np.random.Generator) -> _Drawn:
    """Parameters as one of the matched recordings has them."""
    unknowns = fit.setting.unknowns
    deviations = _normal(np.nan_to_num(fit.uncertainty.entries), draws, rng)
    vectors = np.clip(fit.vector + deviations, unknowns.lower(), unknowns.upper())
    return _Drawn(fit.twins[fit.recordings[number]], unknowns.values(vectors)[number])


def _unseen(
    fit: Fit, experiment: Experiment, draws: int, rng: np.random.Generator, warm_up: float
) -> _Drawn:
    """Parameters as a recording may have them that was not matched."""
    unknowns, known = fit.setting.unknowns, fit.uncertainty
    start = estimate_initial_conditions(fit, experiment, warm_up)
    covariance = np.nan_to_num(known.entries) + np.diag(known.between_recordings**2)
    vectors = fit.vector + _normal(covariance, draws, rng)
    values = unknowns.values(np.clip(vectors, unknowns.lower(), unknowns.upper()))[0]
    drawn = {row.name: values[row.name] for row in unknowns.shared}
    deviations = _normal(start.covariance, draws, rng)
    table = fit.twin.rig.parameters
    for (name, value), deviation in zip(start.values.items(), deviations.T, strict=True):
        logarithmic = table[name].is_logarithmic
        drawn[name] = value * np.exp(deviation) if logarithmic else value + deviation
    return _Drawn(start.twin, drawn)


def _normal(
    covariance: Float[np.ndarray, "n n"], draws: int, rng: np.random.Generator
) -> Float[np.ndarray, "draws n"]:
    values, directions = np.linalg.eigh(covariance)
    root = directions * np.sqrt(np.maximum(values, 0.0))
    return rng.standard_normal((draws, len(values))) @ root.T


def _reading_noise(fit: Fit) -> float:
    """Standard deviation of what a reading has beside the twin's temperature, K."""
    return math.hypot(fit.rmse, fit.camera_error)
