"""What the duty does to the readings, as the twin says; whether they follow it at all; and what
else of a rig is not known."""

from typing import final

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from ..._compilation import persistent_jit
from ...observers import OpenLoop, OpenLoopState
from ...physics import System, Twin
from ..protocol._clock import seconds
from ..protocol._records import Reading, Record, Sample
from ..protocol._rig_state import RigState
from ._operating_limits import OperatingLimits

# How much colder than in the rig file a room may be that nobody has measured, K.
ROOM_KELVIN = 5.0

DRIVEN, IDLE, OTHER = range(3)

# The noise of the first readings divided by the differences between them that a rig may have.
NOISE_TO_UNEVENNESS = 0.03


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
        with jax.enable_x64(True):
            self._observer = OpenLoop(twin)
            self._file_room = float(self._observer.stepper.ambient)
        self.predict = _stepped.bind(self._observer)
        """The program that steps three twins by their states, duty, rooms and a time."""
        self._ambient = ambient
        self._rooms = np.full(3, self._file_room)
        self._driver = twin.rig.driver
        self._duty = np.zeros((3, len(twin.rig.driven)))
        self.elapsed = 0.0
        """The time since the first reading, s of the rig."""
        self.last_heat = np.zeros(len(twin.rig.driven))
        """The last duty other than 0 that the device reported, -1 to 1."""
        self._begin: int | None = None
        self._time = 0  # host time up to which the twins have been stepped, ns
        system = self._observer.stepper.system
        self._first = self._began = np.zeros(0)
        self._seen = seen_nodes(system)
        # This also compiles the steps before the first data arrive.
        self._set([self._file_room] * 3)

    @property
    def has_begun(self) -> bool:
        """Whether there has been a reading."""
        return self._begin is not None

    @property
    def time(self) -> int:
        """The host time up to which the twins have been stepped, ns."""
        return self._time

    @property
    def duty(self) -> Float[np.ndarray, " cells"]:
        """The duty that the device reported last, -1 to 1."""
        return self._duty[DRIVEN].copy()

    @property
    def room(self) -> float:
        """The room of the driven twin, degC."""
        return float(self._rooms[DRIVEN])

    @property
    def is_seen(self) -> Bool[np.ndarray, " nodes"]:
        """The nodes that a channel sees, and all elements of the plate."""
        return self._seen

    @property
    def nodes(self) -> Float[np.ndarray, " nodes"]:
        """The temperatures of all nodes of the driven twin, degC."""
        return np.asarray(self.states.twin.nodes)[DRIVEN]

    @property
    def predicted(self) -> Float[np.ndarray, " channels"]:
        """The readings of the driven twin, degC."""
        return self._readings[DRIVEN]

    @property
    def by_duty(self) -> Float[np.ndarray, " channels"]:
        """The change of the readings by the duty since the start, K."""
        return self._readings[DRIVEN] - self._readings[IDLE]

    @property
    def without_duty(self) -> Float[np.ndarray, " channels"]:
        """The change of the readings without any duty since the start, K."""
        return self._readings[IDLE] - self._began

    def shown(self, readings: Float[np.ndarray, " channels"]) -> Float[np.ndarray, " channels"]:
        """The change of readings beyond that of an idle rig since the start, K."""
        return readings - self._first - self.without_duty

    def deviations(self, jump: float) -> Float[np.ndarray, " channels"]:
        """The standard deviation of what is not known of readings, K: their own error by noise and
        recalibrations, a sixth of the largest `jump`, and a third of `unknown`."""
        return np.hypot(jump / 6, self.unknown / 3)

    @property
    def unknown(self) -> Float[np.ndarray, " channels"]:
        """The largest error of the twins by room and start, which stands for three standard
        deviations, K: the difference of the two idle twins."""
        return np.abs(self._readings[OTHER] - self._readings[IDLE])

    @property
    def rise(self) -> float:
        """The largest difference of a predicted reading from the room, K."""
        return float(np.abs(self.predicted - self._rooms[DRIVEN]).max())

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

    def update(self, record: Record, state: RigState) -> None:
        """Takes the next record, and what is known after it."""
        match record:
            case Sample() if record.pwm:
                self._advance(state.time_of(record), state.rate)
                if record.ambient is not None:
                    self._ambient = record.ambient
                if self._ambient is not None and (self._rooms != self._ambient).any():
                    self._rooms[:] = self._ambient
                    self._step(0.0)
                self._duty[DRIVEN] = self._driver.duty(record.pwm)
                if any(record.pwm):
                    self.last_heat = self.duty
            case Reading() if not record.recalibrating:
                if self._begin is None:
                    self._start(record, state.time_of(record))
                self._advance(state.time_of(record), state.rate)

    def _start(self, reading: Reading, now: int) -> None:
        self._begin = self._time = now
        self._first = reading.temperatures
        mean = float(reading.temperatures.mean())
        warm = cold = self._ambient
        if warm is None or cold is None:
            warm = max(mean, self._file_room)
            cold = min(mean, self._file_room) - ROOM_KELVIN
        self._rooms = np.array([warm, warm, cold])
        self._set([mean] * 3)
        apart = self._first - self._readings[IDLE]
        nodes = mean + _uneven(self._observer.stepper.system, apart)
        self._set([nodes, nodes, np.where(self._seen, nodes, cold)])
        self._began = self._readings[IDLE]

    def _advance(self, now: int, rate: float) -> None:
        if self._begin is None or now <= self._time:
            return
        passed = seconds(now - self._time) * rate
        self._step(passed)
        self._time, self.elapsed = now, self.elapsed + passed

    def _set(self, nodes: list[Float[np.ndarray, " nodes"]] | list[float]) -> None:
        """Starts the twins at temperatures of their nodes, degC. A driver with a lag is assumed to
        have reached its last command."""
        with jax.enable_x64(True):
            starts = [self._observer.init(*pair) for pair in zip(nodes, self._duty, strict=True)]
            self.states: OpenLoopState = jax.tree.map(lambda *rows: np.stack(rows), *starts)
            """The states of the three twins."""
        self._step(0.0)

    def _step(self, dt: float) -> None:
        with jax.enable_x64(True):
            states, readings = self.predict(self.states, self._duty, self._rooms, np.float64(dt))
        # The states are kept as NumPy arrays, because they are read between two steps.
        self.states = jax.tree.map(np.asarray, states)
        self._readings = np.asarray(readings)


def seen_nodes(system: System) -> Bool[np.ndarray, " nodes"]:
    """The nodes that a channel sees, and all elements of the plate."""
    seen = np.any(np.asarray(system.channel_weights) != 0, axis=0)
    seen[: system.wiring.elements] = True
    return seen


@persistent_jit
def _stepped(
    observer: OpenLoop,
    states: OpenLoopState,
    duty: Float[Array, "twins cells"],
    rooms: Float[Array, " twins"],
    dt: Float[Array, ""],
) -> tuple[OpenLoopState, Float[Array, "twins channels"]]:
    """The twins after a time, and their readings."""
    return jax.vmap(step_and_read, in_axes=(None, 0, 0, 0, None))(observer, states, duty, rooms, dt)


def step_and_read(
    observer: OpenLoop,
    state: OpenLoopState,
    duty: Float[Array, " cells"],
    room: Float[Array, ""],
    dt: Float[Array, ""],
) -> tuple[OpenLoopState, Float[Array, " channels"]]:
    """A twin in open loop after a time, and its readings."""
    state = observer.predict(state, duty, room, dt)
    return state, observer.readings(state, room)


def _uneven(system: System, apart: Float[np.ndarray, " channels"]) -> Float[np.ndarray, " nodes"]:
    r"""The smoothest temperatures of the nodes, as rises above a uniform one, that change the
    readings by `apart`, K.

    A rig with the conductance matrix $G$ is as uneven as its links allow: the rises have the
    covariance $G^{-1}$. Given the readings $A x$, their mean is
    $G^{-1} A^T (A G^{-1} A^T + \epsilon I)^{-1} A x$ (Gauss-Markov estimate).
    """
    with jax.enable_x64(True):
        weights = np.asarray(system.output_matrices()[0])
    spread = np.linalg.solve(np.asarray(system.conductance), weights.T)
    between = weights @ spread
    noise = NOISE_TO_UNEVENNESS**2 * float(np.trace(between)) / len(between)
    return spread @ np.linalg.solve(between + noise * np.eye(len(between)), apart)


# Whether readings follow the duty at all.

# The part of the predicted change by the duty below which a reading does not follow it. The
# recorded two-cell plate, one of whose cells is loose, shows at least 0.24 of what its twin
# predicts before a match, and the recorded single cell 0.85.
MIN_GAIN = 0.1

# The predicted change by the duty below which a reading is not judged, in limits of deviation: a
# contact that is worse than the twin's delays the first kelvins most.
MIN_CHANGE = 1.5

# The time constant with which earlier readings are forgotten, s of the rig. After a reversal of the
# duty the plate lags behind the twin, and a gain at one time says nothing.
MEMORY_SECONDS = 60.0

# The predicted change by the duty with which a reading is judged, in standard deviations of what is
# not known: its noise, the room and the start. A reading that stays where it was is then three of
# them from one that shows half of the change.
DEVIATIONS = 6.0


@final
class Responsiveness:
    r"""Estimates by least squares which part of the predicted change each reading shows.

    With $y$ the change of a reading beyond that of an idle rig, and $d$ the change by the duty
    that the twin predicts, the gain is $\sum w y d / \sum w d^2$ with weights $w$ that fade. What
    is not known, of standard deviation $\sigma$, changes it by $\sum w \sigma |d| / \sum w d^2$.

    **Arguments:**

    - `channels`: the number of channels.
    - `limits`: the limits of the rig.
    """

    def __init__(self, channels: int, limits: OperatingLimits):
        self._limits = limits
        self._sums = np.zeros((3, channels))  # of y d, sigma |d| and d^2
        self._last: int | None = None

    def judge(self, reading: Reading, response: DutyResponse) -> int | None:
        """Takes a reading. Returns the number of a channel that does not follow, if there is one.

        **Arguments:**

        - `reading`: valid temperatures.
        - `response`: the twins, up to this reading.
        """
        by_duty = response.by_duty
        shown = response.shown(reading.temperatures)
        deviations = response.deviations(self._limits.jump)
        passed = 0.0 if self._last is None else (reading.device_us - self._last) * 1e-6
        self._last = reading.device_us
        kept = np.exp(-max(passed, 0.0) / MEMORY_SECONDS)
        terms = shown * by_duty, deviations * np.abs(by_duty), by_duty**2
        self._sums = kept * self._sums + np.array(terms)
        followed, unknown, whole = self._sums
        large = np.abs(by_duty) >= MIN_CHANGE * self._limits.deviation
        judged = large & (DEVIATIONS * unknown <= whole)
        silent = judged & (followed < MIN_GAIN * whole)
        return int(np.argmax(silent)) if silent.any() else None
