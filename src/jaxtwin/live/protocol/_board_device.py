"""A board that only answers when it is asked, made a device of the protocol: what firmware does
elsewhere is done in the host."""

import contextlib
import math
import secrets
import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar, TypeVar, final

from ..._kinds import add_kind
from ...errors import LinkError
from ...rig import Rig
from ._clock import Clock, SystemClock
from ._codec import encode, parse
from ._framing import delines
from ._identity import Identity
from ._messages import VERSION, Ask, Data, Duty, Hello, Message, Notice, Order
from ._output_stage import Answer, OutputStage
from ._transport import READ_SECONDS

# A board that answers when it is asked, and is no device of the protocol by itself.


class AbstractBoard(ABC):
    """A board with heaters and sensors, such as a Temperature Control Lab.

    A class of its own and `register_board` make every command and function that takes a link speak
    to a board: `mylab://PORT` opens the board whose `kind` is `"mylab"`. The host then does what a
    device of the protocol does by itself: see `BoardDevice`.

    All methods may raise `OSError` with a sentence that says what was expected of the board: the
    link is then closed, with the heaters off if the board still obeys, and opened again.
    """

    kind: ClassVar[str]
    """The scheme of its links."""

    rate: float = 1.0
    """The seconds of the board's time in a second; 1 except for a simulated board."""

    @classmethod
    @abstractmethod
    def open(cls, address: str, rig: Rig) -> "AbstractBoard":
        """Opens a board.

        **Arguments:**

        - `address`: the link without its scheme, such as `/dev/ttyACM0` of `tclab:///dev/ttyACM0`.
        - `rig`: the rig that is expected at the other end.
        """

    @abstractmethod
    def temperatures(self) -> Sequence[float]:
        """Reads the channels of the rig, in its order, degC; NaN for a sensor that has failed."""

    @abstractmethod
    def apply(self, duty: Sequence[float]) -> None:
        """Applies duty cycles to the cells and heaters of the rig, in its order, -1 to 1."""

    def ambient(self) -> float | None:
        """Reads the ambient temperature, degC; None if the board does not measure it."""
        return None

    @abstractmethod
    def close(self) -> None:
        """Ends the connection; the heaters are off already."""


Registered = TypeVar("Registered", bound=type[AbstractBoard])

# Scheme -> class of boards.
_KINDS: dict[str, type[AbstractBoard]] = {}


def register_board(board: Registered) -> Registered:
    """Makes links know a class of boards by its `kind`. Returns the class, so that it can be a
    decorator.

    **Raises:** `LinkError` for a class without a `kind`, or with the `kind` of another class.
    """
    add_kind(_KINDS, board, "register_board", "links, such as 'tclab'", LinkError)
    return board


def board_kinds() -> Mapping[str, type[AbstractBoard]]:
    """The registered kinds of boards, scheme -> class."""
    return _KINDS


# The time between two samples, ns. A board that is read over a serial line takes some hundredths of
# a second for each.
PERIOD_NS = 250_000_000

# The time without a duty command after which the heaters are switched off, s.
WATCHDOG = 2.0


@final
class BoardDevice:
    """A transport to a board that behaves like a device of the protocol.

    Greeting, samples, the refusal of wrong commands, trips and the watchdog are those of any
    device, and the host's interlocks act on it as usual. **One thing is missing:** the watchdog
    runs in the host. If the host or the cable dies, the heaters keep their last duty until the
    board itself switches them off.

    **Arguments:**

    - `board`: the open board.
    - `rig`: the rig that it is.
    - `clock`: the clock of the connection.
    """

    def __init__(self, board: AbstractBoard, rig: Rig, clock: Clock | None = None):
        self._board, self._driver = board, rig.driver
        self._clock: Clock = clock or SystemClock()
        identity = Identity.of(rig)
        self._channels = len(identity.channels)
        self._stage = OutputStage(
            len(identity.cells), identity.counts, WATCHDOG, heaters=len(identity.heaters)
        )
        self._hello = Hello(
            VERSION,
            rig.name,
            boot=secrets.token_hex(4),
            cells=identity.cells,
            heaters=identity.heaters,
            channels=identity.channels,
            counts=identity.counts,
            watchdog=WATCHDOG,
            rate=board.rate,
        )
        self._lock = threading.Lock()  # one thread reads, another commands
        self._woken = threading.Event()
        self._seq = {"data": 0, "event": 0}
        self._rest = b""
        self._out = encode(self._hello)
        self._start = self._clock.now()
        self._due = self._start + PERIOD_NS
        self._applied = self._stage.pwm
        board.apply([0.0] * len(identity.cells))

    def read(self) -> bytes:
        """Waits for the next sample, or for an answer to a command, and returns its bytes."""
        if not self._out:
            left = (self._due - self._clock.now()) * 1e-9
            self._clock.wait(self._woken, min(max(left, 0.0), READ_SECONDS))
        with self._lock:
            self._woken.clear()
            self._on_time()
            now = self._clock.now()
            if now >= self._due:
                # After a pause the rest is skipped: a reading is of now.
                self._due = max(self._due, now - PERIOD_NS) + PERIOD_NS
                self._sample()
            sent, self._out = self._out, b""
        return sent

    def write(self, data: bytes) -> None:
        """Obeys commands; bytes that are none are ignored."""
        with self._lock:
            lines, self._rest = delines(self._rest, data)
            for frame in lines:
                try:
                    message = parse(frame)
                except OSError:
                    continue
                if isinstance(message, Ask):
                    self._say(self._hello)
                elif isinstance(message, Duty | Order):
                    answer = self._stage.obey(message, self._seconds())
                    self._drive()
                    self._notice(answer, message)
            self._woken.set()

    def close(self) -> None:
        """Switches the heaters off and ends the connection."""
        with self._lock, contextlib.suppress(OSError):
            self._board.apply([0.0] * len(self._applied))
        self._board.close()

    def _on_time(self) -> None:
        answer = self._stage.on_time(self._seconds())
        self._drive()
        self._notice(answer)

    def _drive(self) -> None:
        """Applies the counts of the output stage to the board."""
        if self._stage.pwm != self._applied:
            self._board.apply([float(part) for part in self._driver.duty(self._stage.pwm)])
            self._applied = self._stage.pwm
            # A sample tells at once when the duty changed.
            self._due = min(self._due, self._clock.now())

    def _sample(self) -> None:
        """Reads the board.

        **Raises:** `OSError` if it has another number of sensors than the rig channels.
        """
        result = [float(value) for value in self._board.temperatures()]
        if len(result) != self._channels:
            raise OSError(
                f"{type(self._board).__name__}: expected the temperatures of {self._channels} "
                f"channels, got {len(result)}"
            )
        stage, failed = self._stage, [n for n, value in enumerate(result) if math.isnan(value)]
        self._say(
            Data(
                self._count("data"),
                self._device_us(),
                stage.pwm,
                self._board.ambient(),
                tuple(result),
                faults=dict.fromkeys(failed, "nan"),
                owner=stage.owner,
                number=stage.number,
                trip=stage.trip_reason,
            )
        )

    def _notice(self, answer: Answer | None, about: Duty | Order | None = None) -> None:
        if answer is None:
            return
        kind, why = answer
        stamp = self._count("event"), self._device_us()
        if about is None:
            self._say(Notice(*stamp, kind, why=why))
        else:
            self._say(Notice(*stamp, kind, about.owner, about.number, why))

    def _say(self, message: Message) -> None:
        self._out += encode(message)

    def _count(self, stream: str) -> int:
        number = self._seq[stream]
        self._seq[stream] = (number + 1) % 2**32
        return number

    def _seconds(self) -> float:
        return (self._clock.now() - self._start) * 1e-9

    def _device_us(self) -> int:
        return round(self._seconds() * 1e6 * self._hello.rate)
