"""Bytes to and from a device: serial ports through pyserial, TCP through a plain socket."""

import contextlib
import socket
from collections.abc import Callable
from typing import Any, Protocol, final, runtime_checkable

import serial

# The longest time for which `read` blocks, and therefore the longest time for closing a link, s.
READ_SECONDS = 0.2

_MOST = 65_536  # bytes of one read


@runtime_checkable
class Transport(Protocol):
    """An open connection. Its calls raise `OSError` once it is broken."""

    def read(self) -> bytes:
        """Returns the bytes that arrived, after waiting at most `READ_SECONDS`; empty for none."""
        ...

    def write(self, data: bytes) -> None:
        """Sends all bytes."""
        ...

    def close(self) -> None:
        """Closes the connection; it never raises."""
        ...


# Opens a connection, or raises `OSError`.
Opener = Callable[[], Transport]


@final
class SocketTransport:
    """A connected TCP socket.

    It is used instead of pyserial's `socket://`, which returns a single byte at a time and drops
    bytes that came before it was opened.
    """

    def __init__(self, connected: socket.socket):
        self._socket = connected
        connected.settimeout(READ_SECONDS)
        with contextlib.suppress(OSError):  # a socket pair has no such option
            connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def read(self) -> bytes:
        try:
            data = self._socket.recv(_MOST)
        except TimeoutError:
            return b""
        if not data:
            raise ConnectionResetError("closed by the other side")
        return data

    def write(self, data: bytes) -> None:
        self._socket.sendall(data)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


@final
class SerialTransport:
    """An open serial port."""

    def __init__(self, url: str, baud: int):
        # pyserial's RFC 2217 client refuses any write timeout; its socket has a separate one.
        write_timeout = None if url.startswith("rfc2217:") else 1.0
        # Two programs on one port would each get a part of the bytes.
        exclusive: dict[str, Any] = {"exclusive": True} if "://" not in url else {}
        self._port = serial.serial_for_url(
            url, baud, timeout=READ_SECONDS, write_timeout=write_timeout, **exclusive
        )

    def read(self) -> bytes:
        # This waits for one byte and reads the bytes that have arrived, not a full buffer.
        try:
            first = self._port.read(1)
            return first + self._port.read(min(self._port.in_waiting, _MOST)) if first else b""
        except TypeError:  # pyserial 3.5, if the port vanished during the call
            raise OSError("the port is gone") from None

    def write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except TypeError:  # closed by the link's thread during the call
            raise OSError("the port is gone") from None

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._port.close()
