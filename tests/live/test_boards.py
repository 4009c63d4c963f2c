"""Boards that only answer: the host does what a device of the protocol does by itself."""

import re
import time
from itertools import pairwise
from typing import Any

import pytest
from hand_clock import HandClock

from jaxtwin import Rig, load_rig
from jaxtwin.errors import LinkError
from jaxtwin.live import (
    AbstractBoard,
    BoardDevice,
    Data,
    Duty,
    Hello,
    Notice,
    Order,
    TCLab,
    deframe,
    encode,
    opener,
    parse,
    register_board,
)
from jaxtwin.live.protocol._identity import Identity


class ScriptedPort:
    """The port of a TCLab whose replies a test may change."""

    def __init__(self) -> None:
        self.commands: list[str] = []
        self.replies: dict[str, bytes] = {"T1": b"21.5\r\n", "T2": b"23\r\n", "X": b"Stop\r\n"}
        self.closed = False

    def write(self, data: bytes) -> None:
        self.commands.append(data.decode().strip())

    def readline(self) -> bytes:
        command = self.commands[-1]
        if command in self.replies:
            return self.replies[command]
        return f"{command.split()[-1]}\r\n".encode()

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def rig() -> Rig:
    return load_rig("tclab")


@pytest.fixture
def port() -> ScriptedPort:
    return ScriptedPort()


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def device(rig: Rig, port: ScriptedPort, clock: HandClock) -> BoardDevice:
    return BoardDevice(TCLab(port, 2), rig, clock)


def _messages(device: BoardDevice, reads: int = 1) -> list:
    frames, _, _ = deframe(b"", b"".join(device.read() for _ in range(reads)))
    return [parse(frame) for frame in frames]


def test_a_board_greets_and_sends_each_reading_once(device, rig):
    hello, *_ = _messages(device)
    assert isinstance(hello, Hello)
    assert Identity.of(rig).refusal(hello) is None
    assert (hello.cells, hello.channels, hello.counts) == (("H1", "H2"), ("T1", "T2"), 1000)
    samples = [message for message in _messages(device, 20) if isinstance(message, Data)]
    assert [sample.temperatures for sample in samples] == [(21.5, 23.0)] * len(samples)
    steps = [after.device_us - before.device_us for before, after in pairwise(samples)]
    assert set(steps) == {250_000}
    assert [sample.seq for sample in samples] == list(range(len(samples)))


def test_a_duty_is_applied_in_percent_and_zero_after_the_watchdog(device, port):
    _messages(device)
    device.write(encode(Duty(1, (123, 0), "host")))
    assert port.commands[-2:] == ["Q1 12.3", "Q2 0"]
    (changed, *_) = _messages(device)
    assert changed.pwm == (123, 0)  # without waiting for the next period
    found = _messages(device, 20)
    assert port.commands.index("Q1 0", 3) > port.commands.index("Q1 12.3")
    assert [(m.kind, m.why) for m in found if isinstance(m, Notice)] == [("trip", "watchdog")]
    device.write(encode(Duty(2, (123, 0), "host")))
    refused = [m for m in _messages(device, 4) if isinstance(m, Notice)]
    assert (refused[0].kind, refused[0].why) == ("refused", "tripped")
    device.write(encode(Order("reset", 3, "host")) + encode(Duty(4, (50, 0), "host")))
    assert "Q1 5" in port.commands


def test_a_closed_board_is_off(device, port):
    device.write(encode(Duty(1, (900, 900), "host")))
    device.close()
    assert port.commands[-3:] == ["Q1 0", "Q2 0", "X"]
    assert port.closed


@pytest.mark.parametrize(
    ("command", "reply", "message"),
    [
        ("T1", b"", "TCLab: expected a reply to T1 within 1 s, got none"),
        ("T1", b"\xff!\r\n", "TCLab: expected a number as the reply to T1, got"),
        ("Q1 50", b"7\r\n", "TCLab: expected Q1 = 50 %, got the reply 7"),
    ],
)
def test_no_answer_and_garbage_are_errors_of_the_link(device, port, command, reply, message):
    port.replies[command] = reply

    def go_on() -> None:
        device.write(encode(Duty(1, (500, 0), "host")))
        for _ in range(3):
            device.read()

    with pytest.raises(OSError, match=re.escape(message)):
        go_on()


def test_a_failed_sensor_is_a_fault_of_its_channel(device, port):
    port.replies["T2"] = b"nan\r\n"
    (sample, *_) = [m for m in _messages(device, 6) if isinstance(m, Data)]
    assert sample.faults == {1: "nan"}
    assert sample.temperatures[0] == 21.5


def test_addresses_are_checked_before_anything_is_opened(rig):
    for address, message in [
        ("tclab://", "tclab: expected tclab://PORT"),
        ("tclab://model?speed=fast", "tclab: expected tclab://model or"),
        ("tclab://model?spede=1", "tclab: expected tclab://model or"),
    ]:
        with pytest.raises(LinkError, match=re.escape(message)):
            opener(address, rig)()
    with pytest.raises(LinkError, match="expected a rig with one or two heaters"):
        opener("tclab://model", load_rig("dual-cell"))()


def test_a_board_of_ones_own_is_a_link(rig):
    class Oven(AbstractBoard):
        kind = "oven"

        def __init__(self, address):
            self.address, self.duty = address, []

        @classmethod
        def open(cls, address, rig):
            return cls(address)

        def temperatures(self):
            return [20.0, 21.0]

        def apply(self, duty):
            self.duty.append(list(duty))

        def ambient(self):
            return 18.5

        def close(self):
            self.duty.append("closed")

    register_board(Oven)
    device: Any = opener("oven://7", rig)()
    device.write(encode(Duty(1, (1000, 0), "host")))
    samples = [m for m in _messages(device, 3) if isinstance(m, Data)]
    assert samples[0].temperatures == (20.0, 21.0)
    assert samples[0].ambient == 18.5
    device.close()
    assert device._board.duty == [[0.0, 0.0], [1.0, 0.0], [0.0, 0.0], "closed"]


def test_a_board_without_a_kind_is_refused():
    class Nameless(AbstractBoard):
        kind = ""

    with pytest.raises(LinkError, match="expected its name in links"):
        register_board(Nameless)


def test_the_simulated_board_warms_its_sensor(rig, clock):
    board = TCLab.open("model?speed=1000", rig)
    board.apply([1.0, 0.0])
    time.sleep(0.2)  # 200 s of the board
    warm, cold = board.temperatures()
    assert warm > cold + 5
    board.close()
