"""Which part of the recordings a refit sees, and how both twins predict the rest."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from ..errors import MatchError
from ..io import Experiment
from ..matching import Fit, estimate_noise
from ..observers import Forecast, Observed, ProcessNoise, observe
from ..simulation import Run, simulate

# The part of a single recording that the refit sees; of several, it sees all but the last.
FITTED_FRACTION = 2 / 3

# The shortest part that is held out, s.
MIN_HELD_OUT_SECONDS = 60.0

# The least number of readings of a channel that are held out: with fewer, one disturbance decides
# about a twin.
READINGS = 30

# The number of parts of equal length in which a recording is judged, so that no part hides behind
# others.
BLOCKS = 12


@final
class Split(NamedTuple):
    """What a refit sees of recordings.

    - `seen`: the recordings, or the first part of one, that are matched.
    - `held_out`: the recordings of which it has not seen all. `since`: the time of each from which
      it has seen nothing, s.
    """

    seen: tuple[Experiment, ...]
    held_out: tuple[Experiment, ...]
    since: tuple[float, ...]


@final
class HeldOutReplay(NamedTuple):
    """How a twin follows a recording whose end it has not seen.

    - `observed`: the recording as an observer follows it.
    - `forecast`: what was expected some time ahead, in the part that the twin has not seen.
    - `log_likelihood`: of that part. `readings`: the number of its readings.
    - `correlation`: the integrated autocorrelation time of the innovations there, in samples, 1 if
      they are white: this number of readings says as much as one independent reading.
    """

    observed: Observed
    forecast: Forecast
    log_likelihood: float
    readings: int
    correlation: float


def split(recordings: Sequence[Experiment], lead: float, channels: frozenset[str]) -> Split:
    """Splits recordings: the last of several is held out, or the last third of a single one.

    **Arguments:**

    - `lead`: the time ahead of forecasts, s, for which the part that is held out must be long
      enough.
    - `channels`: the channels of the last fit, most of which must have enough readings there.

    **Raises:** `MatchError` if it is too short, or has too few readings.
    """
    *seen, last = recordings
    begin, duration = float(last.time[0]), last.duration
    since = begin if seen else begin + FITTED_FRACTION * duration
    if begin + duration - since < max(MIN_HELD_OUT_SECONDS, 2 * lead):
        raise MatchError(
            f"{last.name or 'recording'}: refit: expected at least "
            f"{max(MIN_HELD_OUT_SECONDS, 2 * lead):g} s that "
            f"are held out, got {begin + duration - since:.0f} s; give a longer recording, or more "
            "recordings"
        )
    _check_readings(last, since, channels)
    first = last.between(None, since) if not seen else None
    return Split(tuple(seen) if first is None else (first,), (last,), (since,))


def _check_readings(recording: Experiment, since: float, channels: frozenset[str]) -> None:
    """Refuses a part without enough readings of most channels: a twin that predicts one channel of
    fifteen, or ten seconds, has not shown that it predicts the rig."""
    readings = np.asarray(recording.temperatures)[recording.time >= since]
    counts = dict(zip(recording.channels, np.isfinite(readings).sum(axis=0), strict=True))
    enough = [name for name in channels if counts.get(name, 0) >= READINGS]
    if 2 * len(enough) <= len(channels):
        raise MatchError(
            f"{recording.name or 'recording'}: refit: expected at least {READINGS} readings of "
            f"most of the {len(channels)} channels of the last fit in what is held out, from "
            f"{since:.0f} s on, got them of {len(enough)}; give a longer recording, or one with "
            "more channels"
        )


def replay(
    fit: Fit, recording: Experiment, since: float, noise: ProcessNoise | None, lead: float
) -> HeldOutReplay:
    """Follows a recording with an observer, and forecasts the part from a time on.

    **Raises:** the errors of `jaxtwin.observe`.
    """
    observed = observe(fit, recording, noise)
    counted = recording.time >= since
    densities = np.asarray(observed.filtered.states.log_likelihood)[observed.is_sample]
    innovations = observed.standardised[counted]
    readings = int(np.isfinite(innovations).sum())
    correlation = estimate_noise([np.nan_to_num(innovations)], readings).autocorrelation_time
    likelihood = float(densities[counted].sum())
    forecast = observed.ahead(lead).after(since)
    return HeldOutReplay(observed, forecast, likelihood, readings, correlation)


def run_of_refit(fit: Fit, recording: Experiment, seen: Sequence[Experiment]) -> Run:
    """The run of a refitted twin over a whole recording, of which it has seen the first part, or
    nothing."""
    for name, part in zip(fit.recordings, seen, strict=True):
        if part.name == recording.name and part.time[0] == recording.time[0] and len(seen) == 1:
            return simulate(fit.twins[name], recording)
    return simulate(fit.twin_for(replace(recording, group=next(iter(fit.groups.values())))),
                    recording)  # fmt: skip


def block_errors(run: Run) -> Float[np.ndarray, "blocks channels"]:
    """The root mean square error of a run in parts of equal length, K; NaN for a part without
    samples."""
    recorded = run.experiment.temperatures
    assert recorded is not None
    squares = (run.temperatures - recorded) ** 2
    parts = np.array_split(squares, BLOCKS)
    counts = [np.isfinite(part).sum(axis=0) for part in parts]
    sums = [np.nansum(part, axis=0) for part in parts]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(np.stack(sums) / np.stack(counts))
