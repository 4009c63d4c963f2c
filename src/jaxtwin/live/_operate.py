"""Commands a rig behind its interlocks, by a plan or a controller."""

import secrets
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, final

import numpy as np
from jaxtyping import Float

from .._arguments import true_or_false
from ..errors import JaxtwinError, SafetyStop
from ..io import Experiment, check_duty_of_rig
from ..rig import Rig
from ._readiness import wait_until_ready
from ._service import RecordConsumer, Service
from ._stop_request import StopRequest
from ._switch_off import STILL_HEATS, STILL_ON, Ending, poll_whatever_happens, switch_off, watch_off
from .protocol._clock import seconds
from .protocol._records import Document, Event, Record
from .protocol._rig_connection import RigConnection
from .protocol._rig_state import RigState
from .safety._guard import Guard
from .safety._interlock import Finding

# The interval between two commands, s; each also resets the watchdog of the device.
INTERVAL = 0.25


class Moment(NamedTuple):
    """The state of the rig that a controller gets when it is asked for the duty.

    - `time`: the time since the start of the run, s of the rig.
    - `temperatures`: the last valid temperature of each channel, degC `(channels,)`; NaN where
      there has been none.
    - `age`: how long ago each was measured, by the clock of the device, s of the rig
      `(channels,)`.
    - `duty`: the duty of the cells now, as the device reports it, -1 to 1, positive heats
      `(cells,)`.
    - `ambient`: the ambient temperature, degC; `None` if it is not measured.
    """

    time: float
    temperatures: Float[np.ndarray, " channels"]
    age: Float[np.ndarray, " channels"]
    duty: Float[np.ndarray, " cells"]
    ambient: float | None


DutySource = Callable[[Moment], Sequence[float] | np.ndarray | None]
"""The duty of each cell now, -1 to 1, positive heats; `None` ends the run."""


def operate(
    connection: RigConnection,
    guard: Guard,
    duty: DutySource,
    *,
    reset: bool = False,
    about: Mapping[str, Any] | None = None,
    stop: threading.Event | None = None,
    consumers: Sequence[RecordConsumer] = (),
    on_progress: Callable[[float, tuple[int, ...]], None] | None = None,
    on_alarm: Callable[[Finding], None] | None = None,
    on_end: Callable[[Ending], None] | None = None,
    confirm_off: bool = True,
) -> Literal["completed", "stopped"]:
    """Commands a live rig. Its device reports off when it returns, also after an error, and the
    readings have been watched until they show it, for a minute at most.

    The device has tripped after every end except two: `duty` ended the run, or its user did, by
    setting `stop` or by Ctrl-C. While the device reports heat after a stop, the function does not
    return: it sends `stop` until the device reports that the cells are off, or until `stop` is set
    again (or Ctrl-C).

    **Arguments:**

    - `connection`: the links of the rig, started.
    - `guard`: the guard of this run, such as `Guard.of(twin)`.
    - `duty`: the source of the duty, which is called every quarter of a second.
    - `reset`: whether a trip of the device is ended first, on purpose.
    - `about`: details that are recorded at the start of the run, such as a plan or a command line.
    - `stop`: an event that ends the run early when it is set. A `StopRequest` with the name of a
      signal leaves a trip.
    - `consumers`: who else gets the records of the run, such as a `Follower`. If one fails, the
      cells are switched off.
    - `on_progress`: called with the time (s of the rig) and the counts after each command.
    - `on_alarm`: called if the device reports heat, or nothing, two seconds after a stop, and if
      the readings show that the rig heats after it.
    - `on_end`: called at the end with what the device reports, and again with what the readings
      show.
    - `confirm_off`: whether the readings are watched after the end. Who goes on to poll the
      connection may do so itself (`Guard.off_watch`).

    **Returns:** `"completed"` if `duty` ended the run, `"stopped"` if `stop` did.

    **Raises:** `SafetyStop` if an interlock trips, a signal ends the run, or the rig does not
    become ready. Its kind is `still-on` if the device reported heat after the stop, `heats` if the
    rig went on to heat or did so again, `unconfirmed` if it reported nothing. `JaxtwinError` for a
    guard that has been used before, or an invalid argument; the errors of `duty`, of the consumers
    and of the journal.
    """
    true_or_false("operate: reset", reset, JaxtwinError)
    guard.begin()
    service = Service(connection, [guard, *consumers])
    run, before = _Run(connection, service, guard), connection.number
    uid = secrets.token_hex(8)
    content = {"rig": connection.rig.name, "owner": connection.owner, "limits": guard.settings}
    connection.note(Document(connection.clock.now(), "start", uid, {**(about or {}), **content}))
    status, error = "completed", None
    try:
        status = run.go(duty, reset, stop, on_progress)
    except BaseException as raised:
        status, error = "stopped", raised
        if not isinstance(raised, KeyboardInterrupt):
            status = "tripped" if isinstance(raised, SafetyStop) else "failed"
    kind = error.kind if isinstance(error, SafetyStop) else type(error).__name__ if error else ""
    # A run that has ended a trip and does not start puts it back, except on another host's rig.
    reset_only = connection.number != before and not run.commanding and kind != "commander"
    # This is done even before the first command: an earlier host may have left the cells on.
    ending = switch_off(
        connection,
        trip=(run.commanding and status in ("tripped", "failed")) or reset_only,
        insist=run.commanding,
        state=service.state,
        stop=stop,
        on_record=run.follow,
        on_alarm=on_alarm,
    )
    if ending.tripped or not ending.stopped:  # otherwise only the watchdog ends the command
        connection.send_order("release")
    error = error or ending.failure
    kind = error.kind if isinstance(error, SafetyStop) else type(error).__name__ if error else ""
    reported = {"off": ending.off, "tripped": ending.tripped}
    end = {"status": status, "kind": kind, "reason": str(error or ""), **reported}
    connection.note(Document(connection.clock.now(), "stop", uid, end))
    _, failure = poll_whatever_happens(connection, 0.0)  # journals it
    error = error or failure
    if on_end is not None:
        on_end(ending)
    if confirm_off and run.commanding and ending.off:
        ending = watch_off(connection, guard, service.state, ending, stop=stop, on_alarm=on_alarm)
        now = connection.clock.now()
        connection.note(Event("", now, f"after-stop-{ending.verdict or 'unseen'}", ending.seen))
        _, failure = poll_whatever_happens(connection, 0.0)
        error = error or ending.failure or failure
        if on_end is not None:
            on_end(ending)
    if run.commanding:
        _raise(error, ending)
    elif error is not None:
        raise error
    return "completed" if status == "completed" else "stopped"


def counts_of(rig: Rig, duty: Sequence[float] | np.ndarray) -> tuple[int, ...]:
    """Converts duty cycles (-1 to 1, positive heats) to the counts of the driver."""
    driver = rig.driver
    return tuple(round(float(part) * driver.counts) * driver.polarity for part in duty)


def _raise(error: BaseException | None, ending: Ending) -> None:
    """Raises what ended a run, with the state of the cells, unless it ended as the user wanted."""
    if ending.heated or ending.verdict == STILL_HEATS:
        why = f"{error}; {ending}" if error is not None else str(ending)
        raise SafetyStop(why, STILL_HEATS if ending.verdict == STILL_HEATS else STILL_ON) from error
    if isinstance(error, SafetyStop):
        raise SafetyStop(f"{error}; {ending}", error.kind) from None
    if error is not None:
        raise error
    if ending.stopped or not ending.off:
        raise SafetyStop(str(ending), "unconfirmed")


@final
class _Run:
    """The state of a run while it commands the rig."""

    def __init__(self, connection: RigConnection, service: Service, guard: Guard):
        self.commanding = False
        """Whether a command has been sent."""
        self._connection, self._rig, self._service, self._guard = (
            connection,
            connection.rig,
            service,
            guard,
        )

    def follow(self, record: Record, state: RigState) -> None:
        """Takes a record of the end, which no interlock judges any more."""
        self._service.state = state
        self._guard.follow(record, state)

    def go(
        self,
        duty: DutySource,
        reset: bool,
        stop: threading.Event | None,
        on_progress: Callable[[float, tuple[int, ...]], None] | None,
    ) -> Literal["completed", "stopped"]:
        connection, guard, service = self._connection, self._guard, self._service
        wait_until_ready(service, connection, guard, reset, stop)
        rate = service.state.rate
        begin = connection.clock.now()
        commanded = -1
        while True:
            service.turn(0.02)
            if guard.finding is not None:
                raise SafetyStop(f"stopped: {guard.finding.detail}", guard.finding.kind)
            passed = connection.clock.now() - begin
            if stop is not None and stop.is_set():
                if isinstance(stop, StopRequest) and stop.signal:
                    raise SafetyStop(f"stopped: {stop.signal} ended the program", "signal")
                return "stopped"
            # Commands are counted from the begin, so that a late one does not delay the next ones.
            number = passed // round(INTERVAL * 1e9)
            if number == commanded:
                continue
            commanded, elapsed = number, seconds(passed)
            asked = duty(self._moment(elapsed * rate, rate))
            if asked is None:
                return "completed"
            pwm = counts_of(self._rig, _checked(asked, self._rig.lowest_duty))
            self.commanding = True
            if not connection.send_duty(pwm):
                raise SafetyStop("stopped: a command could not be sent", "link-down")
            if on_progress is not None:
                on_progress(elapsed * rate, pwm)

    def _moment(self, time: float, rate: float) -> Moment:
        state = self._service.state
        pwm = state.sample.pwm if state.sample is not None else (0,) * len(self._rig.driven)
        waited = np.where(state.measured > 0, self._connection.clock.now() - state.measured, np.inf)
        duty = self._rig.driver.duty(pwm)
        return Moment(time, state.temperatures, waited * 1e-9 * rate, duty, state.ambient)


def _checked(duty: Sequence[float] | np.ndarray, lowest: Sequence[float]) -> np.ndarray:
    """Returns a duty that may be sent. Values such as NaN or 3 must not reach a driver, nor a
    negative one a heater."""
    values = np.asarray(duty, np.float64)
    if values.shape != (len(lowest),) or not np.all((values >= lowest) & (values <= 1)):
        kinds = [f"{low:g} to 1" for low in dict.fromkeys(lowest)]
        heats = ", which is 0 to 1 for heaters" if len(kinds) > 1 else ""
        raise JaxtwinError(
            f"duty: expected {len(lowest)} numbers from {kinds[0]}{heats}, got {duty}"
        )
    return values


# Drives a rig by a plan.


def drive(
    connection: RigConnection,
    guard: Guard,
    plan: Experiment,
    *,
    accept: bool = False,
    reset: bool = False,
    about: Mapping[str, Any] | None = None,
    stop: threading.Event | None = None,
    consumers: Sequence[RecordConsumer] = (),
    on_progress: Callable[[float, tuple[int, ...]], None] | None = None,
    on_alarm: Callable[[Finding], None] | None = None,
    on_end: Callable[[Ending], None] | None = None,
) -> Literal["completed", "stopped"]:
    """Applies a plan's duty to a live rig. It ends as `operate` does: with the cells off.

    **Arguments:**

    - `connection`: the links of the rig, started.
    - `guard`: the guard of this run, such as `Guard.of(twin)`; its twin may have the
      parameters of a fit.
    - `plan`: the experiment whose duty is applied, in the time of the rig: a recording, or a
      schedule (`Experiment.schedule`).
    - `accept`: whether the plan is driven although the twin says that the rig would exceed its
      limit, until an interlock stops it.
    - `reset`, `about`, `stop`, `consumers`, `on_progress`, `on_alarm`, `on_end`: as in `operate`.

    **Returns:** `"completed"`, or `"stopped"` if `stop` ended it.

    **Raises:** `SafetyStop` if an interlock trips, or the rig does not become ready;
    `JaxtwinError` if the plan is for another number of cells and heaters, a heater is to cool, it
    states an input that the rig does not have, or the rig would exceed its limit.
    """
    label = f"{connection.rig.name}: the plan {plan.name}".rstrip()
    check_duty_of_rig(plan, connection.rig, label, JaxtwinError)
    if not accept:
        guard.check_plan(plan)
    return operate(
        connection,
        guard,
        follow(plan),
        reset=reset,
        about=about,
        stop=stop,
        consumers=consumers,
        on_progress=on_progress,
        on_alarm=on_alarm,
        on_end=on_end,
    )


def follow(plan: Experiment) -> DutySource:
    """Makes a source of the duty of a plan at each time, until its end."""

    def duty(moment: Moment) -> np.ndarray | None:
        if moment.time >= plan.duration:
            return None
        held = np.searchsorted(plan.time, plan.time[0] + moment.time, side="right") - 1
        return plan.duty[held]

    return duty
