"""What clients ask for, from the threads of the server to the loop around the rig."""

import contextlib
import queue
from concurrent.futures import Future
from dataclasses import dataclass
from typing import NamedTuple, final

from ..live._stop_request import StopRequest


@final
@dataclass(frozen=True)
class DriveOrder:
    """Hold a duty for a time, behind all interlocks.

    - `duty`: the duty of each cell, -1 to 1, positive heats.
    - `seconds`: for how long, s of the rig; the cells are off after it.
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
    - `seconds`: for how long, s of the rig; the cells are off after it.
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


RunOrder = DriveOrder | HoldOrder
"""What commands the rig: it begins a run, or changes one that goes on."""

Order = RunOrder | RefitOrder | PromoteOrder | RollbackOrder


@final
class Answer(NamedTuple):
    """Whether an order is obeyed, and why not, or what happens now."""

    obeyed: bool
    text: str


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
        self._orders: queue.SimpleQueue[tuple[Order, Future[Answer]]] = queue.SimpleQueue()

    @property
    def is_over(self) -> bool:
        """Whether the program is to end."""
        return self.stop.is_set() and not (self._pressed and not self.stop.signal)

    def press_stop(self) -> None:
        """Stops the rig, not the program."""
        self._pressed = True
        self.stop.set()

    def take_stop(self) -> bool:
        """Returns whether a stop was pressed, once for each."""
        pressed = self._pressed
        if pressed and not self.stop.signal:
            self._pressed = False
            self.stop.clear()
        return pressed

    def ask(self, order: Order) -> "Future[Answer]":
        """Leaves an order; the answer comes when the loop takes it."""
        answer: Future[Answer] = Future()
        self._orders.put((order, answer))
        return answer

    def next(self) -> "tuple[Order, Future[Answer]] | None":
        """Takes the next order; None if there is none. An order whose client no longer waits is
        void: who was told that nobody answers must not start a heater later."""
        with contextlib.suppress(queue.Empty):
            while True:
                order, answer = self._orders.get_nowait()
                if answer.set_running_or_notify_cancel():
                    return order, answer
        return None
