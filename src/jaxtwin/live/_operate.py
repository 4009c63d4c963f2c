"""Commands a rig behind its interlocks, by a plan or a controller."""

import contextlib
import logging
import secrets
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, Literal, NamedTuple, final

import numpy as np
from jaxtyping import Float

from .._arguments import true_or_false
from .._errors import JaxtwinError, SafetyStop
from ..physics import Twin
from ..rig import Rig
from ._bench import Bench
from ._interlocks import Guard
from ._readiness import wait_until_ready
from ._records import Document, Reading, Record, Sample
from ._time import seconds

INTERVAL = 0.25
"""The interval between two commands, s; each also resets the watchdog of the device."""

OFF_SECONDS = 2.0
"""Longest time for which a stop waits until the controller reports that the cells are off, s."""

_UNCONFIRMED = (
    "the controller does not report that the cells are off; its watchdog switches them off when "
    "commands cease"
)

log = logging.getLogger("jaxtwin.live")


class Moment(NamedTuple):
    """The state of the rig that a controller gets when it is asked for the duty.

    - `time`: the time since the start of the run, s of the rig.
    - `temperatures`: the last valid temperatures, degC `(channels,)`.
    - `duty`: the duty of the cells now, as the device reports it, -1 to 1, positive heats
      `(cells,)`.
    - `ambient`: the ambient temperature, degC; `None` if it is not measured.
    """

    time: float
    temperatures: Float[np.ndarray, " channels"]
    duty: Float[np.ndarray, " cells"]
    ambient: float | None


DutySource = Callable[[Moment], Sequence[float] | np.ndarray | None]
"""The duty of each cell now, -1 to 1, positive heats; `None` ends the run."""


def operate(
    bench: Bench,
    twin: Twin,
    duty: DutySource,
    *,
    silence: float | int = 3.0,
    ambient: float | int | None = None,
    reset: bool = False,
    about: Mapping[str, Any] | None = None,
    stop: threading.Event | None = None,
    on_progress: Callable[[float, tuple[int, ...]], None] | None = None,
) -> Literal["completed", "stopped"]:
    """Commands a live rig. The cells are off when it returns, also after an error.

    **Arguments:**

    - `bench`: the links of the rig, started.
    - `twin`: the twin of the rig, whose file must state `limits.temperature`.
    - `duty`: the source of the duty, which is called every quarter of a second.
    - `silence`: the longest time without data, s.
    - `ambient`: the ambient temperature of a rig that does not measure it, degC. None: unknown;
      the rig is then only started near the temperature of the rig file.
    - `reset`: whether a trip of the device is ended first, on purpose.
    - `about`: details that are recorded at the start of the run, such as a plan or a command line.
    - `stop`: an event that ends the run early when it is set.
    - `on_progress`: called with the time (s of the rig) and the counts after each command.

    **Returns:** `"completed"` if `duty` ended the run, `"stopped"` if `stop` did.

    **Raises:** `SafetyStop` if an interlock trips, or the rig does not become ready; `JaxtwinError`
    if the rig file states no limit, or for an invalid argument.
    """
    true_or_false("operate: reset", reset, JaxtwinError)
    guard = Guard(twin, bench.owner, silence=silence, ambient=ambient)
    run = _Run(bench, twin.rig, guard)
    uid = secrets.token_hex(8)
    content = {"rig": twin.rig.name, "owner": bench.owner, "limits": asdict(guard.limits)}
    content |= {} if ambient is None else {"ambient_degC": float(ambient)}
    bench.note(Document(bench.clock.now(), "start", uid, {**(about or {}), **content}))
    status, error, off = "completed", None, False
    try:
        status = run.go(duty, reset, stop, on_progress)
    except BaseException as raised:
        status, error = "stopped", raised
        if not isinstance(raised, KeyboardInterrupt):
            status = "tripped" if isinstance(raised, SafetyStop) else "failed"
    if status == "tripped" and run.commanding:
        bench.send_order("stop")  # the device refuses to go on until somebody resets it
    # This is done even before the first command: an earlier host may have left the cells on.
    off = switch_off(bench, len(twin.rig.cells))
    bench.send_order("release")
    kind = error.kind if isinstance(error, SafetyStop) else type(error).__name__ if error else ""
    end = {"status": status, "kind": kind, "reason": str(error or ""), "off": off}
    bench.note(Document(bench.clock.now(), "stop", uid, end))
    with contextlib.suppress(JaxtwinError):
        bench.poll(0.0)  # journals it
    return _outcome(status, error, off or not run.commanding, run.commanding)


def switch_off(bench: Bench, cells: int) -> bool:
    """Sends duty 0 until the controller reports it. Returns whether it did within `OFF_SECONDS`.

    The first command is sent before any step that could fail, such as writing the journal.
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
    """Converts duty cycles (-1 to 1, positive heats) to the counts of the driver."""
    driver = rig.driver
    return tuple(round(float(part) * driver.counts) * driver.polarity for part in duty)


def _outcome(
    status: str, error: BaseException | None, off: bool, commanding: bool
) -> Literal["completed", "stopped"]:
    """The end of a run as it is returned to the caller."""
    outcome = "the cells are off" if off else _UNCONFIRMED
    if isinstance(error, SafetyStop) and commanding:
        raise SafetyStop(f"{error}; {outcome}", error.kind) from None
    if error is not None:
        if not off:
            log.warning(outcome)
        raise error
    if not off:
        raise SafetyStop(_UNCONFIRMED, "unconfirmed")
    return "completed" if status == "completed" else "stopped"


@final
class _Run:
    """The state of a run while it commands the rig."""

    def __init__(self, bench: Bench, rig: Rig, guard: Guard):
        self.commanding = False
        """Whether a command has been sent."""
        self._bench, self._rig, self._guard = bench, rig, guard
        self._reading: Reading | None = None
        self._sample: Sample | None = None

    def go(
        self,
        duty: DutySource,
        reset: bool,
        stop: threading.Event | None,
        on_progress: Callable[[float, tuple[int, ...]], None] | None,
    ) -> Literal["completed", "stopped"]:
        bench, guard = self._bench, self._guard
        rate, boots, records = wait_until_ready(bench, guard, reset, stop)
        self._learn(records)
        begin = bench.clock.now()
        guard.begin(begin, boots)
        commanded = -1
        while True:
            records = bench.poll(0.02)
            self._learn(records)
            trip = guard.check(records, bench.clock.now())
            if trip is not None:
                raise SafetyStop(f"stopped: {trip.detail}", trip.kind)
            passed = bench.clock.now() - begin
            if stop is not None and stop.is_set():
                return "stopped"
            # Commands are counted from the begin, so that a late one does not delay the next ones.
            number = passed // round(INTERVAL * 1e9)
            if number == commanded:
                continue
            commanded, elapsed = number, seconds(passed)
            asked = duty(self._moment(elapsed * rate))
            if asked is None:
                return "completed"
            pwm = counts_of(self._rig, _checked(asked, len(self._rig.cells)))
            self.commanding = True
            if not bench.send_duty(pwm):
                raise SafetyStop("stopped: a command could not be sent", "link-down")
            guard.commanded(bench.clock.now(), bench.number, pwm)
            if on_progress is not None:
                on_progress(elapsed * rate, pwm)

    def _learn(self, records: Sequence[Record]) -> None:
        for record in records:
            if isinstance(record, Reading) and not record.recalibrating:
                self._reading = record
            elif isinstance(record, Sample) and record.pwm:
                self._sample = record

    def _moment(self, time: float) -> Moment:
        assert self._reading is not None, "a rig is ready once it has sent temperatures"
        sample = self._sample
        pwm = sample.pwm if sample is not None else (0,) * len(self._rig.cells)
        ambient = sample.ambient if sample is not None else None
        return Moment(time, self._reading.temperatures, self._rig.driver.duty(pwm), ambient)


def _checked(duty: Sequence[float] | np.ndarray, cells: int) -> np.ndarray:
    """Returns a duty that may be sent. Values such as NaN or 3 must not reach a driver."""
    values = np.asarray(duty, np.float64)
    if values.shape != (cells,) or not np.all(np.abs(values) <= 1):
        raise JaxtwinError(f"duty: expected {cells} numbers from -1 to 1, got {duty}")
    return values
