"""Conditions for the first command: live links, plausible temperatures, a device that obeys."""

import threading
from typing import NamedTuple

from .._errors import SafetyStop
from ._bench import Bench
from ._interlocks import Guard
from ._records import Greeting, LinkState, Reading, Record, Sample
from ._time import seconds

PATIENCE = 30.0
"""The longest time until a rig is ready, s."""

REFUSED = 3.0
"""The longest time for which a device may be refused, s. It is asked for its greeting each second,
and the first may be that of an earlier start, which a broker has kept."""

FRESH = 1.5
"""Largest age of the newest sample and reading at the first command, s. Older ones, which waited
while this process was busy compiling, for example, do not show the present state of the rig."""

RESET_AGAIN = 0.5
"""The time between two resets, s, while the device reports a trip."""


class Ready(NamedTuple):
    """A rig that can be commanded.

    - `rate`: the ratio of the controller's time to the host's.
    - `boots`: the present start of each device, by link.
    - `records`: the last sample and the last reading.
    """

    rate: float
    boots: dict[str, str]
    records: list[Record]


def wait_until_ready(
    bench: Bench, guard: Guard, reset: bool, stop: threading.Event | None
) -> Ready:
    """Waits for all links, temperatures and a controller.

    **Arguments:**

    - `bench`: the links of the rig, started.
    - `guard`: the interlocks, which check the readings meanwhile.
    - `reset`: whether a trip of the device is ended.
    - `stop`: an event that ends the waiting when it is set.

    **Raises:** `SafetyStop` if the rig does not become ready, or must not be driven.
    """
    begin = bench.clock.now()
    rate, boots = 1.0, dict[str, str]()
    sample: Sample | None = None
    reading: Reading | None = None
    asked = -RESET_AGAIN
    relay: Sample | None = None
    known: list[Record] = [*bench.greetings]  # of an earlier run on this bench
    while True:
        records = [*known, *bench.poll(0.05)]
        known = []
        elapsed = seconds(bench.clock.now() - begin)
        trip = guard.wait(records)
        if trip is not None:
            raise SafetyStop(f"not started: {trip.detail}", trip.kind)
        for record in records:
            if isinstance(record, Sample) and record.relay:
                relay = record
            match record:
                case Greeting():
                    boots[record.link] = record.hello.boot
                    if record.hello.cells:
                        rate, sample = record.hello.rate, None
                case Sample() if record.pwm:
                    sample = record
                case Reading() if not record.recalibrating:
                    reading = record
        live = set(bench.states.values()) == {LinkState.LIVE}
        live = live and (not bench.relay or _is_fresh(relay, bench))
        if live and _is_fresh(sample, bench) and _is_fresh(reading, bench):
            assert sample is not None
            assert reading is not None
            tripped = sample.trip or (relay is not None and relay.relay == "off" and "relay")
            if not tripped and sample.owner in ("", bench.owner):
                trip = guard.ready()
                if trip is not None:
                    raise SafetyStop(f"not started: {trip.detail}", trip.kind)
                return Ready(rate, boots, [sample, reading])
            if sample.owner not in ("", bench.owner):
                raise SafetyStop(
                    f"not started: another host, {sample.owner}, commands the cells", "commander"
                )
            if not reset:
                raise SafetyStop(
                    f"not started: the device on {sample.link} has switched off by itself "
                    f"({tripped}); look why, then start with a reset (--reset)",
                    "device-trip",
                )
            if elapsed - asked >= RESET_AGAIN:
                asked = elapsed
                bench.send_order("reset")
        if stop is not None and stop.is_set():
            raise SafetyStop("not started: stopped before the rig was there", "stopped")
        patience = REFUSED if bench.refusals else PATIENCE
        if elapsed > patience:
            raise SafetyStop(
                f"not started: after {patience:g} s: {_missing(bench, sample, reading, relay)}"
            )


def _is_fresh(record: Sample | Reading | None, bench: Bench) -> bool:
    return record is not None and seconds(bench.clock.now() - record.arrival) <= FRESH


def _missing(
    bench: Bench, sample: Sample | None, reading: Reading | None, relay: Sample | None
) -> str:
    """Describes what is missing from a rig that did not become ready."""
    words = [", ".join(f"{name} {state}" for name, state in bench.states.items())]
    words += [f"{name}: {why}" for name, why in bench.refusals.items()]
    words += [] if reading is not None else ["no temperatures"]
    words += [] if sample is not None else ["nobody who drives cells"]
    words += [f"no relay {bench.relay!r}"] if bench.relay and relay is None else []
    words += [f"tripped: {sample.trip}"] if sample is not None and sample.trip else []
    return "; ".join(words)
