"""Which part of the recordings a refit sees, and how both twins predict the rest."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from .._errors import MatchError
from ..io import Experiment
from ..matching import Fit
from ..observers import Forecast, Observed, ProcessNoise, observe
from ..simulation import Run, simulate

SHARE = 2 / 3
"""The part of a single recording that the refit sees; of several, it sees all but the last."""

LEAST = 60.0
"""The shortest part that is held out, s."""

BLOCKS = 12
"""A recording is judged in so many parts of equal length, so that no part hides behind others."""


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
class Replay(NamedTuple):
    """How a twin follows a recording whose end it has not seen.

    - `observed`: the recording as an observer follows it.
    - `forecast`: what was expected some time ahead, in the part that the twin has not seen.
    - `log_likelihood`: of that part, per reading.
    """

    observed: Observed
    forecast: Forecast
    log_likelihood: float


def split(recordings: Sequence[Experiment], lead: float) -> Split:
    """Splits recordings: the last of several is held out, or the last third of a single one.

    **Arguments:**

    - `lead`: the time ahead of forecasts, s, for which the part that is held out must be long
      enough.

    **Raises:** `MatchError` if it is too short.
    """
    *seen, last = recordings
    begin, duration = float(last.time[0]), last.duration
    since = begin if seen else begin + SHARE * duration
    if begin + duration - since < max(LEAST, 2 * lead):
        raise MatchError(
            f"{last.name or 'recording'}: refit: expected at least {max(LEAST, 2 * lead):g} s that "
            f"are held out, got {begin + duration - since:.0f} s; give a longer recording, or more "
            "recordings"
        )
    first = last.between(None, since) if not seen else None
    return Split(tuple(seen) if first is None else (first,), (last,), (since,))


def replay(
    fit: Fit, recording: Experiment, since: float, noise: ProcessNoise | None, lead: float
) -> Replay:
    """Follows a recording with an observer, and forecasts the part from a time on.

    **Raises:** the errors of `jaxtwin.observe`.
    """
    observed = observe(fit, recording, noise)
    counted = recording.time >= since
    densities = np.asarray(observed.filtered.states.log_likelihood)[observed.is_sample]
    readings = int(np.isfinite(np.asarray(recording.temperatures)[counted]).sum())
    likelihood = float(densities[counted].sum()) / max(readings, 1)
    return Replay(observed, observed.ahead(lead).after(since), likelihood)


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
