"""Driving a rig: duty commands with a guard that switches the cells off."""

import contextlib
import logging
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import final

import numpy as np

from .._errors import JaxtwinError, SafetyStop
from ..io import Experiment
from ..rig import Rig
from ._bench import Bench
from ._records import Event, Greeting, LinkChange, LinkState, Reading, Record, Sample
from ._time import seconds

INTERVAL = 0.25
"""Between two commands, s; each one also feeds the watchdog of the device."""

PATIENCE = 30.0
"""How long a rig may take to be there, s."""

OFF_SECONDS = 2.0
"""How long a stop waits for the controller to report that the cells are off, s."""

_UNCONFIRMED = (
    "the controller does not report that the cells are off; its watchdog switches them off when "
    "commands cease"
)

log = logging.getLogger("jaxtwin.live")


@final
class Guard:
    """Says when the cells must go off. Pure: fed with records and the time.

    **Arguments:**

    - `channels`: their names, for the reason.
    - `hottest`: limit of every channel, degC.
    - `silence`: longest time without a controller sample, or without temperatures, s.
    """

    def __init__(self, channels: Sequence[str], hottest: float | int, silence: float | int):
        self._channels = tuple(channels)
        self._hottest = hottest
        self._silence = silence
        self._boots: Mapping[str, str] = {}
        self._sample = self._reading = 0

    def check(self, records: Sequence[Record], now: int) -> str | None:
        """The reason to stop, or `None`.

        **Arguments:**

        - `records`: what came since the last call.
        - `now`: host time, ns.
        """
        for record in records:
            reason = self._reason(record)
            if reason is not None:
                return reason
        for what, last in (("controller sample", self._sample), ("temperature", self._reading)):
            silent = seconds(now - last)
            if silent > self._silence:
                return f"no {what} for {silent:.1f} s"
        return None

    def begin(self, now: int, boots: Mapping[str, str]) -> None:
        """Starts counting silence; `boots` are the devices' present starts by link."""
        self._sample = self._reading = now
        self._boots = boots

    def _reason(self, record: Record) -> str | None:
        match record:
            case Sample():
                self._sample = record.arrival
            case Reading():
                self._reading = record.arrival
                hottest = int(np.argmax(record.temperatures))
                value = float(record.temperatures[hottest])
                if not value <= self._hottest:
                    name = self._channels[hottest]
                    return f"{name} is at {value:.1f} degC; the rig's limit is {self._hottest:g}"
            case LinkChange(state=LinkState.DOWN):
                return f"link {record.link} is down: {record.detail}"
            case Greeting():
                if self._boots.get(record.link) != record.hello.boot:
                    return f"the device on {record.link} has restarted"
            case Event(kind="watchdog"):
                return "the device's own watchdog has switched the cells off"
        return None


def drive(
    bench: Bench,
    rig: Rig,
    plan: Experiment,
    *,
    silence: float | int = 3.0,
    stop: threading.Event | None = None,
    progress: Callable[[float, tuple[int, ...]], None] | None = None,
) -> None:
    """Runs a plan's duty on a live rig; the cells are off when it returns, however it returns.

    **Arguments:**

    - `bench`: its links, started.
    - `rig`: its file, which must state `limits.temperature`.
    - `plan`: its duty is applied, in the time of the rig: a recording's, or a schedule's
        (`Experiment.schedule`).
    - `silence`: longest time without data, s.
    - `stop`: ends it early when set.
    - `progress`: called with the time (s) and the counts after each command.

    **Raises:** `SafetyStop` when the rig's temperature limit is passed, data stop, or a link is
    lost, and where it does not come up; `JaxtwinError` where the rig states no limit or the plan is
    for another number of cells.
    """
    limit = rig.maximum_temperature
    if limit is None:
        raise JaxtwinError(
            f"{rig.source}: limits.temperature: is missing; a rig is driven with a limit such as "
            'temperature = "90 degC" only'
        )
    if plan.n_cells != len(rig.cells):
        raise JaxtwinError(f"a plan for {plan.n_cells} cells; {rig.name} has {len(rig.cells)}")
    commanded = -math.inf
    guard = Guard([channel.name for channel in rig.channels], limit - 273.15, silence)
    try:
        rate, boots = _wait_until_live(bench, guard, stop)
        begin = bench.clock.now()
        guard.begin(begin, boots)
        while True:
            reason = guard.check(bench.poll(0.02), bench.clock.now())
            if reason is not None:
                raise SafetyStop(f"stopped: {reason}")
            elapsed = seconds(bench.clock.now() - begin)
            if elapsed * rate >= plan.duration or (stop is not None and stop.is_set()):
                break
            if elapsed - commanded < INTERVAL:
                continue
            commanded = elapsed
            since = plan.time[0] + elapsed * rate
            held = np.searchsorted(plan.time, since, side="right") - 1
            pwm = counts_of(rig, plan.duty[held])
            if not bench.send_duty(pwm):
                raise SafetyStop("stopped: a command could not be sent")
            if progress is not None:
                progress(elapsed * rate, pwm)
    except BaseException as error:
        bench.note(Event("", bench.clock.now(), "drive-stop", f"{type(error).__name__}: {error}"))
        # Also where nothing was commanded yet: who drove it before may have left the cells on.
        outcome = "the cells are off" if switch_off(bench, len(rig.cells)) else _UNCONFIRMED
        if commanded < 0:
            raise
        if isinstance(error, SafetyStop):
            raise SafetyStop(f"{error}; {outcome}") from None
        log.warning(outcome)
        raise
    if not switch_off(bench, len(rig.cells)):
        raise SafetyStop(_UNCONFIRMED)


def switch_off(bench: Bench, cells: int) -> bool:
    """Sends duty 0 until the controller reports it; whether it did within `OFF_SECONDS`.

    The first command is sent before anything that could fail, such as the journal.
    """
    off = (0,) * cells
    begin = bench.clock.now()
    sent = -1.0
    while (elapsed := seconds(bench.clock.now() - begin)) < OFF_SECONDS:
        if elapsed - sent > 0.1:
            bench.send_duty(off)
            sent = elapsed
        with contextlib.suppress(JaxtwinError):  # a full disk must not keep the cells on
            for record in bench.poll(0.05):
                if isinstance(record, Sample) and record.arrival > begin and record.pwm == off:
                    return True
    return False


def counts_of(rig: Rig, duty: Sequence[float] | np.ndarray) -> tuple[int, ...]:
    """Duty cycles (-1 to 1, positive heats) as the counts that a driver takes."""
    driver = rig.driver
    return tuple(round(float(part) * driver.counts) * driver.polarity for part in duty)


def _wait_until_live(
    bench: Bench, guard: Guard, stop: threading.Event | None
) -> tuple[float, dict[str, str]]:
    """Waits for all links, temperatures and a controller.

    **Returns:** the controller's rate, and the present start of each device by link.
    """
    begin = bench.clock.now()
    rate, driven, measured = 1.0, False, False
    boots: dict[str, str] = {}
    while not (driven and measured and set(bench.states.values()) == {LinkState.LIVE}):
        records = bench.poll(0.05)
        for record in records:
            if isinstance(record, Greeting):
                boots[record.link] = record.hello.boot
                if record.hello.cells:
                    rate, driven = record.hello.rate, True
            measured = measured or isinstance(record, Reading)
        guard.begin(bench.clock.now(), boots)
        # Links may come and go until the first command.
        reason = guard.check([r for r in records if isinstance(r, Reading)], bench.clock.now())
        if reason is not None:
            raise SafetyStop(f"not started: {reason}")
        if stop is not None and stop.is_set():
            raise SafetyStop("not started: stopped before the rig was there")
        if seconds(bench.clock.now() - begin) > PATIENCE:
            states = ", ".join(f"{name} {state}" for name, state in bench.states.items())
            missing = "" if measured else "; no temperatures"
            missing += "" if driven else "; nobody who drives cells"
            raise SafetyStop(f"not started: after {PATIENCE:g} s: {states}{missing}")
    return rate, boots
