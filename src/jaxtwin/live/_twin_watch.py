"""Interlock: temperatures that the twin predicts, also where there is no sensor."""

from typing import final

import numpy as np

from ..physics import Twin
from ._follower import Follower
from ._operating_limits import OperatingLimits
from ._records import Reading, Record, Sample
from ._trip import Trip

SHARE = 0.5
"""The part of the predicted rise by which a reading may differ from it: a rig may be driven before
its twin is matched."""


@final
class TwinWatch:
    """Runs the twin beside the rig. Trips if its cells are too hot, or a reading deviates from it.

    **Arguments:**

    - `twin`: the twin of the rig.
    - `limits`: the limits of the rig.
    """

    def __init__(self, twin: Twin, limits: OperatingLimits):
        self._follower = Follower(twin)
        self._limits = limits
        self._cells = tuple(cell.name for cell in twin.rig.cells)
        self._channels = twin.channels
        self._sides = np.array([twin.wiring.cold, twin.wiring.hot])
        self._unknown: float | None = None  # largest error of the twin's room temperature
        self._room_measured = False

    def see(self, record: Record) -> Trip | None:
        self._follower.update([record])
        if isinstance(record, Sample) and record.ambient is not None:
            self._room_measured = True
        return self._deviation(record) or self._cell_too_hot(record)

    def check(self, now: int) -> Trip | None:
        return None

    def _cell_too_hot(self, record: Record) -> Trip | None:
        if self._follower.predicted is None or not isinstance(record, Reading | Sample):
            return None
        hottest = self._follower.nodes[self._sides].max(axis=0)
        worst = int(np.argmax(hottest))
        if hottest[worst] <= self._limits.cell:
            return None
        return Trip(
            "cell-temperature",
            f"cell {self._cells[worst]} is at {hottest[worst]:.0f} degC inside, says the twin; its "
            f"limit is {self._limits.cell:g}",
        )

    def _deviation(self, record: Record) -> Trip | None:
        predicted = self._follower.predicted
        if predicted is None or not isinstance(record, Reading) or record.recalibrating:
            return None
        room = self._follower.ambient
        if self._unknown is None:
            self._unknown = abs(float(record.temperatures.mean()) - room)
        limit = self._limits.deviation + SHARE * float(np.abs(predicted - room).max())
        limit += 0.0 if self._room_measured else self._unknown
        apart = record.temperatures - predicted
        worst = int(np.argmax(np.abs(apart)))
        if abs(apart[worst]) <= limit:
            return None
        return Trip(
            "deviation",
            f"{self._channels[worst]} reads {record.temperatures[worst]:.1f} degC where the twin "
            f"has {predicted[worst]:.1f}, more than {limit:.0f} K apart",
        )
