"""Links: opened again for ever, nothing that came is lost, nothing waits without a limit."""

import contextlib
import logging
import queue
import socket
import threading

import pytest
import serial
from hand_clock import HandClock, ScriptedTransport, stepped_bench
from serial.rfc2217 import PortManager

from jaxtwin import JaxtwinError, Rig, load_rig
from jaxtwin.live import LinkChange, LinkState, PtyServer, opener
from jaxtwin.live.protocol._link import FIRST_RETRY, LONGEST_RETRY, Arrived, Inbox, Link
from jaxtwin.live.protocol._transport import SocketTransport

RIG = load_rig("dual-cell")


def scripted(clock: HandClock, *openings: ScriptedTransport | OSError) -> tuple[Link, Inbox]:
    """A link that opens these, one after the other, and fails from then on."""
    waiting = list(openings)

    def open_next() -> ScriptedTransport:
        item = waiting.pop(0) if waiting else ConnectionRefusedError(111, "refused")
        if isinstance(item, OSError):
            raise item
        return item

    inbox: Inbox = queue.Queue()
    return Link("link", open_next, inbox, clock), inbox


def items(inbox: Inbox) -> list[object]:
    return [inbox.get_nowait() for _ in range(inbox.qsize())]


def test_what_came_before_the_loss_is_delivered_before_the_loss(clock: HandClock) -> None:
    link, inbox = scripted(clock, ScriptedTransport(b"a", b"b", ConnectionResetError("gone")))
    for _ in range(4):
        link.step()
    states = [item.state if isinstance(item, LinkChange) else item.data for item in items(inbox)]  # pyright: ignore[reportAttributeAccessIssue]
    assert states == [LinkState.CONNECTING, b"a", b"b", LinkState.DOWN]


def test_pauses_double_up_to_a_limit_and_attempts_never_end(clock: HandClock) -> None:
    link, inbox = scripted(clock)
    for _ in range(12):
        link.step()
    assert clock.waits[:3] == [FIRST_RETRY, 2 * FIRST_RETRY, 4 * FIRST_RETRY]
    assert clock.waits[-1] == LONGEST_RETRY
    # One record and one line for one reason, whatever the number of attempts.
    assert len(items(inbox)) == 1


@pytest.mark.parametrize("lasted", [True, False])
def test_after_a_connection_that_lasted_the_next_retry_is_quick_again(
    clock: HandClock, lasted: bool
) -> None:
    refused = ConnectionRefusedError(111, "refused")
    lost = ScriptedTransport(ConnectionResetError("gone"))
    link, _ = scripted(clock, refused, refused, refused, lost)
    for _ in range(4):
        link.step()
    if lasted:
        clock.turn(5.0)
    link.mark_valid()
    link.step()
    assert clock.waits[-1] == (FIRST_RETRY if lasted else 8 * FIRST_RETRY)


def test_a_dropped_peer_is_closed_with_one_log_line(
    clock: HandClock, caplog: pytest.LogCaptureFixture
) -> None:
    transport = ScriptedTransport(b"x")
    link, inbox = scripted(clock, transport)
    link.step()
    link.drop("speaks nonsense")
    with caplog.at_level(logging.WARNING, "jaxtwin.live"):
        for _ in range(3):
            link.step()
    assert transport.closed
    assert caplog.messages == ["link: down: speaks nonsense", "link: down: refused"]
    change = items(inbox)[1]
    assert isinstance(change, LinkChange)
    assert change.detail == "speaks nonsense"


def test_sending_on_a_broken_link_says_so_and_opens_it_again(clock: HandClock) -> None:
    transport = ScriptedTransport()

    def broken(data: bytes) -> None:
        raise BrokenPipeError(32, "broken pipe")

    transport.write = broken
    link, _ = scripted(clock, transport)
    assert not link.send(b"x")
    link.step()
    assert not link.send(b"x")
    link.step()
    assert transport.closed


def test_a_socket_delivers_what_came_before_anybody_read(clock: HandClock) -> None:
    # pyserial's socket:// drops that (its open() empties the buffer).
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        transport = opener(f"socket://127.0.0.1:{port}", RIG)()
        accepted, _ = server.accept()
        accepted.sendall(b"x" * 10_000)
        accepted.close()
        received = b""
        while len(received) < 10_000:
            received += transport.read()
        with pytest.raises(ConnectionResetError):
            transport.read()
    assert received == b"x" * 10_000
    transport.close()


def test_a_socket_that_is_silent_is_no_error() -> None:
    near, far = socket.socketpair()
    transport = SocketTransport(near)
    assert transport.read() == b""
    far.sendall(b"late")
    assert transport.read() == b"late"
    transport.close()
    far.close()


class Rfc2217Server:
    """A serial port behind a TCP port, by pyserial's own server side; what is sent comes back."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"rfc2217://127.0.0.1:{self._listener.getsockname()[1]}"
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def write(self, data: bytes) -> None:
        self._client.sendall(data)

    def close(self) -> None:
        self._listener.close()
        self._thread.join()

    def _serve(self) -> None:
        try:
            self._client, _ = self._listener.accept()
        except OSError:  # closed, and nobody came
            return
        port = serial.serial_for_url("loop://", timeout=0)
        manager = PortManager(port, self)  # pyright: ignore[reportArgumentType] (any such objects)
        with self._client:
            while received := self._client.recv(1024):
                port.write(b"".join(manager.filter(received)))
                self.write(b"".join(manager.escape(port.read(port.in_waiting))))
        port.close()


@pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")  # in pyserial 3.5
def test_a_serial_port_behind_rfc_2217_is_a_link_like_any_other() -> None:
    with (
        contextlib.closing(Rfc2217Server()) as server,
        contextlib.closing(opener(server.url, RIG)()) as transport,
    ):
        transport.write(b"beat t=1\xff")
        received = b""
        while len(received) < 9:
            received += transport.read()
    assert received == b"beat t=1\xff"  # 255 begins a command of Telnet and is sent twice


def test_a_serial_port_reads_back_what_loop_sends() -> None:
    transport = opener("loop://", RIG)()
    transport.write(b"beat t=1")
    assert transport.read() + transport.read() == b"beat t=1"
    transport.close()


def test_a_serial_port_is_opened_by_one_program_at_a_time() -> None:
    server = PtyServer()
    first = opener(server.url, RIG)()
    with pytest.raises(OSError, match="exclusively lock"):
        opener(server.url, RIG)()
    first.close()
    opener(server.url, RIG)().close()
    server.close()


@pytest.mark.parametrize(
    "url",
    [
        "socket://127.0.0.1",
        "socket://:70",
        "socket://h:99999",
        "nonsense://x",
        "mqtt://h",
        "mqtt:///t",
    ],
)
def test_a_link_that_cannot_exist_is_refused_with_what_is_expected(url: str) -> None:
    with pytest.raises(JaxtwinError, match="expected"):
        opener(url, RIG)


@pytest.mark.usefixtures("no_threads_left")
def test_closing_ends_the_thread_even_when_nobody_takes_what_it_read(clock: HandClock) -> None:
    inbox: Inbox = queue.Queue(1)
    link = Link("link", lambda: ScriptedTransport(*[b"x"] * 100), inbox, clock)
    link.start()
    first = inbox.get(timeout=10)
    assert isinstance(first, LinkChange)
    assert isinstance(inbox.get(timeout=10), Arrived)
    link.close()
    assert not [t for t in threading.enumerate() if t.name == "link link"]


def test_a_device_that_does_not_greet_is_asked_once_a_second(rig: Rig, clock: HandClock) -> None:
    silent = ScriptedTransport()
    bench = stepped_bench(rig, {"rig": lambda: silent}, clock, step=0.25)
    for _ in range(18):  # 4.5 s
        bench.poll()
    assert len(silent.written) == 4
