"""Lines to and from a single device, for scripts that test it."""

from collections import deque
from collections.abc import Callable, Iterator
from typing import Literal, final

from .._errors import LinkError
from ._codec import encode, parse
from ._framing import deframe
from ._messages import Data, Duty, Message, Notice, Order
from ._time import Clock
from ._transport import Transport

PATIENCE = 3.0
"""The longest time that an answer may take, s."""


@final
class Dialogue:
    """Sends lines to a device and waits for its answers.

    **Arguments:**

    - `transport`: an open connection.
    - `clock`: host time.
    - `owner`: the name under which the script commands.
    """

    def __init__(self, transport: Transport, clock: Clock, owner: str):
        self.nonsense: list[str] = []
        """The bytes of the device that do not follow the protocol."""
        self.clock = clock
        self._transport = transport
        self._owner = owner
        self._rest = b""
        self._waiting: deque[Message] = deque()
        self._number = 0

    def say(self, content: bytes) -> None:
        """Sends bytes, whether or not they follow the protocol."""
        self._transport.write(content)

    def command(self, *pwm: int, owner: str | None = None) -> int:
        """Sends a duty. Returns its number."""
        self._number += 1
        self.say(encode(Duty(self._number, pwm, owner or self._owner)))
        return self._number

    def order(self, kind: Literal["stop", "reset", "release"], owner: str | None = None) -> None:
        """Sends a command without counts."""
        self._number += 1
        self.say(encode(Order(kind, self._number, owner or self._owner)))

    def open_relay(self, name: str, owner: str | None = None) -> None:
        """Sends the command that opens the relay in the supply."""
        self._number += 1
        self.say(encode(Order("relay", self._number, owner or self._owner, name)))

    def listen(self, seconds: float) -> Iterator[Message]:
        """Returns the messages that the device sends within a time."""
        end = self.clock.now() + round(seconds * 1e9)
        while True:
            while self._waiting:
                yield self._waiting.popleft()
            if self.clock.now() >= end:
                return
            frames, self._rest, discarded = deframe(self._rest, self._transport.read())
            if discarded:
                self.nonsense.append(f"{discarded} bytes that belong to no frame")
            for frame in frames:
                try:
                    self._waiting.append(parse(frame))
                except LinkError as error:
                    self.nonsense.append(str(error))

    def hears(self, what: Callable[[Message], bool], seconds: float = PATIENCE) -> bool:
        """Whether the device sends an expected message."""
        return any(what(message) for message in self.listen(seconds))

    def reports(self, seconds: float = PATIENCE, **wanted: object) -> bool:
        """Whether a sample has these values."""
        return self.hears(
            lambda message: (
                isinstance(message, Data)
                and all(getattr(message, key) == value for key, value in wanted.items())
            ),
            seconds,
        )

    def refuses(self, number: int, why: str) -> bool:
        """Whether the device refuses the command with this number for this reason."""
        return self.hears(
            lambda message: (
                isinstance(message, Notice)
                and (message.kind, message.number, message.why) == ("refused", number, why)
            )
        )
