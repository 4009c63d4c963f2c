"""Conditions for the first command: live links, plausible temperatures, a device that obeys."""

import threading

from ..errors import SafetyStop
from ._service import Service
from .protocol._clock import seconds
from .protocol._records import LinkState, Reading, Sample
from .protocol._rig_connection import RigConnection
from .protocol._rig_state import RigState
from .safety._guard import Guard

# The longest time until a rig is ready, s.
MAX_START = 30.0

# The longest time for which a device may be refused, s. It is asked for its greeting each second,
# and the first may be that of an earlier start, which a broker has kept.
MAX_REFUSAL_SECONDS = 3.0

# Largest age of the newest sample and reading at the first command, s. Older ones, which waited
# while this process was busy compiling, for example, do not show the present state of the rig.
FRESH = 1.5

# The time between two resets, s, while the device reports a trip.
RESET_AGAIN = 0.5


def wait_until_ready(
    service: Service,
    connection: RigConnection,
    guard: Guard,
    reset: bool,
    stop: threading.Event | None,
) -> None:
    """Waits for all links, temperatures and a controller.

    **Arguments:**

    - `service`: the loop around the connection; the guard is among its consumers.
    - `connection`: the links of the rig, started.
    - `guard`: the interlocks, which check the readings meanwhile.
    - `reset`: whether a trip of the device is ended.
    - `stop`: an event that ends the waiting when it is set.

    **Raises:** `SafetyStop` if the rig does not become ready, or must not be driven.
    """
    begin = connection.clock.now()
    asked = -RESET_AGAIN
    service.take(connection.greetings)  # of an earlier run on this connection
    while True:
        service.turn(0.05)
        elapsed = seconds(connection.clock.now() - begin)
        _raise_finding(guard)
        state = service.state
        live = set(connection.states.values()) == {LinkState.LIVE}
        needed = [state.sample, state.reading, *([state.relay] if connection.relay else [])]
        if live and all(_is_fresh(record, state, connection) for record in needed):
            assert state.sample is not None
            owner = state.sample.owner
            if not state.trip and owner in ("", connection.owner):
                guard.before_start(state, connection.clock.now())
                _raise_finding(guard)
                return
            if owner not in ("", connection.owner):
                raise SafetyStop(
                    f"not started: another host, {owner}, commands the cells", "commander"
                )
            if not reset:
                raise SafetyStop(
                    f"not started: the device on {state.sample.link} has switched off by itself "
                    f"({state.trip}); look why, then start with a reset (--reset)",
                    "device-trip",
                )
            if elapsed - asked >= RESET_AGAIN:
                asked = elapsed
                connection.send_order("reset")
        if stop is not None and stop.is_set():
            raise SafetyStop("not started: stopped before the rig was there", "stopped")
        longest = MAX_REFUSAL_SECONDS if connection.refusals else MAX_START
        if elapsed > longest:
            raise SafetyStop(f"not started: after {longest:g} s: {_missing(connection, state)}")


def _raise_finding(guard: Guard) -> None:
    if guard.finding is not None:
        raise SafetyStop(f"not started: {guard.finding.detail}", guard.finding.kind)


def _is_fresh(record: Sample | Reading | None, state: RigState, connection: RigConnection) -> bool:
    return record is not None and state.age(record, connection.clock.now()) <= FRESH


def _missing(connection: RigConnection, state: RigState) -> str:
    """Describes what is missing from a rig that did not become ready."""
    words = [", ".join(f"{name} {link}" for name, link in connection.states.items())]
    words += [f"{name}: {why}" for name, why in connection.refusals.items()]
    needed = {"temperatures": state.reading, "sample of the controller": state.sample}
    needed |= {f"relay {connection.relay!r}": state.relay} if connection.relay else {}
    for what, record in needed.items():
        if record is None:
            words.append(f"no {what}")
        elif not _is_fresh(record, state, connection):
            age = state.age(record, connection.clock.now())
            words.append(f"the newest {what} is {age:.1f} s old by the device's clock")
    words += [f"tripped: {state.trip}"] if state.trip else []
    return "; ".join(words)
