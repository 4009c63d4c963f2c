"""Interlock: temperatures that the twin predicts, also where there is no sensor."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import compress
from typing import Any, final

import numpy as np

from ...errors import JaxtwinError
from ...io import Experiment
from ...physics import Twin
from ..protocol._records import Reading, Record, Sample
from ..protocol._rig_state import RigState
from ._duty_response import DutyResponse, Responsiveness
from ._hidden_heat import HiddenHeat, HottestPart
from ._interlock import AbstractInterlock, Finding
from ._off_watch import OffWatch
from ._operating_limits import OperatingLimits
from ._twin_ensemble import Draws

# The part of the predicted rise by which a reading may differ from it: a rig may be driven before
# its twin is matched.
ALLOWED_PART_OF_RISE = 0.5

# The largest difference between the first readings and the room of the rig file with which a rig is
# started whose ambient temperature nobody knows, K. A warm rig in a cool room and a sensor that
# lies beside a cold plate cannot be told apart by their first readings.
STRANGE_ROOM_KELVIN = 10.0


@final
class TwinWatch(AbstractInterlock):
    """Runs the twin beside the rig. Trips if its cells are too hot, if any part of the rig is by
    its duty (`HiddenHeat`), or if a reading deviates from the twin or does not follow the duty.

    A reading may deviate by half of the predicted rise, since a twin may not have been matched yet,
    and by three standard deviations of everything else that is not known: the twin
    (`limits.deviation`), the room and the temperatures at the start (`DutyResponse.unknown`).

    **Arguments:**

    - `twin`: the twin of the rig.
    - `limits`: the limits of the rig.
    - `ambient`: the ambient temperature of a rig that does not measure it, degC; None: unknown.
    - `draws`: values of the twin's parameters that its match does not exclude; None: those of the
      twin.
    """

    def __init__(
        self,
        twin: Twin,
        limits: OperatingLimits,
        ambient: float | None = None,
        draws: Draws | None = None,
    ):
        self._response = DutyResponse(twin, ambient)
        self._hidden = HiddenHeat(twin, limits, draws)
        self._limits = limits
        self._given = ambient
        limited = np.isfinite(twin.rig.maximum_side_temperatures)
        self._cells = tuple(compress(twin.rig.driven, limited))
        self._channels = twin.channels
        self._sides = np.array([twin.wiring.cold, twin.wiring.hot])[:, limited]
        self._following = Responsiveness(len(self._channels), limits)

    @property
    def settings(self) -> Mapping[str, Any]:
        given = {} if self._given is None else {"ambient_degC": self._given}
        return {**self._hidden.settings, **given}

    def on_record(self, record: Record, state: RigState) -> Finding | None:
        self._response.update(record, state)
        if not self._response.has_begun:
            return None
        self._hidden.follow(self._response)
        if isinstance(record, Reading) and not record.recalibrating:
            result = (
                self._deviation(record)
                or self._unresponsive(record)
                or self._hidden.gain(record, self._response)
            )
            if result is not None:
                return result
        if not isinstance(record, Reading | Sample):
            return None
        return self._hidden.too_hot(self._response) or self._cell_too_hot()

    def before_start(self, state: RigState) -> Finding | None:
        """Checks that the room is known well enough."""
        apart, room = self._response.surprise, self._limits.room
        if apart <= STRANGE_ROOM_KELVIN:
            return None
        return Finding(
            "ambient-unknown",
            f"the first readings are {apart:.0f} K from the room of the rig file, {room:.0f} degC, "
            "and the device does not measure the ambient temperature; give it (--ambient)",
        )

    def check_plan(self, plan: Experiment) -> HottestPart | None:
        """Refuses a plan with which `HiddenHeat` would stop the rig. It begins in the room that is
        given, or that of the rig file.

        **Returns:** what the draws of the twin expect of the plan.

        **Raises:** `JaxtwinError` that names the part, the temperature and the time.
        """
        given = self._given
        room = plan.ambient if given is None else given
        seen = self._response.is_seen
        hottest = self._hidden.hottest_part(replace(plan, ambient=room), given, seen)
        if hottest.is_too_probable:
            raise JaxtwinError(
                f"plan: expected at most {hottest.limit:g} degC, the limit of the rig, got "
                f"{hottest}, says the twin, with a probability of "
                f"{100 * hottest.probability:.0f} % above the limit, from {hottest.since:.0f} s "
                "on; the interlocks would stop it. Accept that to begin nevertheless (--accept)"
            )
        return hottest

    def follow(self, record: Record, state: RigState) -> None:
        """Lets the twin follow the rig without judging it."""
        self._response.update(record, state)

    def off_watch(self, now: int) -> OffWatch | None:
        """What tells after the end of a run by the readings whether the rig is off; None if it has
        not been heated."""
        if not self._response.has_begun or not self._response.last_heat.any():
            return None
        return OffWatch(self._response, self._hidden.ensemble, self._limits, now)

    def _cell_too_hot(self) -> Finding | None:
        if not self._cells:
            return None
        hottest = self._response.nodes[self._sides].max(axis=0)
        worst = int(np.argmax(hottest))
        is_above = hottest[worst] > self._limits.cell
        if not is_above and not self._hidden.is_too_hot_inside(self._sides.ravel()):
            return None
        known = "" if is_above else ", as far as that is known"
        return Finding(
            "cell-temperature",
            f"cell {self._cells[worst]} is at {hottest[worst]:.0f} degC inside, says the twin"
            f"{known}; its limit is {self._limits.cell:g}",
            self._cells[worst],
        )

    def _deviation(self, reading: Reading) -> Finding | None:
        predicted = self._response.predicted
        unknown = np.hypot(self._limits.deviation, self._response.unknown)
        limit = ALLOWED_PART_OF_RISE * self._response.rise + unknown
        apart = reading.temperatures - predicted
        worst = int(np.argmax(np.abs(apart) - limit))
        if abs(apart[worst]) <= limit[worst]:
            return None
        return Finding(
            "deviation",
            f"{self._channels[worst]} reads {reading.temperatures[worst]:.1f} degC where the twin "
            f"has {predicted[worst]:.1f}, more than {limit[worst]:.0f} K apart",
            self._channels[worst],
        )

    def _unresponsive(self, reading: Reading) -> Finding | None:
        still = self._following.judge(reading, self._response)
        if still is None:
            return None
        changed = reading.temperatures[still] - self._response.first[still]
        return Finding(
            "unresponsive",
            f"{self._channels[still]} does not follow the duty: it has changed by {changed:+.1f} K "
            f"where the duty alone makes {self._response.by_duty[still]:+.0f} K, says the twin; is "
            "the sensor on the plate?",
            self._channels[still],
        )
