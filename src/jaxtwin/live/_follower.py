"""The twin beside the rig: an observer that gets the rig's duty and readings as they arrive."""

import math
from typing import Any, final

import jax
import numpy as np
from jaxtyping import Float

from .._celsius import ZERO_CELSIUS
from ..observers import AbstractObserver, OpenLoop
from ..observers._programs import corrected, predicted, started
from ..physics import Twin
from .protocol._clock import seconds
from .protocol._records import Reading, Record, Sample
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
        self._take_readings = corrected.bind(self._observer)
        self._driver = twin.rig.driver
        room = twin.rig.ambient_temperature.evaluate(twin.numbers_si)
        self.ambient = math.nan
        """The ambient temperature that was measured last, degC; NaN if none was."""
        self._duty = np.zeros(len(twin.rig.driven))
        self._state: Any = None
        self._time = 0  # host time up to which the observer has predicted, ns
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
                if self.measured is not None:
                    self._advance(state.time_of(record), state.rate)
                self._duty = np.asarray(self._driver.duty(record.pwm), np.float64)
                self.ambient = self.ambient if record.ambient is None else record.ambient
            case Reading() if not record.recalibrating:
                if self.measured is None:
                    self._time = state.time_of(record)
                    self._start(float(np.nanmean(record.temperatures)))
                self.measured = record.temperatures
                self._advance(state.time_of(record), state.rate)
                self._correct(record.temperatures)

    def on_time(self, state: RigState, now: int) -> None:
        """Does nothing: the twin advances with the records."""

    def _start(self, temperature: float) -> None:
        with jax.enable_x64(True):
            state = started(self._observer, np.float64(temperature), self._duty)
        self._state = jax.tree.map(np.asarray, state)
        predicted = self._step(0.0)
        # This compiles, and corrects nothing: a reading is used once.
        self._correct(np.full(len(predicted), math.nan))

    def _advance(self, now: int, rate: float) -> None:
        self.predicted = self._step(max(seconds(now - self._time) * rate, 0.0))
        self._time = max(now, self._time)

    def _step(self, dt: float) -> Float[np.ndarray, " channels"]:
        with jax.enable_x64(True):
            room = np.float64(self.ambient)
            state, predicted = self._predict(self._state, self._duty, room, np.float64(dt))
        # The state is kept as NumPy arrays, because it is read between two steps.
        self._state = jax.tree.map(np.asarray, state)
        return np.asarray(predicted)

    def _correct(self, readings: Float[np.ndarray, " channels"]) -> None:
        with jax.enable_x64(True):
            room = np.float64(self.ambient)
            mask = np.isfinite(readings)
            state = self._take_readings(self._state, readings, mask, room)
        self._state = jax.tree.map(np.asarray, state)
