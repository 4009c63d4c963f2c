"""A virtual rig behind a TCP port, a pseudo-terminal, an MQTT broker, or a call in this process."""

import contextlib
import errno
import logging
import os
import selectors
import socket
import sys
import threading
from collections import OrderedDict
from typing import Protocol, final, runtime_checkable

from ...errors import LinkError
from ..protocol._clock import Clock
from ..protocol._mqtt_transport import MqttAddress, MqttTransport, without_password
from ._virtual_rig import VirtualRig

# The interval between two steps of the rig, s.
TICK = 0.005

# The time between two steps above which the machine was busy with something else, ns.
MAX_STEP_GAP_NS = 50 * 10**6

MAX_CLIENTS = 8
# Number of bytes that may wait for a slow client; beyond it, the client is disconnected.
MAX_UNSENT = 2**20

log = logging.getLogger("jaxtwin.live")


@runtime_checkable
class Server(Protocol):
    """A server behind which a virtual rig is reached."""

    url: str
    """The address to connect to."""

    def tick(self, data: bytes, device: VirtualRig) -> None:
        """Sends the messages of the rig, and passes received bytes to it."""
        ...

    def hang_up(self) -> None:
        """Cuts the connections off, as a fault."""
        ...

    def close(self) -> None:
        """Ends the server."""
        ...


def serve(
    device: VirtualRig, server: Server, clock: Clock, stop: threading.Event | None = None
) -> None:
    """Runs a virtual rig until `stop` is set; without `stop` it runs for ever."""
    stop = stop or threading.Event()
    turned = clock.now()
    while not stop.is_set():
        now = clock.now()
        if now - turned > MAX_STEP_GAP_NS:
            # On a busy machine commands have come meanwhile. A real device would have obeyed them
            # then; it would not report a second without them.
            server.tick(b"", device)
        turned = now
        server.tick(device.due(now), device)
        if device.cuts_connection():
            server.hang_up()
        clock.wait(stop, TICK)


@final
class TcpServer:
    """Listens on a TCP port; several hosts may listen to one rig.

    **Arguments:**

    - `address`: `"127.0.0.1:7000"`; port 0 takes a free port. The server listens on loopback unless
      another address of the machine is named.

    **Raises:** `LinkError` if it is not an address, or the port is taken.
    """

    def __init__(self, address: str):
        host, _, port = address.rpartition(":")
        try:
            if not 0 <= int(port) < 2**16:
                raise ValueError(f"expected a port from 0 to 65535, got {port}")
            self._listener = socket.create_server((host or "127.0.0.1", int(port)))
        except (OSError, ValueError) as error:
            raise LinkError(
                f"--port: expected HOST:PORT, free, got {address!r} ({error})"
            ) from None
        self._listener.setblocking(False)
        self.url = "socket://{}:{}".format(*self._listener.getsockname()[:2])
        self._clients: dict[socket.socket, bytearray] = {}
        self._spoke: OrderedDict[socket.socket, None] = OrderedDict()  # the most silent first
        self._device: VirtualRig | None = None

    def tick(self, data: bytes, device: VirtualRig) -> None:
        """Lets hosts connect, sends each of them the messages, and passes on what they sent.

        A host that reads too slowly, or is gone, is disconnected.
        """
        self._accept(device)
        for client, unsent in list(self._clients.items()):
            unsent += data
            try:
                if unsent:
                    del unsent[: client.send(unsent)]
            except BlockingIOError:
                pass
            except OSError:
                self._drop(client)
                continue
            if len(unsent) > MAX_UNSENT:
                log.warning("a client reads too slowly and is cut off")
                self._drop(client)
                continue
            try:
                received = client.recv(4096)
                if not received:
                    self._drop(client)
                elif device.receive(received, client):
                    self._spoke.move_to_end(client)
            except BlockingIOError:
                pass
            except OSError:
                self._drop(client)

    def hang_up(self) -> None:
        """Disconnects all hosts, as a fault; they may connect again."""
        for client in list(self._clients):
            self._drop(client)

    def close(self) -> None:
        """Disconnects all hosts and frees the port."""
        self.hang_up()
        self._listener.close()

    def _accept(self, device: VirtualRig) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                client, _ = self._listener.accept()
                if len(self._clients) == MAX_CLIENTS:
                    log.warning("the most silent of %d clients makes room", MAX_CLIENTS)
                    self._drop(next(iter(self._spoke)))
                client.setblocking(False)
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._device = device
                self._spoke[client] = None
                self._clients[client] = bytearray(device.connected(client))

    def _drop(self, client: socket.socket) -> None:
        del self._clients[client], self._spoke[client]
        if self._device is not None:
            self._device.disconnected(client)
        client.close()


@final
class PtyServer:
    """A pseudo-terminal: the virtual rig looks like a serial port, on Linux and macOS.

    **Raises:** `LinkError` if the system has none.
    """

    def __init__(self) -> None:
        if sys.platform == "win32":
            raise LinkError("--pty: expected pseudo-terminals, which Windows lacks; use --port")
        import pty
        import tty

        # The far end is kept open here: a port stays while nobody has it open.
        self._near, self._far = pty.openpty()
        tty.setraw(self._far)
        os.set_blocking(self._near, False)
        self.url = os.ttyname(self._far)
        self._unsent = bytearray()
        self._stuck = 0
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._near, selectors.EVENT_READ)

    def tick(self, data: bytes, device: VirtualRig) -> None:
        """Writes the messages, and passes on what was received.

        Bytes that nobody reads for half a second are discarded.
        """
        self._unsent += data
        try:
            sent = os.write(self._near, self._unsent[:4096]) if self._unsent else 0
            while sent:
                del self._unsent[:sent]
                self._stuck = 0
                sent = os.write(self._near, self._unsent[:4096]) if self._unsent else 0
        except OSError as error:
            if error.errno != errno.EAGAIN:
                raise
            self._stuck += 1
        if self._stuck * TICK > 0.5:
            # Nobody reads. A serial line would not keep it either.
            self._unsent.clear()
            self._stuck = 0
            import termios

            termios.tcflush(self._far, termios.TCIFLUSH)
        if self._selector.select(0):
            with contextlib.suppress(OSError):
                device.receive(os.read(self._near, 4096))

    def hang_up(self) -> None:
        """Discards the messages that have not been sent: a terminal has no connection to close."""
        self._unsent.clear()

    def close(self) -> None:
        """Ends the pseudo-terminal: its name is gone."""
        self._selector.close()
        os.close(self._near)
        os.close(self._far)


@final
class MqttServer:
    """A virtual rig behind a broker.

    **Arguments:**

    - `url`: the address of the broker, `mqtt://host:port/topic`.
    """

    def __init__(self, url: str):
        self.url = without_password(url)
        try:
            address = MqttAddress.parse(url)
            self._transport = MqttTransport(address, reads="down", writes="up")
        except OSError as error:
            raise LinkError(f"{self.url}: {error}") from None

    def tick(self, data: bytes, device: VirtualRig) -> None:
        """Publishes the messages, and passes on the commands that have arrived.

        **Raises:** `LinkError` once the connection to the broker is lost.
        """
        try:
            if data:
                self._transport.write(data)
            device.receive(self._transport.waiting())
        except OSError as error:
            raise LinkError(f"{self.url}: {error}") from None

    def hang_up(self) -> None:
        """Does nothing: the fault does not apply to a broker."""

    def close(self) -> None:
        """Leaves the broker."""
        self._transport.close()


@final
class InProcess:
    """A virtual rig in this process: a transport that calls it. The clock decides how time passes.

    **Arguments:**

    - `device`: the virtual rig.
    - `clock`: the clock of the connection.
    """

    def __init__(self, device: VirtualRig, clock: Clock):
        self._device = device
        self._clock = clock
        self._waiting = device.connected()

    def read(self) -> bytes:
        """Advances the rig to the time of the clock. Returns the bytes that it sends meanwhile.

        **Raises:** `ConnectionResetError` if a fault of the rig cuts the connection.
        """
        data = self._waiting + self._device.due(self._clock.now())
        self._waiting = b""
        if self._device.cuts_connection():
            raise ConnectionResetError("cut by a fault")
        return data

    def write(self, data: bytes) -> None:
        """Passes commands to the rig, at once."""
        self._device.receive(data)

    def close(self) -> None:
        """Does nothing: there is no connection to end."""
