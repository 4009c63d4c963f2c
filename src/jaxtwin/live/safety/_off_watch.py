"""Whether a rig that reports off cools, or goes on to heat."""

from typing import Literal, final

import jax
import numpy as np
from jaxtyping import Float

from ...observers import OpenLoopState
from ..protocol._clock import seconds
from ..protocol._records import Reading, Record, Sample
from ..protocol._rig_state import RigState
from ._duty_response import DRIVEN, DutyResponse
from ._operating_limits import OperatingLimits
from ._twin_ensemble import TwinEnsemble

# The longest time for which the readings are watched after the end, s of the host.
WATCHED_SECONDS = 60.0

# The shortest time for which a rig that is off is watched, s of the rig.
MIN_SECONDS = 10.0

# For how long the readings of a rig that heats must show it, s of the rig: where the driver follows
# its command more slowly than the twin's, it heats for some seconds more, and then cools.
HOT_SECONDS = 4.0

# The least difference between a rig that is off and one that heats with which readings are judged,
# K. What the first second after a stop does is known least: heat is still on its way to the plate.
MIN_CHANGE_KELVIN = 2.0

# The part of the last duty that separates a rig that is off from one that heats, and how far beyond
# it the error of the estimate may reach.
HEATS, CLEARANCE = 0.5, 0.25

# The largest part of full duty that a rig can show: its contacts may be better than the twin's.
MAX_PART = 1.5

# The distance in standard deviations of noise that a verdict needs.
NOISE_SIGMAS = 3.0

# The time constant with which earlier readings are forgotten, s of the rig: the difference grows,
# and the last readings say most.
MEMORY_SECONDS = 3.0

# The distance in standard deviations of the draws of the twin that a verdict needs.
DRAW_SIGMAS = 3.0

# For a twin without draws: the relative error of the change that it predicts for a rig that is off.
COOLING_ERROR = 0.3

# The least rise above the room from which the gain of a reading is told, K.
MIN_RISE_KELVIN = 5.0

# The least duty in all cells that must be told from none.
MIN_LEVEL = 0.25

# The twin whose duty is held, of the three.
HELD_TWIN = 1

Verdict = Literal["", "off", "heats", "unknown"]


def heat_sentence(detail: str) -> str:
    """What is said of a rig that heats after a stop."""
    return f"THE RIG HEATS AFTER A STOP: CUT THE POWER; {detail}"


@final
class OffWatch:
    r"""Compares the readings after a stop with twins: one that is off, one whose duty is held, and
    one whose cells all get full duty. It consumes the records of a source.

    With $o$ the readings of the twin that is off, $h$ those of one that heats, and $g$ the gain of
    the readings before the stop on the rise of the twin, as sensors that are half covered show half
    of all changes, the part of the heat that goes on is estimated over all channels and readings,

    $$f = \frac{\sum (y - y_0 - g (o - o_0)) \, g (h - o)}{\sum g^2 (h - o)^2}.$$

    It is estimated with each draw of what the match of the twin has left open, whose spread is a
    part of its error: contacts, and the lag of the driver, say how much heat is still on its way.
    A rig is off if $f$ with its error, by noise and by the twin, is below three quarters of the
    last duty, and heats if it is above a quarter: after 10 to 56 s on the bundled rigs, later on a
    slow one. The twins must be `MIN_CHANGE_KELVIN` apart, and nothing is called off before
    `MIN_SECONDS`, because a device may begin anew. Readings that stand still, or change faster than
    full duty could make them, are those of a sensor that has failed, and show nothing. A report of
    heat also ends the watch, whoever commands it.

    **Arguments:**

    - `response`, `ensemble`: the twins beside the rig, up to the end of the run.
    - `limits`: the limits of the rig.
    - `now`: host time, ns.
    """

    def __init__(
        self, response: DutyResponse, ensemble: TwinEnsemble, limits: OperatingLimits, now: int
    ):
        self._time, self._ensemble = response.time, ensemble
        self._predict, self._room = response.predict, response.room
        held = response.last_heat
        level = max(float(np.abs(held).max()), MIN_LEVEL)
        held = held * level / np.abs(held).max()
        self._duty = np.array([np.zeros_like(held), held, np.ones_like(held)])
        self._levels = np.array([1.0, level])  # of the held duty, and of full duty
        self._sigma = limits.jump / 6
        self._gain: Float[np.ndarray, "draws channels"] | None = None
        self._begin_anew(jax.tree.map(lambda leaf: leaf[DRIVEN], response.states), now)

    def again(self, now: int) -> None:
        """Watches anew from `now`, host time in ns, after a verdict that the rig heats."""
        self._begin_anew(jax.tree.map(lambda leaf: leaf[HELD_TWIN], self._states), now)

    def on_record(self, record: Record, state: RigState) -> None:
        """Takes a record, and judges by it."""
        match record:
            case Sample() if any(record.pwm) and not self.verdict and not _is_cut(state):
                counts = ", ".join(map(str, record.pwm))
                by = f", commanded by {record.owner}" if record.owner else ""
                self.verdict = "heats"
                self.detail = f"the device reports {counts} counts again{by}"
            case Reading() if not record.recalibrating and not self.verdict:
                self._judge(record, state)

    def on_time(self, state: RigState, now: int) -> None:
        """Ends the watch when its time is over."""
        if not self.verdict and seconds(now - self._begin) > WATCHED_SECONDS:
            self.verdict = "unknown"
            self.detail = f"the readings did not show it within {WATCHED_SECONDS:g} s"

    def _begin_anew(self, twin: OpenLoopState, now: int) -> None:
        self.verdict: Verdict = ""
        """`off` or `heats`, once the readings show it; `unknown` if they do not in time."""
        self.detail = ""
        """What was seen, as the end of a sentence."""
        self._begin, self._has_begun = now, False
        self._watched = self._hot = 0.0  # s of the rig
        self._states = jax.tree.map(lambda leaf: np.repeat(leaf[None], 3, axis=0), twin)
        self._ensemble.branch(np.zeros_like(self._duty[0]))
        # Of e d, d^2, sigma |d|, and the cooling times |d|, for the held and for full duty.
        self._sums = np.zeros((4, 2, self._ensemble.count))

    def _start(self, temperatures: Float[np.ndarray, " channels"], passed: float) -> None:
        """Begins at the first readings that were made after the stop. Those before it may be old:
        a host or a link that stood still may have caused the stop."""
        self._has_begun, self._first = True, temperatures.copy()
        self._before = self._advance(passed, np.zeros_like(self._duty))[0]
        self._ensemble.branch(self._duty[HELD_TWIN])
        self._has_moved = np.zeros(len(self._first), bool)
        if self._gain is None:  # known by what the rig did before, not by what it does from here on
            rise = self._before - self._room
            is_judged = np.abs(rise) >= MIN_RISE_KELVIN
            gain = (self._first - self._room) / np.where(is_judged, rise, 1.0)
            self._gain = np.where(is_judged, np.clip(gain, 0.0, 1.0), 1.0)

    def _judge(self, reading: Reading, state: RigState) -> None:
        now = state.time_of(reading)
        if now < self._time:
            return
        passed, self._time = seconds(now - self._time) * state.rate, now
        if not self._has_begun:
            self._start(state.temperatures, passed)
            return
        assert self._gain is not None
        off, *heated = self._advance(passed, self._duty)
        self._watched += passed
        cooled = self._gain * (off - self._before)
        error = reading.temperatures - self._first - cooled
        apart = self._gain * (np.array(heated) - off)
        # A working sensor never reads the same for long.
        self._has_moved |= reading.temperatures != self._first
        valid = np.isfinite(error).all(axis=0) & self._has_moved
        error, cooled, apart = error[:, valid], cooled[:, valid], apart[:, :, valid]
        sizes = np.abs(apart)
        terms = [apart * error, apart**2, self._sigma * sizes, sizes * np.abs(cooled)]
        self._sums *= np.exp(-passed / MEMORY_SECONDS)
        self._sums += np.array([term.sum(axis=2) for term in terms])
        products, squares, noise, cooling = self._sums
        if (sizes.mean(axis=1).max(axis=1, initial=0.0) < MIN_CHANGE_KELVIN).any():
            return
        of_draws = products / squares
        part = of_draws.mean(axis=1)
        by_twin = (
            DRAW_SIGMAS * of_draws.std(axis=1)
            if self._ensemble.count > 1
            else COOLING_ERROR * (cooling / squares)[:, 0]
        )
        unknown = NOISE_SIGMAS * (noise / squares).mean(axis=1) + by_twin
        after = seconds(reading.arrival - self._begin)
        if abs(part[1]) - unknown[1] > MAX_PART:
            self.verdict = "unknown"
            self.detail = f"the readings change faster than full duty could, {after:.0f} s after it"
            return
        is_hot = part[1] < MAX_PART and (part - unknown > (HEATS - CLEARANCE) * self._levels).any()
        self._hot = self._hot + passed if is_hot else 0.0
        if self._hot > HOT_SECONDS:
            self.verdict = "heats"
            self.detail = (
                f"after {after:.0f} s the readings change as if {100 * part[0]:.0f} % of the last "
                f"duty, or {100 * part[1]:.0f} % of full duty, went on"
            )
        elif (
            self._watched > MIN_SECONDS
            and (part + unknown < (HEATS + CLEARANCE) * self._levels).all()
        ):
            self.verdict, self.detail = "off", f"as the readings show after {after:.0f} s"

    def _advance(
        self, dt: float, duty: Float[np.ndarray, "3 cells"]
    ) -> tuple[Float[np.ndarray, "draws channels"], ...]:
        """The readings of the twins that are off, have the last duty, and full duty."""
        with jax.enable_x64(True):
            states, readings = self._predict(
                self._states, duty, np.full(3, self._room), np.float64(dt)
            )
        self._states = jax.tree.map(np.asarray, states)
        off, held, full = np.asarray(readings)[:, None]
        if self._ensemble.count == 1:
            return off, held, full
        self._ensemble.step(dt, self._room)
        # What full duty adds is that of the twin itself: only its size counts.
        idle = self._ensemble.idle_readings
        return idle, self._ensemble.readings, idle + full - off


def _is_cut(state: RigState) -> bool:
    """Whether a relay has cut the supply: then it does not matter which counts a bridge reports."""
    return state.relay is not None and state.relay.relay == "off"
