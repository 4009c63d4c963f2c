"""What the duty does to the readings, as the twin says, and what else of a rig is not known."""

from typing import final

import numpy as np
from jaxtyping import Float

from ..physics import System, Twin
from ._live_twin import LiveTwin
from ._records import Greeting, Reading, Record, Sample

ROOM_KELVIN = 5.0
"""How much colder than in the rig file a room may be that nobody has measured, K."""

NOISE_TO_UNEVENNESS = 0.03
"""The noise of the first readings divided by the differences between them that a rig may have."""


@final
class DutyResponse:
    """Twins beside a rig whose earlier state is unknown, and whose room may be.

    - `driven` gets the rig's duty. It starts at the first readings (`_uneven`), in the warmer of
      the two rooms that are possible: one as warm as the first readings, since the rig was at rest,
      or that of the rig file. A measured or given ambient temperature leaves only one. The warmer
      one is taken because it makes the cells hotter.
    - `idle` starts in the same way and gets no duty. The difference of the two is what the duty
      does to the readings. An error of the room or of the start hardly changes it.
    - `other` gets no duty either, and is the other extreme of what is possible: it stands in the
      colder room, by `ROOM_KELVIN` colder still if it is not measured, and what no channel sees,
      such as sinks, starts at the temperature of that room.

    **Arguments:**

    - `twin`: the twin of the rig.
    - `ambient`: the ambient temperature of a rig that does not measure it, degC; None: unknown.
    """

    def __init__(self, twin: Twin, ambient: float | None = None):
        self._driven, self._idle, self._other = (LiveTwin(twin) for _ in range(3))
        self._file_room = self._driven.ambient
        self._ambient = ambient
        self._driver = twin.rig.driver
        self._rate = 1.0
        self._begin: int | None = None
        self._first = self._began = np.zeros(0)
        seen = np.any(np.asarray(self._driven.system.channel_weights) != 0, axis=0)
        seen[: twin.wiring.elements] = True
        self._seen = seen

    @property
    def has_begun(self) -> bool:
        """Whether there has been a reading."""
        return self._begin is not None

    @property
    def nodes(self) -> Float[np.ndarray, " nodes"]:
        """The temperatures of all nodes of the driven twin, degC."""
        return self._driven.nodes

    @property
    def predicted(self) -> Float[np.ndarray, " channels"]:
        """The readings of the driven twin, degC."""
        return self._driven.temperatures

    @property
    def by_duty(self) -> Float[np.ndarray, " channels"]:
        """The change of the readings by the duty since the start, K."""
        return self._driven.temperatures - self._idle.temperatures

    @property
    def without_duty(self) -> Float[np.ndarray, " channels"]:
        """The change of the readings without any duty since the start, K."""
        return self._idle.temperatures - self._began

    @property
    def unknown(self) -> Float[np.ndarray, " channels"]:
        """The largest error of the twins by room and start, which stands for three standard
        deviations, K: the difference of the two idle twins."""
        return np.abs(self._other.temperatures - self._idle.temperatures)

    @property
    def rise(self) -> float:
        """The largest difference of a predicted reading from the room, K."""
        return float(np.abs(self.predicted - self._driven.ambient).max())

    @property
    def first(self) -> Float[np.ndarray, " channels"]:
        """The first readings, degC."""
        return self._first

    @property
    def surprise(self) -> float:
        """How far the first readings are from a room that is only known from the rig file, K; 0 if
        the ambient temperature is measured or given."""
        known = self._begin is None or self._ambient is not None
        return 0.0 if known else abs(float(self._first.mean()) - self._file_room)

    def update(self, record: Record) -> None:
        """Takes the next record."""
        match record:
            case Greeting():
                self._rate = record.hello.rate
            case Sample() if record.pwm:
                self._advance(record.arrival)
                if record.ambient is not None:
                    self._ambient = record.ambient
                self._driven.drive(self._driver.duty(record.pwm), self._ambient)
                for twin in (self._idle, self._other):
                    twin.drive(np.zeros(len(record.pwm)), self._ambient)
            case Reading() if not record.recalibrating:
                if self._begin is None:
                    self._start(record)
                self._advance(record.arrival)

    def _start(self, reading: Reading) -> None:
        self._begin, self._first = reading.arrival, reading.temperatures
        mean = float(reading.temperatures.mean())
        warm = cold = self._ambient
        if warm is None or cold is None:
            warm = max(mean, self._file_room)
            cold = min(mean, self._file_room) - ROOM_KELVIN
        self._idle.start(0.0, mean, warm)
        nodes = mean + _uneven(self._idle.system, self._first - self._idle.temperatures)
        for twin in (self._driven, self._idle):
            twin.start(0.0, nodes, warm)
        self._other.start(0.0, np.where(self._seen, nodes, cold), cold)
        self._began = self._idle.temperatures

    def _advance(self, arrival: int) -> None:
        if self._begin is None:
            return
        time = (arrival - self._begin) * 1e-9 * self._rate
        for twin in (self._driven, self._idle, self._other):
            twin.advance(time)


def _uneven(system: System, apart: Float[np.ndarray, " channels"]) -> Float[np.ndarray, " nodes"]:
    r"""The smoothest temperatures of the nodes, as rises above a uniform one, that change the
    readings by `apart`, K.

    A rig with the conductance matrix $G$ is as uneven as its links allow: the rises have the
    covariance $G^{-1}$. Given the readings $A x$, their mean is
    $G^{-1} A^T (A G^{-1} A^T + \epsilon I)^{-1} A x$ (Gauss-Markov estimate).
    """
    weights = np.asarray(system.gain)[:, None] * np.asarray(system.channel_weights)
    spread = np.linalg.solve(np.asarray(system.conductance), weights.T)
    between = weights @ spread
    noise = NOISE_TO_UNEVENNESS**2 * float(np.trace(between)) / len(between)
    return spread @ np.linalg.solve(between + noise * np.eye(len(between)), apart)
