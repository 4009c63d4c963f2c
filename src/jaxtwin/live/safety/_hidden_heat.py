"""Interlock: a part that is too hot by the duty, and readings that do not show what the duty does,
whatever the sensors read."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Bool, Float, Int

from ..._statistics import QUANTILE_975
from ...io import Experiment
from ...physics import Twin
from ..protocol._records import Reading
from ._duty_response import MEMORY_SECONDS, DutyResponse
from ._interlock import Finding
from ._operating_limits import OperatingLimits
from ._twin_ensemble import Draws, TwinEnsemble

# A number of draws that is enough: it gives the standard deviation to 13 %.
DRAWS = 32

# The probability that a part is above the limit at which the cells are switched off. A rig that is
# three standard deviations hotter than its twin has then passed the limit by less than two of them:
# 5 K on a plate that is 45 K above its room.
MAX_PROBABILITY = 0.1

# The distance of the mean gain of the readings from what the draws show, in standard deviations:
# one healthy rig in 30 000 is beyond it on one side, if the draws are normal.
MAX_GAIN_SIGMAS = 4.0

# The least distance of the mean gain from what the draws show that is a finding. A rig may change
# since its match: a contact of three times its resistance changes the gain by 0.14.
MIN_GAIN_ERROR = 0.2

# The least change by the duty with which a gain is judged, in limits of deviation: contacts that
# are worse than the twin's delay the first kelvins most, and all channels alike.
MIN_CHANGE = 1.0


# The distance of a mean from the limit at which `MAX_PROBABILITY` is above it, in standard
# deviations.
TOO_PROBABLE_SIGMAS = 1.2816


# The distance from being too probable within which a healthy rig may be stopped: one in five was,
# and none of 298 simulated hours beyond it.
NEAR_SIGMAS = 4.0


@final
class HottestPart(NamedTuple):
    """The part of a rig that comes nearest to the limit in a plan, by draws of its twin.

    - `name`: the part: a node of the network, or a channel.
    - `mean`, `spread`: the mean and the standard deviation of its temperature, degC and K.
    - `limit`: the limit of the rig, degC.
    - `since`: the first time at which passing the limit is too probable, or else the nearest, s.
    """

    name: str
    mean: float
    spread: float
    limit: float
    since: float

    @property
    def sigmas(self) -> float:
        """The distance from the limit in standard deviations."""
        # A twin without draws is either above the limit or not.
        return (self.limit - self.mean) / max(self.spread, 1e-9)

    @property
    def probability(self) -> float:
        """The probability that it is above the limit."""
        return _probability_below(-self.sigmas)

    @property
    def is_too_probable(self) -> bool:
        """Whether the interlock would switch the rig off."""
        return self.sigmas <= (TOO_PROBABLE_SIGMAS if self.spread > 0 else 0.0)

    @property
    def is_near(self) -> bool:
        """Whether a healthy rig under a controller may be stopped: if it needs more duty than its
        twin for the same readings, the draws, which see only the duty, take it for hotter."""
        return self.spread > 0 and self.sigmas <= TOO_PROBABLE_SIGMAS + NEAR_SIGMAS

    def __str__(self) -> str:
        band = f" ± {QUANTILE_975 * self.spread:.0f}" if self.spread > 0 else ""
        return f"{self.name} at {self.mean:.0f}{band} degC"


@final
class HiddenHeat:
    r"""What the duty does to the rig, by draws of its twin, against its limits and its readings.

    A sensor that is covered, or has lost a part of its contact, shows a part of the true rise. Its
    reading is plausible, follows the duty and stays below the limit, while a controller heats the
    plate until the reading is where it should be. Only the duty tells how hot the plate is. All
    draws of the twin therefore run beside the rig in open loop:

    - *predicted-temperature*: with a probability of at least `MAX_PROBABILITY`, an element of the
      plate, a body that a channel sees, or a channel, is above the limit, or would be if the cells
      went off now: the heat in them still reaches the plate.
    - *gain*: the readings together show another part of the change by the duty than the draws
      allow. The gain of the readings $y$ on the change $d$ that the twin predicts,
      $g = \sum w y d / \sum w d^2$ over all channels and the last minute, has an expectation and a
      spread over the draws; room, start and noise add to the spread. It may differ by
      `MAX_GAIN_SIGMAS` of it, and by `MIN_GAIN_ERROR` in any case.

    A single twin, which has not been matched, has no spread: it acts when the twin itself is above
    the limit, and the gain is not judged.

    **Arguments:**

    - `twin`: the twin of the rig.
    - `limits`: the limits of the rig.
    - `draws`: values of its parameters that its match does not exclude; None: those of the twin.
    """

    def __init__(self, twin: Twin, limits: OperatingLimits, draws: Draws | None = None):
        self._ensemble = TwinEnsemble(twin, draws)
        self._limits = limits
        self._nodes = [node.name for node in twin.netlist.nodes]
        self._channels = twin.channels
        self._sums = np.zeros(2 + self._ensemble.count)  # of y d, sigma |d|, and d_k d
        self._squares = 0.0
        self._last: int | None = None

    @property
    def ensemble(self) -> TwinEnsemble:
        """The draws of the twin beside the rig."""
        return self._ensemble

    @property
    def settings(self) -> Mapping[str, Any]:
        """What is recorded of it."""
        return {"draws": self._ensemble.count, "max_probability": MAX_PROBABILITY}

    def hottest_part(
        self, plan: Experiment, initial: float | None, seen: Bool[np.ndarray, " nodes"]
    ) -> HottestPart:
        """What the draws expect of a plan.

        **Arguments:**

        - `plan`: the duty and the room.
        - `initial`: the temperature at the start, degC; None: that of the rig file.
        - `seen`: which nodes are elements of the plate or bodies that a channel sees.
        """
        run = self._ensemble.run(plan, initial)
        draws = np.concatenate([run.nodes[:, :, seen], run.readings], axis=2)
        rows = [
            _hottest(row, self._parts_of(seen), self._limits.hottest, float(time))
            for row, time in zip(draws, run.time, strict=True)
        ]
        # Where it is too near, the first time says more than that of the highest temperature.
        nearest = min(rows, key=lambda row: row.sigmas)
        first = next((row for row in rows if row.is_too_probable), nearest)
        return nearest._replace(since=first.since)

    def follow(self, response: DutyResponse) -> None:
        """Goes on to the time of the twins of a `DutyResponse`."""
        self._ensemble.follow(response)

    def too_hot(self, response: DutyResponse) -> Finding | None:
        """Whether a part is above the limit, or would be after a stop, with a probability that is
        too high."""
        seen = response.is_seen
        nodes, readings = self._ensemble.after_stop
        draws = np.concatenate([nodes[:, seen], readings], axis=1)
        hottest = _hottest(draws, self._parts_of(seen), self._limits.hottest)
        if not hottest.is_too_probable:
            return None
        return Finding(
            "predicted-temperature",
            f"by its duty, the twin has {hottest}, now or soon after a stop, whatever the sensors "
            f"read; the rig's limit is {hottest.limit:g}",
            hottest.name,
            severity="critical",
            probability=hottest.probability,
        )

    def is_too_hot_inside(self, sides: Int[np.ndarray, " sides"]) -> bool:
        """Whether one of the nodes `sides` is above the limit of cells with a probability that is
        too high."""
        inside = self._ensemble.nodes[:, sides]
        return _hottest(
            inside, [self._nodes[side] for side in sides], self._limits.cell
        ).is_too_probable

    def _parts_of(self, seen: Bool[np.ndarray, " nodes"]) -> list[str]:
        return [*np.array(self._nodes)[seen].tolist(), *self._channels]

    def gain(self, reading: Reading, response: DutyResponse) -> Finding | None:
        """Takes a reading. Whether all readings together show another part of the change by the
        duty than the draws of the twin allow."""
        if self._ensemble.count == 1:
            return None
        by_duty = response.by_duty
        shown = response.shown(reading.temperatures)
        # An error of the camera, of the room or of the start is common to all channels.
        unknown = response.deviations(self._limits.jump)
        passed = 0.0 if self._last is None else (reading.device_us - self._last) * 1e-6
        self._last = reading.device_us
        kept = math.exp(-max(passed, 0.0) / MEMORY_SECONDS)
        terms = [shown @ by_duty, unknown @ np.abs(by_duty), *(self._ensemble.by_duty @ by_duty)]
        self._sums = kept * self._sums + np.array(terms)
        self._squares = kept * self._squares + float(by_duty @ by_duty)
        if np.abs(by_duty).max() < MIN_CHANGE * self._limits.deviation:
            return None
        gain, noise, *of_draws = self._sums / self._squares
        expected, spread = float(np.mean(of_draws)), math.hypot(float(np.std(of_draws)), noise)
        allowed = max(MAX_GAIN_SIGMAS * spread, MIN_GAIN_ERROR)
        if abs(gain - expected) <= allowed:
            return None
        low, high = expected - allowed, expected + allowed
        return Finding(
            "gain",
            f"the readings together show {100 * gain:.0f} % of what the duty does, says the twin; "
            f"{100 * max(low, 0.0):.0f} to {100 * high:.0f} % are possible. Is something on the "
            "sensors, or has the rig changed?",
            size=gain,
        )


def _hottest(
    draws: Float[np.ndarray, "draws parts"], names: Sequence[str], limit: float, since: float = 0.0
) -> HottestPart:
    """The part that is above a limit most probably, if its temperature has the mean and the
    standard deviation of the draws."""
    mean = draws.mean(axis=0)
    spread = draws.std(axis=0) if len(draws) > 1 else np.zeros_like(mean)
    part = int(np.argmin((limit - mean) / np.maximum(spread, 1e-9)))
    return HottestPart(names[part], float(mean[part]), float(spread[part]), limit, since)


def _probability_below(sigmas: float) -> float:
    """The probability that a standard normal variable is below a value."""
    return 0.5 * math.erfc(-sigmas / math.sqrt(2))
