"""The twin beside the rig: an observer that gets the rig's duty and readings as they arrive, and
the journal of its estimates."""

import math
from collections.abc import Callable
from typing import Any, final

import jax
import numpy as np
from jaxtyping import Float

from .._celsius import ZERO_CELSIUS
from .._jax_settings import to_numpy
from ..observers import (
    AbstractObserver,
    ExtendedKalmanFilter,
    Moment,
    OpenLoop,
    followed,
    predicted,
    started,
    state_moments,
)
from ..physics import Twin
from .protocol._clock import seconds
from .protocol._records import Reading, Record, Sample, StateEstimate
from .protocol._rig_state import RigState


@final
class Follower:
    """Follows a live or replayed rig. It consumes the records of a source.

    All nodes of the twin start at the mean of the first temperatures, because the earlier state of
    the rig is not known. If the rig was not at rest, the prediction of an open loop is wrong for
    some minutes.

    **Arguments:**

    - `twin`: the twin.
    - `observer`: the observer that follows; None: the twin in open loop.
    """

    def __init__(self, twin: Twin, observer: AbstractObserver[Any] | None = None):
        self.measured: Float[np.ndarray, " channels"] | None = None
        """The last measured temperatures, degC."""
        self.predicted: Float[np.ndarray, " channels"] | None = None
        """The prediction of them, before they corrected anything, degC."""
        with jax.enable_x64(True):
            self._observer: AbstractObserver[Any] = OpenLoop(twin) if observer is None else observer
        self._predict = predicted.bind(self._observer)
        self._follow = followed.bind(self._observer)
        self._driver = twin.rig.driver
        room = twin.rig.ambient_temperature.evaluate(twin.numbers_si)
        self.ambient = math.nan
        """The ambient temperature that was measured last, degC; NaN if none was."""
        self._duty = np.zeros(len(twin.rig.driven))
        self._state: Any = None
        self._time = 0  # host time up to which the observer has predicted, ns
        self._is_read = True  # whether a reading came after the last sample
        # This compiles before the first data arrive.
        self._start(float(room) - ZERO_CELSIUS)

    @property
    def observer(self) -> AbstractObserver[Any]:
        """What it follows with."""
        return self._observer

    @property
    def time(self) -> int:
        """The host time up to which it has followed the rig, ns."""
        return self._time

    @property
    def state(self) -> Any:
        """Its state, as arrays of NumPy."""
        return to_numpy(self._state)

    @property
    def device_state(self) -> Any:
        """The same as arrays of JAX, in float64, for a program that takes it at every reading."""
        return self._state

    @property
    def duty(self) -> Float[np.ndarray, " cells"]:
        """The duty that was applied last, -1 to 1."""
        return self._duty

    @property
    def nodes(self) -> Float[np.ndarray, " nodes"]:
        """The temperatures of all nodes of the twin, degC."""
        return np.asarray(self._observer.nodes(self._state))

    def on_record(self, record: Record, state: RigState) -> None:
        """Takes the next record, and what is known of the rig after it."""
        match record:
            case Sample() if record.pwm:
                duty = np.asarray(self._driver.duty(record.pwm), np.float64)
                # A sample that says nothing new is left to the reading that follows it.
                is_new = not self._is_read or bool((duty != self._duty).any())
                if self.measured is not None and is_new:
                    self._advance(state.time_of(record), state.rate)
                self._duty, self._is_read = duty, False
                self.ambient = self.ambient if record.ambient is None else record.ambient
            case Reading() if not record.recalibrating:
                if self.measured is None:
                    self._time = state.time_of(record)
                    self._start(float(np.nanmean(record.temperatures)))
                self.measured, self._is_read = record.temperatures, True
                self._correct(state.time_of(record), state.rate, record.temperatures)

    def on_time(self, state: RigState, now: int) -> None:
        """Does nothing: the twin advances with the records."""

    def _start(self, temperature: float) -> None:
        with jax.enable_x64(True):
            self._state = started(self._observer, np.float64(temperature), self._duty)
        predicted = self._step(0.0)
        # This compiles, and corrects nothing: a reading is used once.
        self._read(0.0, np.full(len(predicted), math.nan))

    def _advance(self, now: int, rate: float) -> None:
        self.predicted = self._step(self._passed(now, rate))

    def _correct(self, now: int, rate: float, readings: Float[np.ndarray, " channels"]) -> None:
        self.predicted = self._read(self._passed(now, rate), readings)

    def _passed(self, now: int, rate: float) -> float:
        """The time of the rig, s, to host time `now`, up to which it is followed from here on."""
        dt = max(seconds(now - self._time) * rate, 0.0)
        self._time = max(now, self._time)
        return dt

    def _step(self, dt: float) -> Float[np.ndarray, " channels"]:
        with jax.enable_x64(True):
            room = np.float64(self.ambient)
            self._state, predicted = self._predict(self._state, self._duty, room, np.float64(dt))
        return np.asarray(predicted)

    def _read(
        self, dt: float, readings: Float[np.ndarray, " channels"]
    ) -> Float[np.ndarray, " channels"]:
        with jax.enable_x64(True):
            room, mask = np.float64(self.ambient), np.isfinite(readings)
            self._state, predicted = self._follow(
                self._state, self._duty, room, np.float64(dt), readings, mask
            )
        return np.asarray(predicted)


# Keeps in a recording what an observer estimates, beside what was measured.

# The shortest time between two estimates that are kept, ns.
MIN_INTERVAL_NS = 10**9


@final
class EstimateJournal:
    """Notes what an observer estimates after a reading, at most once a second. It consumes the
    records of a source after the follower.

    **Arguments:**

    - `note`: takes the record for the journal, such as `RigConnection.note`.
    - `followed`: the follower, with an extended Kalman filter, and what its twin is called. It may
      change.
    """

    def __init__(
        self, note: Callable[[Record], None], followed: Callable[[], tuple[Follower, str]]
    ):
        self._note, self._followed = note, followed
        self._reading: Reading | None = None
        self._noted = 0

    def on_record(self, record: Record, state: RigState) -> None:
        """Does nothing: the estimate is made when all records that arrived together are folded."""

    def on_time(self, state: RigState, now: int) -> None:
        """Notes the estimate after a new reading."""
        if state.reading is self._reading or now - self._noted < MIN_INTERVAL_NS:
            return
        follower, twin = self._followed()
        observer = follower.observer
        if follower.measured is None or not isinstance(observer, ExtendedKalmanFilter):
            return
        self._reading, self._noted = state.reading, now
        values = estimated_values(observer, follower)
        self._note(StateEstimate(follower.time, twin, values))


def estimated_values(observer: ExtendedKalmanFilter, follower: Follower) -> dict[str, float]:
    """Name with unit -> estimate, and its standard deviation: of what the channels see without the
    errors of their readings, of the nodes beside the elements of a plate, of the room, and of the
    heat that the twin does not explain."""
    twin: Twin = observer.model.twin
    result = state_moments(observer, follower.state)
    first = twin.wiring.elements
    nodes = [node.name for node in twin.netlist.nodes][first:]
    values: dict[str, float] = {}

    def add(names: list[str], unit: str, spread: str, moment: Moment, start: int = 0) -> None:
        for place, name in enumerate(names, start):
            values[f"{name}_{unit}"] = float(moment.mean[place])
            values[f"{name}_spread_{spread}"] = float(moment.spread[place])

    add([f"channel_{name}" for name in twin.channels], "degC", "K", result.channels)
    add([f"node_{name}" for name in nodes], "degC", "K", result.nodes, first)
    add(["room"], "degC", "K", result.room)
    add([f"heat_{name}" for name in twin.rig.driven], "W", "W", result.heats)
    return values
