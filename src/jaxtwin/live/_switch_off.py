"""Switches the cells off at the end of a run, and goes on until the controller reports it.

A run that ends as its user wants sends duty 0 and releases the device. Every other end sends `stop`
until the device reports its trip: a command that is sent into a lost link is lost. The report is
then compared with the readings: only they show that the rig cools.
"""

import logging
import threading
from collections.abc import Callable
from typing import NamedTuple, final

from .protocol._clock import seconds
from .protocol._records import Record, Sample
from .protocol._rig_connection import RigConnection
from .protocol._rig_state import RigState
from .safety._guard import Guard
from .safety._interlock import Finding
from .safety._off_watch import OffWatch, Verdict, heat_sentence

# The time between two commands to switch off, s.
AGAIN = 0.1

# The time after the first command for which a report of heat says nothing, s.
OBEYS_SECONDS = 1.0

# The time after which it is an alarm that the controller does not report what was commanded, s.
OFF_SECONDS = 2.0

# The time for which a stop is sent to a controller that reports nothing, s: more than the longest
# watchdog, and twice the longest pause before a link is opened again.
REACH_SECONDS = 15.0

# The kind of a stop after which the device reported that the cells are on.
STILL_ON = "still-on"

# The kind of a stop after which the rig goes on to heat, or heats again, whatever the device
# reports.
STILL_HEATS = "heats"

log = logging.getLogger("jaxtwin.live")


class Ending(NamedTuple):
    """The state of the cells when the commands to switch them off ended.

    - `sample`: the controller's last sample since the first of these commands; `None` if nothing
      was heard. Of several devices that were driven, it is that of one that does not report off.
    - `relay`: the state of the supply, `on` or `off`, as the device that has the relay reports it;
      `""` if no relay was heard.
    - `heated`: whether it reported other counts than 0 for longer than `OFF_SECONDS`.
    - `stopped`: whether `stop` was sent.
    - `failure`: the error of the journal, if it failed meanwhile, or an interrupt that came before
      there was an alarm.
    - `verdict`: what the readings show afterwards (`OffWatch`): `off`, `heats` or `unknown`; `""`
      before they were watched.
    - `seen`: what they show, as the end of a sentence.
    """

    sample: Sample | None
    relay: str
    heated: bool
    stopped: bool
    failure: BaseException | None
    verdict: Verdict = ""
    seen: str = ""

    @property
    def off(self) -> bool:
        """Whether the controller reports that the cells are off, or the relay that it is open."""
        if self.relay == "off":
            return True
        return self.sample is not None and not any(self.sample.pwm)

    @property
    def is_on(self) -> bool:
        """Whether the controller reports heat, and no relay that it is open."""
        return self.sample is not None and not self.off

    @property
    def tripped(self) -> bool:
        """Whether the controller reports a trip."""
        return self.sample is not None and bool(self.sample.trip)

    def __str__(self) -> str:
        if self.sample is None and not self.off:
            return (
                "the controller does not report that the cells are off: nothing was heard from it "
                "after the stop. Its watchdog should have switched them off; look, and cut the "
                "power if you cannot be sure"
            )
        if self.sample is not None and not self.off:
            counts = ", ".join(map(str, self.sample.pwm))
            return f"THE DEVICE REPORTS STILL ON ({counts} counts) AFTER A STOP: CUT THE POWER"
        if self.verdict == "heats":
            return heat_sentence(self.seen)
        # What a device reports is not what its bridge does: a relay may be welded.
        off = "the cells are off" if self.verdict == "off" else "the device reports off"
        if self.heated:
            off = f"the device reported heat {OFF_SECONDS:g} s after a stop; {off} now"
        if self.sample is None or any(self.sample.pwm):
            off = f"{off} by the relay alone: look for the fault of the controller"
        elif self.stopped and self.relay == "on":
            off = f"{off}, but the relay does not open"
        if self.tripped:
            off = f"{off}, and the device has tripped"
        elif self.stopped:
            off = f"{off}, but the device reports no trip: it obeys the next command"
        return f"{off} ({self.seen})" if self.seen else off


def switch_off(
    connection: RigConnection,
    *,
    trip: bool = False,
    insist: bool = True,
    state: RigState | None = None,
    stop: threading.Event | None = None,
    on_record: Callable[[Record, RigState], None] | None = None,
    on_alarm: Callable[[Finding], None] | None = None,
) -> Ending:
    """Switches the cells off and waits until the controller reports it.

    The first command is sent before any step that could fail, such as writing the journal. If the
    controller does not report that the cells are off within `OFF_SECONDS`, `stop` is sent in place
    of duty 0, which would keep a watchdog waiting. While the controller reports heat, this goes on
    without an end but an interrupt; if nothing is heard, for `REACH_SECONDS`.

    **Arguments:**

    - `connection`: the links of the rig, started.
    - `trip`: whether the device must trip.
    - `insist`: whether to go on after `OFF_SECONDS`; `False` for a device that another host may
      command.
    - `state`: what is known of the rig, by which a report that was made before the stop, and has
      waited on the way, says nothing of what follows it; None: nothing is known.
    - `stop`: an event that ends it when it is set after `OFF_SECONDS`, at which it is cleared.
    - `on_record`: called with each record, and what is known of the rig after it.
    - `on_alarm`: called if the cells may still be on after `OFF_SECONDS`.

    **Returns:** what the controller reported last.
    """
    switch = _Switch(connection, trip, state or RigState(), on_record, on_alarm)
    while not switch.step():
        if switch.elapsed < OFF_SECONDS:
            continue
        if not insist:
            break
        if not switch.insisting and stop is not None:
            stop.clear()
        switch.insist()
        if switch.interrupted or (stop is not None and stop.is_set()) or switch.is_hopeless():
            break
    return switch.ending


def watch_off(
    connection: RigConnection,
    guard: Guard,
    state: RigState,
    ending: Ending,
    *,
    stop: threading.Event | None = None,
    on_alarm: Callable[[Finding], None] | None = None,
) -> Ending:
    """Watches the readings of a rig that reports off, until they show whether it is.

    If the rig heats, there is an alarm, and `stop` and the command that opens the relay are sent
    until the readings show that it cools, for `WATCHED_SECONDS` at most.

    **Arguments:**

    - `guard`: the guard of the run, whose twins know how the rig would cool.
    - `state`: what is known of the rig.
    - `ending`: what the device reported.
    - `stop`: an event that ends the watch when it is set anew.

    **Returns:** the ending with what the readings show.
    """
    watch = guard.off_watch(connection.clock.now())
    if watch is None:
        return ending
    was_set = stop is not None and stop.is_set()
    if stop is not None:
        stop.clear()  # it ended the run; another one ends the watch
    try:
        state, ending = _watched(connection, watch, state, ending, stop, stops=False)
        if ending.verdict != STILL_HEATS:
            return ending
        log.error("%s", ending)
        _ring(on_alarm, Finding(STILL_HEATS, str(ending), severity="critical"))
        watch.again(connection.clock.now())
        _, later = _watched(connection, watch, state, ending, stop, stops=True)
    finally:
        if stop is not None and was_set:
            stop.set()
    cools = "; it cools now" if later.verdict == "off" else ""
    return ending._replace(seen=f"{ending.seen}{cools}", failure=later.failure)


def _watched(
    connection: RigConnection,
    watch: OffWatch,
    state: RigState,
    ending: Ending,
    stop: threading.Event | None,
    *,
    stops: bool,
) -> tuple[RigState, Ending]:
    """Watches until there is a verdict or a user ends it. `stops`: whether `stop` is sent
    meanwhile."""
    failure, sent = ending.failure, 0
    try:
        while not watch.verdict and not (stop is not None and stop.is_set()):
            if stops and seconds(connection.clock.now() - sent) >= AGAIN:
                sent = connection.clock.now()
                connection.send_order("stop")
            records, failed = poll_whatever_happens(connection, 0.05)
            failure = failure or failed
            for record in records:
                state = state.after(record)
                watch.on_record(record, state)
            watch.on_time(state, connection.clock.now())
    except KeyboardInterrupt as interrupt:
        failure = failure or interrupt
    return state, ending._replace(verdict=watch.verdict, seen=watch.detail, failure=failure)


def _ring(on_alarm: Callable[[Finding], None] | None, finding: Finding) -> None:
    """Raises an alarm; one that fails must not end what switches the cells off."""
    if on_alarm is None:
        return
    try:
        on_alarm(finding)
    except Exception:
        log.exception("the alarm failed")


def poll_whatever_happens(
    connection: RigConnection, timeout: float
) -> tuple[list[Record], Exception | None]:
    """Polls a connection. A journal that fails, as on a full disk, must not keep the cells on: it
    goes on without it.

    **Returns:** the records, and the error of the journal.
    """
    try:
        return connection.poll(timeout), None
    except Exception as error:
        log.error("the recording has ended: %s", error)
        connection.record_into(None)
        return [], error


@final
class _Switch:
    """The commands to switch off, and the answers of the controller."""

    def __init__(
        self,
        connection: RigConnection,
        trip: bool,
        state: RigState,
        on_record: Callable[[Record, RigState], None] | None,
        on_alarm: Callable[[Finding], None] | None,
    ):
        self.insisting = self.interrupted = False
        self._connection, self._trip, self._on_alarm = connection, trip, on_alarm
        self._off = (0,) * len(connection.rig.driven)
        self._begin = connection.clock.now()
        self._sent = -AGAIN
        self._alarms: set[str] = set()
        self._driven, self._state, self._on_record = connection.driven, state, on_record
        self._samples: dict[str, Sample] = {}  # the newest of each device that drives cells
        self.ending = Ending(None, "", False, trip, None)

    @property
    def elapsed(self) -> float:
        return seconds(self._connection.clock.now() - self._begin)

    def step(self) -> bool:
        """Sends what is due and reads what has arrived. Returns whether the controller reports what
        was commanded."""
        try:
            self._send()
            records, failure = poll_whatever_happens(self._connection, 0.05)
        except KeyboardInterrupt as interrupt:  # an early one does not keep the cells on
            self.interrupted = self.insisting
            self.ending = self.ending._replace(failure=interrupt)
            return False
        relay = self.ending.relay
        for record in records:
            self._state = self._state.after(record)
            if self._on_record is not None:
                self._on_record(record, self._state)
            if not isinstance(record, Sample) or self._state.made(record) <= self._begin:
                continue
            # A stop takes a moment to arrive and to be reported.
            made_after = seconds(self._state.made(record) - self._begin)
            if record.pwm and (made_after > OBEYS_SECONDS or not any(record.pwm)):
                self._samples[record.link] = record
            relay = record.relay or relay
        failure = self.ending.failure or failure
        ending = Ending(self._sample(), relay, self.ending.heated, self._trip, failure)
        heats = self.elapsed > OFF_SECONDS and ending.is_on
        self.ending = ending._replace(heated=ending.heated or heats)
        return ending.off and (not self._trip or (ending.tripped and self._is_open(ending)))

    def insist(self) -> None:
        """Goes on with `stop`, and raises an alarm, once for each reason, if the cells may be
        on."""
        self.insisting = self._trip = True
        if self.ending.off:
            return
        self.ending = self.ending._replace(heated=self.ending.heated or self.ending.is_on)
        kind = "unconfirmed" if self.ending.sample is None else STILL_ON
        if kind in self._alarms:
            return
        self._alarms.add(kind)
        log.error("%s", self.ending)
        _ring(self._on_alarm, Finding(kind, str(self.ending), severity="critical"))

    def is_hopeless(self) -> bool:
        """Whether the controller has not answered for so long that it will not."""
        return not self.ending.is_on and self.elapsed > REACH_SECONDS

    def _sample(self) -> Sample | None:
        """The sample by which to judge: every device that got a duty must report off, also one
        whose link is lost."""
        heard = self._samples
        if on := [sample for sample in heard.values() if any(sample.pwm)]:
            return on[0]
        if self._driven - heard.keys():
            return None
        untripped = [sample for sample in heard.values() if not sample.trip]
        return next(iter([*untripped, *heard.values()]), None)

    def _is_open(self, ending: Ending) -> bool:
        return ending.relay == "off" or not self._connection.relay

    def _send(self) -> None:
        elapsed = self.elapsed
        if elapsed - self._sent < AGAIN:
            return
        self._sent = elapsed
        if self._trip:
            self._connection.send_order("stop")
        if elapsed < OFF_SECONDS:  # a device that keeps its counts must not count them as commands
            self._connection.send_duty(self._off)
