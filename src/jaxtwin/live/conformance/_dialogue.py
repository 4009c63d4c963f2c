"""Lines to and from a single device, for scripts that test it."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import Literal, NamedTuple, final

from ...errors import LinkError
from ..protocol._clock import Clock
from ..protocol._codec import encode, parse
from ..protocol._framing import deframe
from ..protocol._messages import Data, Duty, Message, Notice, Order
from ..protocol._transport import Transport

# The longest time that an answer may take, s.
ANSWERS_WITHIN = 3.0


@final
class Dialogue:
    """Sends lines to a device and waits for its answers.

    **Arguments:**

    - `transport`: an open connection.
    - `clock`: host time.
    - `owner`: the name under which the script commands.
    """

    def __init__(self, transport: Transport, clock: Clock, owner: str):
        self.owner = owner
        self.nonsense: list[str] = []
        """The bytes of the device that do not follow the protocol."""
        self.clock = clock
        self._transport = transport
        self._rest = b""
        self._waiting: deque[Message] = deque()
        self._number = 0

    def say(self, content: bytes) -> None:
        """Sends bytes, whether or not they follow the protocol."""
        self._transport.write(content)

    def next_number(self) -> int:
        """The number of a new command."""
        self._number += 1
        return self._number

    def command(self, *pwm: int, owner: str | None = None, number: int | None = None) -> int:
        """Sends a duty, with a new number if none is given. Returns its number."""
        number = self.next_number() if number is None else number
        self.say(encode(Duty(number, pwm, owner or self.owner)))
        return number

    def order(
        self,
        kind: Literal["stop", "reset", "release", "relay"],
        owner: str | None = None,
        name: str = "",
    ) -> int:
        """Sends a command without counts; `name` is that of the relay. Returns its number."""
        number = self.next_number()
        self.say(encode(Order(kind, number, owner or self.owner, name)))
        return number

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

    def hears(self, what: Callable[[Message], bool], seconds: float = ANSWERS_WITHIN) -> bool:
        """Whether the device sends an expected message."""
        return any(what(message) for message in self.listen(seconds))

    def reports(self, seconds: float = ANSWERS_WITHIN, **wanted: object) -> bool:
        """Whether a sample has these values."""
        return self.hears(
            lambda message: isinstance(message, Data) and _has(message, wanted), seconds
        )

    def keeps(self, seconds: float, **wanted: object) -> bool:
        """Whether there are samples within a time, and all have these values."""
        samples = [message for message in self.listen(seconds) if isinstance(message, Data)]
        return bool(samples) and all(_has(sample, wanted) for sample in samples)

    def tells(self, kind: str, why: str, number: int | None = None) -> bool:
        """Whether the device sends an event of this kind and reason, about this command."""
        wanted: dict[str, object] = {"kind": kind, "why": why}
        if number is not None:
            wanted["number"] = number
        return self.hears(lambda message: isinstance(message, Notice) and _has(message, wanted))

    def refuses(self, number: int, why: str) -> bool:
        """Whether the device refuses the command with this number for this reason."""
        return self.tells("refused", why, number)


def _has(message: Message, wanted: Mapping[str, object]) -> bool:
    return all(getattr(message, key) == value for key, value in wanted.items())


# What one step of the conformance test found.


class StepResult(NamedTuple):
    """The test of one step of the script, and the error that it found (`""` for none)."""

    step: str
    wrong: str


def step_result(step: str, ok: bool, wrong: str) -> StepResult:
    """The result of a step that is `wrong` if it is not `ok`."""
    return StepResult(step, "" if ok else wrong)
