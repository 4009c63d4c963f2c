r"""What a schedule would say of which fault a rig has.

The fault is there from the start of the schedule. With the signatures of the faults in the
innovations of a healthy observer (`jaxtwin.diagnosis._isolability`), the logarithm of the odds of
each fault against each other one, whatever its size, has a mean that grows with time. Two faults
are told apart when it has passed $\log 20$ in both directions.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from .._jax_settings import own_settings
from ..diagnosis._diagnosis import TIE
from ..diagnosis._isolability import evidence_of, grams_of
from ..diagnosis._signatures import suspected
from ..diagnosis._suspects import Faults, chosen
from ..errors import MatchError
from ..io import Experiment
from ..matching import Fit
from ..observers import Observed, ProcessNoise
from ..observers._filter_run import filtered, samples_of
from ..observers._observe import filter_for, usual_noise
from ..observers._programs import started
from ..observers._start import first_reading
from ..physics import Twin
from ..simulation import simulate
from ._schedules import Counts, Schedules

# The smallest odds that count as more than rounding, as a logarithm.
MIN_LOG_ODDS = 1e-9


@final
class SeparationEvidence(NamedTuple):
    """What a schedule would say.

    - `time`: since its start, s. `odds`: the mean logarithm of the odds of the two faults that are
      the hardest to tell apart.
    - `separation`: the time after which all are told apart, s; infinite if not until the end.
    - `hardest`: the names of those two.
    - `reading`, `side`: the highest temperature of a channel, and of a cell's side, degC.
    """

    time: Float[np.ndarray, " times"]
    odds: Float[np.ndarray, " times"]
    separation: float
    hardest: tuple[str, str]
    reading: float
    side: float

    @property
    def objective(self) -> float:
        """What is minimised: the separation, or, if there is none, the duration and more, the less
        is known at the end."""
        if math.isfinite(self.separation):
            return self.separation
        return float(self.time[-1]) * (
            1 + math.log(math.log(TIE) / max(self.odds[-1], MIN_LOG_ODDS))
        )


@final
class EvidenceProblem:
    """Everything on which the evidence depends, except the schedule.

    **Arguments:**

    - `fit`: a fit, or a twin whose values are taken as exact.
    - `faults`: two or more, as for `jaxtwin.diagnose`.
    - `noise`: the noise of its observer; None: usual levels.
    - `schedules`: the schedules, which share a time grid.

    **Raises:** `MatchError` for fewer than two faults; `ObserverError` for unknown ones.
    """

    def __init__(
        self, fit: Twin | Fit, faults: Faults, noise: ProcessNoise | None, schedules: Schedules
    ):
        self.twin = fit.mean_twin if isinstance(fit, Fit) else fit
        suspects = chosen(self.twin, faults, self.twin.channels)
        if len(suspects) < 2:
            raise MatchError(
                "design_experiment: faults: expected two or more that are to be told apart, got "
                f"{', '.join(one.name for one in suspects) or 'none'}"
            )
        self.names = tuple(suspect.name for suspect in suspects)
        template = simulate(self.twin, schedules.numbered()).to_recording(noise=0.0)
        levels = usual_noise(fit, [template]) if noise is None else noise
        self._kalman = filter_for(fit, template, levels)
        self._arrays = suspected(self._kalman.model, suspects)
        rig, index = self.twin.rig, self.twin.netlist.index
        sides = [f"{cell.name}.{side}" for cell in rig.cells for side in ("TC", "TH")]
        self._sides = [index[name] for name in sides]

    def evaluate(self, schedules: Schedules, counts: Sequence[Counts]) -> list[SeparationEvidence]:
        """Evaluates several schedules."""
        return [self._of(schedules.experiment(count)) for count in counts]

    def _of(self, schedule: Experiment) -> SeparationEvidence:
        run = simulate(self.twin, schedule)
        recording = run.to_recording(noise=0.0)
        kalman = self._kalman
        samples, is_sample = samples_of(kalman, recording)
        with own_settings():
            first = np.asarray(first_reading(recording))
            start = started(kalman, first, np.zeros_like(samples.duty[0]))
            followed = filtered(kalman, start, samples)
        observed = Observed(recording, kalman, samples, is_sample, followed)
        grams, time = grams_of(observed, self._arrays, 0.0)
        odds = evidence_of(grams)
        odds[:, *np.diag_indices(len(self.names))] = math.inf
        hardest = np.unravel_index(int(np.argmin(odds[-1])), odds.shape[1:])
        least = odds.min(axis=(1, 2))
        return SeparationEvidence(
            time=time,
            odds=least,
            separation=_crossing(time, least),
            hardest=(self.names[int(hardest[0])], self.names[int(hardest[1])]),
            reading=float(run.temperatures.max()),
            side=float(run.states[:, self._sides].max(initial=-math.inf)),
        )


def _crossing(time: Float[np.ndarray, " times"], odds: Float[np.ndarray, " times"]) -> float:
    """The time at which the odds pass 20, between two samples by a line."""
    enough = math.log(TIE)
    if odds[-1] < enough:
        return math.inf
    at = int(np.argmax(odds >= enough))
    return float(np.interp(enough, [0.0, *odds[: at + 1]], [0.0, *time[: at + 1]]))
