"""Makes the function that opens a link from its address. A new kind of link is added here."""

import socket
from urllib.parse import urlsplit

import serial

from ...errors import LinkError
from ...rig import Rig
from ._board_device import BoardDevice, board_kinds
from ._mqtt_transport import MqttAddress, MqttTransport
from ._tclab import TCLab as TCLab  # which registers itself
from ._transport import Opener, SerialTransport, SocketTransport

# The longest time for opening a TCP link, s.
CONNECT_SECONDS = 3.0


def opener(url: str, rig: Rig, *, baud: int = 115_200) -> Opener:
    """Returns a function that opens a link.

    **Arguments:**

    - `url`: `socket://host:port`, `mqtt://host:port/topic` (see `MqttAddress`), `tclab://port` or
      the scheme of another board (`register_board`), or an address that pyserial accepts: a port
      such as `/dev/ttyACM0` or `COM3`, `rfc2217://host:port`, `loop://`.
    - `rig`: the rig that is expected at the other end.
    - `baud`: the baud rate of a serial port.

    **Raises:** `LinkError` if the text is no such address.
    """
    if url.startswith(("mqtt:", "mqtts:")):
        address = MqttAddress.parse(url)
        return lambda: MqttTransport(address)
    scheme, _, address = url.partition("://")
    if board := board_kinds().get(scheme):
        return lambda: BoardDevice(board.open(address, rig), rig)
    if url.startswith("socket:"):
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port
        except ValueError:
            host = port = None
        if host and port:
            return lambda: SocketTransport(socket.create_connection((host, port), CONNECT_SECONDS))
        raise LinkError(f"link: expected socket://host:port, got {url!r}")
    try:
        serial.serial_for_url(url, baud, do_not_open=True)
    except (ValueError, serial.SerialException) as error:
        raise LinkError(
            "link: expected a serial port, socket://host:port, rfc2217://host:port, loop://, "
            f"mqtt://host:port/topic or the board {', '.join(board_kinds())}, got {url!r} ({error})"
        ) from None
    return lambda: SerialTransport(url, baud)
