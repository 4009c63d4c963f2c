"""Diagnoses a rig that has changed, from the last minutes of its records, in a process of its
own.

In a thread of this process a diagnosis would keep the loop around the rig waiting for many seconds,
while its functions are traced: longer than the watchdog of a device waits.
"""

import contextlib
import multiprocessing
import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, NamedTuple, final

import numpy as np

from .._errors import JaxtwinError
from ..diagnosis import diagnose
from ..io import Experiment
from ..live import Finding, Reading, Record, RigState
from ..live.protocol._clock import seconds
from ..monitoring._finding_log import KINDS
from ..observers import ProcessNoise
from ..physics import Twin
from ._child_process import end_with_parent

SPACING = 1.0
"""The time between two samples that are kept, s of the rig."""

KEPT = 1500
"""The number of samples that are kept."""

DELAYS = (60.0, 300.0)
"""The times after a finding at which is diagnosed, s of the rig: later, more is known."""

LEAST = 180
"""The smallest number of samples of a diagnosis: an observer needs two minutes to find the rig."""

NICE = 10
"""The niceness of the process: the loop around the rig goes first."""


class _Row(NamedTuple):
    """A sample: time, s of the rig; temperatures and ambient temperature, degC; duty."""

    time: float
    duty: np.ndarray
    temperatures: np.ndarray
    ambient: float


class _Found(NamedTuple):
    """The causes as `Diagnosis.to_dict` gives them, and why there are none."""

    causes: list[dict[str, Any]]
    problem: str


@final
class LiveDiagnosis:
    """Says which fault explains what a monitor has found. It consumes the records of a source.

    **Arguments:**

    - `twin`: the twin.
    - `show`: called, in the thread of the loop, with what a page shows of a diagnosis.
    - `noise`: the levels of the noise, as for `jaxtwin.diagnose`.
    """

    def __init__(
        self,
        twin: Twin,
        show: Callable[[dict[str, Any]], object],
        noise: ProcessNoise | None = None,
    ):
        self._twin, self._show, self._noise = twin, show, noise
        self._rows: deque[_Row] = deque(maxlen=KEPT)
        self._due: list[float] = []
        self._waiter = ThreadPoolExecutor(1, thread_name_prefix="diagnosis")
        self._running: Future[_Found] | None = None
        self._process: SpawnProcess | None = None
        self._moments: tuple[int, float] = (0, 0.0)  # host time, ns, and that of the rig, s
        self._origin = 0.0  # s since 1970 at the beginning of the rig's time
        self._rate = 1.0

    def use(self, twin: Twin, noise: ProcessNoise | None) -> None:
        """Diagnoses with another twin from now on."""
        self._twin, self._noise = twin, noise
        self._due = []

    def on_finding(self, finding: Finding) -> None:
        """Plans diagnoses after an alarm of the monitor."""
        if finding.is_alarm and finding.kind in KINDS.values() and not self._due:
            now = self._rows[-1].time if self._rows else 0.0
            self._due = [now + delay for delay in DELAYS]

    def on_record(self, record: Record, state: RigState) -> None:
        """Keeps readings, one in each second of the rig."""
        if not isinstance(record, Reading) or record.recalibrating or state.sample is None:
            return
        at = state.time_of(record)
        before, elapsed = self._moments
        if not before:
            self._origin = seconds(at)
        elapsed += max(seconds(at - before), 0.0) * state.rate if before else 0.0
        self._moments, self._rate = (max(at, before), elapsed), state.rate
        if self._rows and elapsed - self._rows[-1].time < SPACING:
            return
        duty = np.asarray(self._twin.rig.driver.duty(state.sample.pwm), float)
        ambient = np.nan if state.ambient is None else state.ambient
        self._rows.append(_Row(elapsed, duty, record.temperatures, ambient))

    def on_time(self, state: RigState, now: int) -> None:
        """Begins a diagnosis that is due, and shows one that is ready."""
        if self._running is not None:
            if self._running.done():
                self._finish(self._running.result())
                self._running = None
        elif self._due and self._rows and self._rows[-1].time >= self._due[0]:
            del self._due[0]
            if len(self._rows) >= LEAST:
                self._show({"state": "running", "causes": []})
                # Starting a process waits for it, which the loop must not.
                self._running = self._waiter.submit(self._in_process, self._recorded())

    def close(self) -> None:
        """Ends a diagnosis that runs."""
        if self._process is not None:
            self._process.terminate()
        self._waiter.shutdown(wait=True, cancel_futures=True)

    def _in_process(self, recorded: Experiment) -> "_Found":
        context = multiprocessing.get_context("spawn")
        answer, theirs = context.Pipe(duplex=False)
        arguments = (theirs, self._twin, recorded, self._noise)
        self._process = process = context.Process(target=_diagnose, args=arguments, daemon=True)
        process.start()
        theirs.close()
        try:
            return answer.recv()
        except EOFError:
            return _Found([], "its process has ended")
        finally:
            process.join()
            answer.close()
            self._process = None

    def _finish(self, found: "_Found") -> None:
        if found.problem:
            self._show({"state": "failed", "text": found.problem, "causes": []})
            return
        for cause in found.causes:
            for one in cause["explanations"]:
                one["onset"] = self._origin + one["onset_s"] / self._rate
        self._show({"state": "done", "causes": found.causes})

    def _recorded(self) -> Experiment:
        rows = list(self._rows)
        ambient = np.array([row.ambient for row in rows])
        return Experiment(
            [row.time for row in rows],
            [row.duty for row in rows],
            channels=self._twin.channels,
            temperatures=[row.temperatures for row in rows],
            ambient=ambient if np.isfinite(ambient).any() else None,
            name="live",
        )


def _diagnose(
    answer: Connection, twin: Twin, recorded: Experiment, noise: ProcessNoise | None
) -> None:
    """Diagnoses, and sends causes and problem."""
    end_with_parent()
    with contextlib.suppress(AttributeError, OSError):  # Windows has no niceness
        os.nice(NICE)
    try:
        found = diagnose(twin, recorded, None, noise)
    except JaxtwinError as error:
        answer.send(_Found([], str(error)))
    else:
        answer.send(_Found(found.to_dict()["causes"], ""))
