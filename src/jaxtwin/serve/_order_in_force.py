"""An order that commands the rig, from the desk to the report of the device that it is obeyed."""

from typing import final

from ..live import Command as Sent
from ..live import Record, RigConnection, Sample
from ._commands import described
from ._desk import Answer, Asked, RunOrder


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
