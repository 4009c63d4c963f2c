"""An order that commands the rig, from the desk to the report of the device that it is obeyed: a
held duty, or a controller at held references."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, final

import numpy as np

from ..control import AbstractController, bounds_of
from ..errors import ControlError
from ..io import Experiment
from ..live import (
    STILL_HEATS,
    Finding,
    Guard,
    Moment,
    OffWatch,
    Record,
    Replay,
    RigConnection,
    RigState,
    Sample,
    heat_sentence,
)
from ..live import Command as Sent
from ..physics import Twin
from ..simulation import simulate
from ._desk import Answer, Asked, DriveOrder, HoldOrder, RunOrder
from ._page import Page

if TYPE_CHECKING:
    from ..control import Decision


# What commands the rig in a run of the page: a held duty, or a controller at held references.

# The longest time without a reading for a controller, s of the host. To a virtual rig that is ten
# times as fast an order takes seconds to check, and that must not look like a silence.
MAX_SILENCE_SECONDS = 3.0

Command: TypeAlias = Callable[[Moment], Sequence[float] | np.ndarray | None]
"""The duty at a moment since the order, -1 to 1; None ends the run."""


@final
class HeldDuty(NamedTuple):
    """A duty that is held for some seconds of the rig."""

    duty: tuple[float, ...]
    seconds: float

    def __call__(self, moment: Moment) -> Sequence[float] | None:
        return None if moment.time >= self.seconds else self.duty

    def simulated_plan(self) -> Experiment:
        """The duty that is held."""
        return Experiment([0.0, self.seconds], [self.duty, self.duty])


def compile_loop(twin: Twin, controller: AbstractController) -> None:
    """Compiles what an order to hold references needs, before a rig waits for it."""
    from ..control import LiveLoop  # which a page without a controller does not import

    # Where the middle of the allowed duty leads to is a point that can be held.
    lowest, highest = bounds_of(controller.for_rig(twin.rig).limits)
    middle = np.maximum((lowest + highest) / 2, twin.rig.lowest_duty)
    held = Experiment([0.0, controller.sample_time_s], np.tile(middle, (2, 1)))
    rest = simulate(twin, held, initial="steady").temperatures[-1]
    references = np.asarray(controller.output_weights(twin.channels)) @ rest
    LiveLoop(twin, controller, references, duration=controller.sample_time_s).simulated_plan()


@final
class HeldReferences:
    """A controller at the references of an order. It takes over from the command before it: from
    its own state if that was the same controller, otherwise from the duty that it finds. Its
    decisions are recorded.

    **Arguments:**

    - `connection`: the connection to the rig.
    - `twin`: the twin, for which the loop is checked.
    - `controller`: the controller; None: there is none.
    - `order`: the order.
    - `before`: the command until now.
    - `rate`: the seconds of the rig in one of the host.
    - `on_decision`: called with each sample of the controller.

    **Raises:** `ControlError` without a controller, and for references out of reach; the errors of
    `LiveLoop`.
    """

    def __init__(
        self,
        connection: RigConnection,
        twin: Twin,
        controller: AbstractController | None,
        order: HoldOrder,
        before: Command,
        rate: float,
        on_decision: "Callable[[Decision], None] | None" = None,
    ):
        if controller is None:
            raise ControlError("references: expected a server with --controller")
        from ..control import LiveLoop

        samples = max(round(order.seconds / controller.sample_time_s), 1)
        duration = samples * controller.sample_time_s
        silence = MAX_SILENCE_SECONDS * max(rate, 1.0)
        self._loop = LiveLoop(
            twin, controller, order.references, duration=duration, silence=silence
        )
        if isinstance(before, HeldReferences):
            self._loop.continue_from(before._loop)
        self.order = order
        """The order."""
        self._command = self._loop.recorded(connection, on_decision)

    def __call__(self, moment: Moment) -> np.ndarray | None:
        return self._command(moment)

    def simulated_plan(self) -> Experiment:
        """As that of its `LiveLoop`."""
        return self._loop.simulated_plan()


def plan_of(order: RunOrder) -> dict[str, Any]:
    """An order as a recording and the page keep it."""
    if isinstance(order, DriveOrder):
        return {"duty": order.duty, "duration_s": order.seconds}
    return {"references": order.references, "duration_s": order.seconds}


def described(order: RunOrder) -> str:
    """An order in words, behind "the rig is"."""
    if isinstance(order, DriveOrder):
        return f"driven with a duty of {', '.join(f'{100 * part:.0f} %' for part in order.duty)}"
    return f"held at {', '.join(f'{reference:g} °C' for reference in order.references)}"


@final
class AfterRun:
    """Watches the readings after a run, while the page goes on. It consumes the records of a
    source. If the rig heats, it is an alarm, and `stop` and the command that opens the relay are
    sent until the readings show that it cools, for a minute at most.

    **Arguments:**

    - `source`: the connection, or a replay, on which there are no runs.
    - `page`: the page, which tells what is seen.
    """

    def __init__(self, source: RigConnection | Replay, page: Page):
        self._source, self._page = source, page
        self._watch: OffWatch | None = None
        self._stops = False

    @property
    def is_watching(self) -> bool:
        """Whether the readings have not yet shown if the rig is off."""
        return self._watch is not None

    def begin(self, guard: Guard) -> None:
        """Begins to watch at the end of a run. The twins of its guard know how the rig would
        cool."""
        self._watch, self._stops = guard.off_watch(self._source.clock.now()), False

    def end(self) -> None:
        """Ends the watch: another run begins."""
        self._watch, self._page.heats = None, ""

    def on_record(self, record: Record, state: RigState) -> None:
        """Takes a record."""
        if self._watch is not None:
            self._watch.on_record(record, state)

    def on_time(self, state: RigState, now: int) -> None:
        """Tells what the readings show, once they do."""
        watch = self._watch
        if watch is None:
            return
        watch.on_time(state, now)
        if self._stops and isinstance(self._source, RigConnection):
            self._source.send_order("stop")
        if not watch.verdict:
            return
        self._watch = None
        if watch.verdict == "off":
            self._page.heats = ""
            cools = "it cools now" if self._stops else "the cells are off"
            self._page.say("notice", f"{cools}, {watch.detail}")
        elif watch.verdict == "unknown":
            self._page.say("notice", f"the device reports off; {watch.detail}")
        else:
            self._page.say("critical", f"the rig heats after a stop: {watch.detail}")
        if watch.verdict == "heats" and not self._stops:
            text = heat_sentence(watch.detail)
            self._page.heats = text
            self._page.on_finding(Finding(STILL_HEATS, text, severity="critical"))
            watch.again(now)
            self._watch, self._stops = watch, True


@final
class OrderInForce:
    """An order that commands the rig. Its client is answered once the device has acknowledged one
    of its commands, or when it cannot be obeyed.

    **Arguments:**

    - `asked`: the order and its client. `order`: the same order.
    - `connection`: the connection to the rig.
    - `changes_run`: whether it changes a run that goes on.
    """

    def __init__(
        self, asked: Asked, order: RunOrder, connection: RigConnection, *, changes_run: bool
    ):
        self.order = order
        self.is_answered = False
        """Whether its client has been answered."""
        self._asked, self._connection, self._changes_run = asked, connection, changes_run
        self._first: int | None = None
        self._ended = ""  # the trip that a reset of this order has ended

    @property
    def is_void(self) -> bool:
        """Whether the client has withdrawn before the first command."""
        return self._asked.is_void

    @property
    def has_commanded(self) -> bool:
        """Whether a command of it may have been sent."""
        return self._first is not None

    def begin(self) -> bool:
        """Prepares for the next command of the connection. Returns whether it may be sent: from
        the first one on, the client cannot withdraw."""
        if self._first is None and self._asked.take():
            self._first = (self._connection.number + 1) % 2**32
        return self._first is not None

    def see(self, record: Record, trip: str) -> bool:
        """Looks for the acknowledgement of one of its commands.

        **Arguments:**

        - `record`: the next record of the run.
        - `trip`: the reason of the trip that the device reported last.

        **Returns:** whether the device has just acknowledged the first of them.
        """
        if isinstance(record, Sent) and record.kind == "reset":
            self._ended = trip or self._ended
        if self.is_answered or self._first is None or not isinstance(record, Sample):
            return False
        connection = self._connection
        if not record.pwm or record.number is None or record.owner != connection.owner:
            return False
        # A number that was never sent acknowledges nothing. Numbers begin anew after 2**32.
        sent = (connection.number - self._first) % 2**32
        if (record.number - self._first) % 2**32 > sent:
            return False
        self._answer(Answer(True, f"the rig is {described(self.order)}{self._more()}"))
        return True

    def refuse(self, why: str) -> None:
        """Answers that it is not obeyed, unless it was."""
        if not self.is_answered:
            self._answer(Answer(False, why))

    def _answer(self, answer: Answer) -> None:
        self.is_answered = True
        self._asked.answer(answer)

    def _more(self) -> str:
        text = " from now on" if self._changes_run else ""
        if not self.order.reset:
            return text
        ended = (
            f"its trip ({self._ended}) was ended first" if self._ended else "nothing had tripped"
        )
        return f"{text}; {ended}"
