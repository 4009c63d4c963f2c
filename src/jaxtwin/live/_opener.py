"""The address of a link -> how it is opened. A new kind of link gets its line here."""

import socket
from urllib.parse import urlsplit

import serial

from .._errors import LinkError
from ._mqtt import MqttTransport
from ._transport import Opener, SerialTransport, SocketTransport

CONNECT_SECONDS = 3.0
"""The longest that opening a TCP link takes."""


def opener(url: str, *, baud: int = 115_200) -> Opener:
    """How to open a link, without opening it.

    **Arguments:**

    - `url`: `socket://host:port`, `mqtt://host:port/topic`, or what pyserial takes: a port such as
        `/dev/ttyACM0` or `COM3`, `rfc2217://host:port`, `loop://`.
    - `baud`: of a serial port.

    **Raises:** `LinkError` where the text is none of those.
    """
    parts = urlsplit(url)
    if parts.scheme in ("socket", "mqtt"):
        try:
            host, port = parts.hostname, parts.port
        except ValueError:
            host = port = None
        if parts.scheme == "mqtt" and host and parts.path.strip("/"):
            topic = parts.path.strip("/")
            return lambda: MqttTransport(host, port or 1883, topic)
        if parts.scheme == "socket" and host and port:
            return lambda: SocketTransport(socket.create_connection((host, port), CONNECT_SECONDS))
        raise LinkError(f"link {url!r}: allowed are socket://host:port and mqtt://host:port/topic")
    try:
        serial.serial_for_url(url, baud, do_not_open=True)
    except (ValueError, serial.SerialException) as error:
        raise LinkError(
            f"link {url!r}: {error}; allowed are a serial port, socket://host:port, "
            "rfc2217://host:port, loop:// and mqtt://host:port/topic"
        ) from None
    return lambda: SerialTransport(url, baud)
