"""The Temperature Control Lab (TCLab), an Arduino with two transistors as heaters and two sensors,
by the text protocol of its firmware: a command in a line, a reply in a line."""

import contextlib
import io
import re
import time
from collections.abc import Sequence
from typing import Any, final
from urllib.parse import parse_qsl

import serial

from ...errors import LinkError
from ...rig import Rig
from ._board_device import AbstractBoard, register_board

BAUD = 115_200
# An Arduino starts anew when its port is opened, s.
RESET_SECONDS = 2.0

# The longest time for a reply, s.
REPLY_SECONDS = 1.0

# The PWM counts of 100 % of the two heaters, the firmware's own values, which are set when the
# board is opened: some firmwares begin with others, and the heaters would have another power.
MAX_PWM = 200, 100

MODEL = "model"


@final
@register_board
class TCLab(AbstractBoard):
    """A TCLab on a serial port, `tclab://PORT`, or the simulated board of the package `tclab`,
    `tclab://model`, at the speed of `tclab://model?speed=10`.

    A rig has one or two heaters and channels. Names that end with 1 and 2 say which of Q1 and Q2,
    T1 and T2 they are, in any order; others are the first and the second, in the order of the rig.

    The firmware has no lease: it switches its heaters off after a command that it does not know,
    and in most versions does not notice that the host is gone.
    """

    kind = "tclab"

    def __init__(self, port: Any, rig: Rig, rate: float = 1.0):
        self._port, self.rate = port, rate
        self._heaters = _numbers(rig.driven)
        self._channels = _numbers([channel.name for channel in rig.channels])

    @classmethod
    def open(cls, address: str, rig: Rig) -> AbstractBoard:
        """Opens the board.

        **Raises:** `LinkError` for a rig with more than two heaters or channels, or an address of
        neither kind; `OSError` if nothing answers, or something else does.
        """
        heaters, channels = len(rig.driven), len(rig.channels)
        if max(heaters, channels) > 2 or min(rig.lowest_duty) < 0:
            raise LinkError(
                f"tclab: expected a rig with one or two heaters and one or two channels, got "
                f"{rig.name} with {len(rig.cells)} cells, {len(rig.heaters)} heaters and "
                f"{channels} channels"
            )
        where, _, query = address.partition("?")
        if where == MODEL:
            speed = _speed(query)
            return cls(SimulatedPort(speed), rig, speed)
        if not where or query:
            raise LinkError(
                "tclab: expected tclab://PORT, such as tclab:///dev/ttyACM0 or tclab://COM3, "
                f"tclab://model or tclab://model?speed=10, got tclab://{address}"
            )
        port = serial.Serial(where, BAUD, timeout=REPLY_SECONDS, write_timeout=REPLY_SECONDS)
        board = cls(port, rig)
        try:
            time.sleep(RESET_SECONDS)
            port.reset_input_buffer()
            board._expect_firmware()
            for number, counts in enumerate(MAX_PWM, 1):
                board._number(f"P{number} {counts}")
        except OSError:
            port.close()
            raise
        return board

    def temperatures(self) -> Sequence[float]:
        """T1 and T2, degC, in the order of the rig's channels."""
        return [self._number(f"T{number}") for number in self._channels]

    def apply(self, duty: Sequence[float]) -> None:
        """Sets Q1 and Q2, from the duty in the order of the rig, and compares the replies.

        **Raises:** `OSError` if the board has set something else.
        """
        for number, part in zip(self._heaters, duty, strict=True):
            percent = round(100 * part, 2)
            result = self._number(f"Q{number} {percent:g}")
            # Firmware before 1.4 sets whole numbers.
            if not (result == percent or result == int(percent)):
                raise OSError(
                    f"TCLab: expected Q{number} = {percent:g} %, got the reply {result:g}"
                )

    def close(self) -> None:
        """Sends X, which switches both heaters off, and closes the port."""
        with contextlib.suppress(OSError):
            self._ask("X")
        self._port.close()

    def _expect_firmware(self) -> None:
        reply = self._ask("VER")
        if not reply.startswith("TCLab"):
            raise OSError(f"TCLab: expected the reply TCLab Firmware ... to VER, got {reply!r}")

    def _number(self, command: str) -> float:
        reply = self._ask(command)
        try:
            number = float(reply)
        except ValueError:
            raise OSError(
                f"TCLab: expected a number as the reply to {command}, got {reply!r}"
            ) from None
        return number

    def _ask(self, command: str) -> str:
        self._port.write(f"{command}\r\n".encode())
        reply: bytes = self._port.readline()
        if not reply:
            raise OSError(
                f"TCLab: expected a reply to {command} within {REPLY_SECONDS:g} s, got none"
            )
        return reply.decode("ascii", "replace").strip()


def _numbers(names: Sequence[str]) -> list[int]:
    """Which of the board's two heaters, or sensors, the names of a rig are."""
    result = [re.fullmatch(r"\D*([12])", name) for name in names]
    numbers = [int(name[1]) for name in result if name is not None]
    usual = list(range(1, len(names) + 1))
    return numbers if len(numbers) == len(names) == len(set(numbers)) else usual


def _speed(query: str) -> float:
    """The speed in the address of the simulated board.

    **Raises:** `LinkError` for anything else.
    """
    options = dict(parse_qsl(query, keep_blank_values=True))
    text = options.pop("speed", "1")
    try:
        speed = float(text)
        if options or not 0.1 <= speed <= 1000:
            raise ValueError
    except ValueError:
        raise LinkError(
            f"tclab: expected tclab://model or tclab://model?speed=10, 0.1 to 1000, got "
            f"tclab://model?{query}"
        ) from None
    return speed


@final
class SimulatedPort:
    """A port at whose other end the simulated board of the package `tclab` answers like the
    firmware.

    **Raises:** `LinkError` if the package is not installed.
    """

    def __init__(self, speed: float = 1.0):
        try:
            from tclab.labtime import labtime
            from tclab.tclab import TCLabModel
        except ImportError:
            raise LinkError(
                "tclab://model: expected the package tclab, got none; pip install "
                "'jaxtwin[tclab]', in a checkout pip install -e '.[tclab]'"
            ) from None
        labtime.reset()
        labtime.set_rate(speed)  # pyright: ignore[reportArgumentType]
        with contextlib.redirect_stdout(io.StringIO()):  # it prints its version
            self._model = TCLabModel()
        self._reply = b""

    def write(self, data: bytes) -> None:
        """Carries out a command."""
        name, _, argument = data.decode().strip().partition(" ")
        model = self._model
        if name in ("T1", "T2"):
            reply = f"{getattr(model, name):.3f}"
        elif name in ("Q1", "Q2") and argument:
            reply = f"{getattr(model, name)(float(argument)):g}"
        elif name == "VER":
            reply = "TCLab Firmware of the simulated board"
        else:  # X, and what the firmware does not know
            model.Q1(0)
            model.Q2(0)
            reply = "Stop" if name == "X" else name
        self._reply = f"{reply}\r\n".encode()

    def readline(self) -> bytes:
        """The reply to the last command."""
        reply, self._reply = self._reply, b""
        return reply

    def close(self) -> None:
        """Does nothing: there is no port."""
