"""The twin beside the rig: it gets the same duty and predicts the same channels."""

from collections.abc import Sequence
from typing import final

import numpy as np
from jaxtyping import Float

from ..physics import Twin
from ._live_twin import LiveTwin
from ._records import Greeting, Reading, Record, Sample


@final
class Follower:
    """Follows a live or replayed rig.

    All nodes of the twin start at the mean of the first temperatures, because the earlier state of
    the rig is not known. If the rig was not at rest, the prediction is wrong for some minutes.

    **Arguments:**

    - `twin`: the twin.
    """

    def __init__(self, twin: Twin):
        self.measured: Float[np.ndarray, " channels"] | None = None
        """The last measured temperatures, degC."""
        self.predicted: Float[np.ndarray, " channels"] | None = None
        """The twin's prediction of them, degC."""
        self._twin = LiveTwin(twin)
        self._driver = twin.rig.driver
        self._rate = 1.0
        self._begin: int | None = None

    @property
    def nodes(self) -> Float[np.ndarray, " nodes"]:
        """The temperatures of all nodes of the twin, degC."""
        return self._twin.nodes

    @property
    def ambient(self) -> float:
        """The ambient temperature of the twin, degC."""
        return self._twin.ambient

    def update(self, records: Sequence[Record]) -> None:
        """Takes records in their order."""
        for record in records:
            match record:
                case Greeting():
                    self._rate = record.hello.rate
                case Sample() if record.pwm:
                    if self._begin is not None:
                        self._twin.advance(self._time(record.arrival))
                    self._twin.drive(self._driver.duty(record.pwm), record.ambient)
                case Reading() if not record.recalibrating:
                    self.measured = record.temperatures
                    if self._begin is None:
                        self._begin = record.arrival
                        self._twin.start(0.0, float(np.nanmean(record.temperatures)))
                    self.predicted = self._twin.advance(self._time(record.arrival))

    def _time(self, arrival: int) -> float:
        return (arrival - (self._begin or 0)) * 1e-9 * self._rate
