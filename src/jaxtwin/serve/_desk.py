"""What clients ask for, from the threads of the server to the loop around the rig."""

import contextlib
import queue
import threading
from concurrent.futures import Future
from dataclasses import dataclass
from typing import NamedTuple, final

from ..live import StopRequest


@final
@dataclass(frozen=True)
class DriveOrder:
    """Hold a duty for a time, behind all interlocks.

    - `duty`: the duty of each cell, -1 to 1, positive heats.
    - `seconds`: for how long, s of the rig; they are switched off after it.
    - `reset`: whether a trip of the device is ended first.
    """

    duty: tuple[float, ...]
    seconds: float
    reset: bool = False


@final
@dataclass(frozen=True)
class HoldOrder:
    """Hold the outputs of the controller at references, behind all interlocks.

    - `references`: the reference of each output, degC.
    - `seconds`: for how long, s of the rig; the cells are switched off after it.
    - `reset`: whether a trip of the device is ended first.
    """

    references: tuple[float, ...]
    seconds: float
    reset: bool = False


@final
@dataclass(frozen=True)
class PromoteOrder:
    """Make a version of the store the champion. `version` is its alias or number."""

    version: str
    reason: str


@final
@dataclass(frozen=True)
class RollbackOrder:
    """Make the previous champion of the store the champion again."""

    reason: str


@final
@dataclass(frozen=True)
class RefitOrder:
    """Refit the champion of the store to the last seconds of the rig."""

    seconds: float


@final
@dataclass(frozen=True)
class AcknowledgeOrder:
    """Take what was found until now as known."""


# What commands the rig: it begins a run, or changes one that goes on.
RunOrder = DriveOrder | HoldOrder

Order = RunOrder | RefitOrder | PromoteOrder | RollbackOrder | AcknowledgeOrder


@final
class Answer(NamedTuple):
    """Whether an order is obeyed, and why not, or what happens now."""

    obeyed: bool
    text: str


@final
class Asked:
    """An order with its client, who waits for the answer and may withdraw it until it is taken."""

    def __init__(self, order: Order):
        self.order = order
        self.waiting: Future[Answer] = Future()
        """What the client waits for; it withdraws by `cancel`."""
        self._is_taken = False

    @property
    def is_void(self) -> bool:
        """Whether the client has withdrawn: who was told that nobody obeys must not start a heater
        later."""
        return self.waiting.cancelled()

    def take(self) -> bool:
        """Takes it, after which it cannot be withdrawn. Returns whether the client still waits."""
        if not self._is_taken and not self.waiting.cancelled():
            self._is_taken = self.waiting.set_running_or_notify_cancel()
        return self._is_taken

    def answer(self, answer: Answer) -> None:
        """Answers the client, if it still waits."""
        if self.take():
            self.waiting.set_result(answer)


@final
class Desk:
    """Where clients leave orders, which the loop takes one after the other.

    A stop is no order: it does not wait for its turn. It sets the event that also ends the program,
    so that it reaches a run at once, and a second one reaches a run that does not end.

    **Arguments:**

    - `stop`: the event by which signals end the program.
    """

    def __init__(self, stop: StopRequest):
        self.stop = stop
        self._pressed = False
        self._stops: list[Future[Answer]] = []
        self._lock = threading.Lock()  # of the stops
        self._orders: queue.SimpleQueue[Asked] = queue.SimpleQueue()

    @property
    def is_over(self) -> bool:
        """Whether the program is to end."""
        return self.stop.is_set() and not (self._pressed and not self.stop.signal)

    def press_stop(self) -> "Future[Answer]":
        """Stops the rig, not the program; the answer comes when the device has reported, or has
        not."""
        answer: Future[Answer] = Future()
        with self._lock:
            self._stops.append(answer)
            self._pressed = True
            self.stop.set()
        return answer

    def take_stop(self) -> bool:
        """Returns whether a stop was pressed, once for each."""
        with self._lock:
            pressed = self._pressed
            if pressed and not self.stop.signal:
                self._pressed = False
                self.stop.clear()
        return pressed

    def answer_stops(self, answer: Answer) -> None:
        """Answers those who have pressed the stop."""
        with self._lock:
            waiting, self._stops = self._stops, []
        for asked in waiting:
            if asked.set_running_or_notify_cancel():
                asked.set_result(answer)

    def ask(self, order: Order) -> "Future[Answer]":
        """Leaves an order; the answer comes when it is obeyed or refused."""
        asked = Asked(order)
        self._orders.put(asked)
        return asked.waiting

    def next(self) -> Asked | None:
        """The next order that is not void; None if there is none."""
        with contextlib.suppress(queue.Empty):
            while True:
                asked = self._orders.get_nowait()
                if not asked.is_void:
                    return asked
        return None
