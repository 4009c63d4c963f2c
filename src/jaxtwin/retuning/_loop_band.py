"""What a trial predicts of the error of a loop, and whether a rig keeps to it."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, final

import numpy as np
from jaxtyping import Float

from ..control import Decision

# The time over which the error of a loop is averaged, s.
WINDOW = 60.0

# The time between two values of a band, s.
SPACING = 10.0

# The share of the draws that a band contains.
COVERAGE = 0.99

# The factor by which the error may be larger than in a band before it is worse: a rig has errors
# that the draws of its twin do not have.
FACTOR = 1.5

# The error at rest that is never worse, K: cameras correct themselves, and rooms have draughts.
MIN_REST = 0.25

# The time for which the error stays above the band before the loop is worse, s.
PATIENCE = 20.0


@final
@dataclass(frozen=True)
class LoopBand:
    """The largest error of a loop that its trial predicts: the absolute error, averaged over the
    outputs and over a minute.

    - `rest`: at rest, K.
    - `after_step`: what a step of the references adds, as a part of the step: at 0 s after it, at
      10 s, and so on.
    - `largest_step`: the largest step of the trial, K. A larger one takes longer in proportion,
      because the duty has limits.
    """

    rest: float
    after_step: tuple[float, ...]
    largest_step: float

    @classmethod
    def of(
        cls,
        time: Float[np.ndarray, " times"],
        reference: Float[np.ndarray, "times outputs"],
        first: float,
        error: Float[np.ndarray, "draws times"],
    ) -> "LoopBand":
        """Makes the band of simulated loops.

        **Arguments:**

        - `time`: the times, s. `reference`: the references, degC.
        - `first`: the error with which the loops begin, K: their first step.
        - `error`: the absolute error of each draw, averaged over the outputs, K.
        """
        mean = np.array([_averaged(time, row) for row in error])
        steps = np.append(first, np.abs(np.diff(reference, axis=0)).mean(axis=1))
        begins = [0, *np.flatnonzero(steps[1:] > 0) + 1, len(time)]
        parts = [slice(a, b) for a, b in pairwise(begins)]
        last = np.concatenate(
            [mean[:, part][:, -max(1, (part.stop - part.start) // 10) :].ravel() for part in parts]
        )
        rest = float(np.quantile(last, COVERAGE))
        length = min(float(time[part.stop - 1] - time[part.start]) for part in parts)
        grid = np.arange(0.0, length + 1e-9, SPACING)
        shape = np.zeros(len(grid))
        for part in parts:
            size = steps[part.start]
            if size <= 0:
                continue
            highest = np.quantile(mean[:, part], COVERAGE, axis=0)
            at = np.interp(grid, time[part] - time[part.start], highest)
            shape = np.maximum(shape, np.maximum(at - rest, 0.0) / size)
        return cls(rest, tuple(shape.tolist()), float(steps.max()))

    @classmethod
    def of_dict(cls, values: Mapping[str, Any]) -> "LoopBand":
        """Makes a band from what `to_dict` gave."""
        shape = tuple(float(part) for part in values["after_step"])
        return cls(float(values["rest"]), shape, float(values["largest_step"]))

    def to_dict(self) -> dict[str, Any]:
        """The band as plain types for JSON."""
        return asdict(self)

    def allowed(self, since: float, step: float) -> float:
        """The largest error that is not worse than the trial, K.

        **Arguments:**

        - `since`: the time since the last step of the references, s. `step`: its size, K.
        """
        slower = max(step / self.largest_step, 1.0) if self.largest_step > 0 else 1.0
        place = since / slower / SPACING
        part = float(np.interp(place, np.arange(len(self.after_step)), self.after_step))
        return max(FACTOR * (self.rest + step * part), MIN_REST)


@final
class LoopWatch:
    """Compares the error of a loop on a rig with its band, sample by sample.

    **Arguments:**

    - `band`: the band.
    """

    def __init__(self, band: LoopBand):
        self._band = band
        self._errors: deque[tuple[float, float]] = deque()
        self._reference: Float[np.ndarray, " outputs"] | None = None
        self._changed = self._step = 0.0
        self._worse_since: float | None = None
        self.time = 0.0
        """The time of the loop that was watched, s."""

    @property
    def is_at_rest(self) -> bool:
        """Whether the last minute was like one at rest in the trial."""
        return bool(self._is_full and self._mean <= self._band.allowed(np.inf, 0.0))

    def update(self, decision: Decision) -> str:
        """Takes the next sample of the loop.

        **Returns:** why the loop is worse than its band, a sentence; `""` if it is not.
        """
        now = decision.time
        reference, measured = np.asarray(decision.reference), np.asarray(decision.measurement)
        last = self._errors[-1][0] if self._errors else now
        self.time += max(now - last, 0.0)
        # The time of a run begins anew with each order.
        is_new = self._reference is None or now < last
        if is_new or (reference != self._reference).any():
            self._reference, self._changed = reference, now
            self._step = float(np.abs(reference - measured).mean())
            self._errors.clear()
            self._worse_since = None
        self._errors.append((now, float(np.abs(reference - measured).mean())))
        while self._errors[-1][0] - self._errors[1 if len(self._errors) > 1 else 0][0] >= WINDOW:
            self._errors.popleft()
        allowed = self._band.allowed(now - self._changed, self._step)
        if not self._is_full or self._mean <= allowed:
            self._worse_since = None
            return ""
        if self._worse_since is None:
            self._worse_since = now
        if now - self._worse_since < PATIENCE:
            return ""
        return (
            f"the error of the loop, {self._mean:.2g} K in the mean of a minute, is above the "
            f"{allowed:.2g} K of its trial"
        )

    @property
    def _is_full(self) -> bool:
        return bool(self._errors) and self._errors[-1][0] - self._errors[0][0] >= WINDOW - 1e-9

    @property
    def _mean(self) -> float:
        return float(np.mean([error for _, error in self._errors]))


def _averaged(time: Sequence[float] | np.ndarray, values: np.ndarray) -> np.ndarray:
    """The mean over the last minute at each time, or over what there is of it."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    first = np.searchsorted(time, np.asarray(time) - WINDOW - 1e-9)
    last = np.arange(1, len(values) + 1)
    return (sums[last] - sums[first]) / (last - first)
