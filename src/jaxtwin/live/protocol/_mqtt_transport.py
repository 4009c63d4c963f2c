"""MQTT: the protocol through a broker, and decoded records for subscribers.

A broker carries the bytes of a link unchanged, device to host on `TOPIC/up` and host to device on
`TOPIC/down`. Sequence numbers show which messages a broker has lost, as on other links. Retained
messages are ignored, because an old command must not heat a rig that has just been switched on.
Needs the extra `mqtt` (paho-mqtt).
"""

import contextlib
import logging
import queue
import re
import threading
from dataclasses import dataclass, field
from typing import Any, final
from urllib.parse import parse_qsl, unquote, urlsplit

from ...errors import LinkError
from ._framing import PACKET_BYTES
from ._transport import READ_SECONDS

# Parses the address of a broker, `mqtt://user:password@host:port/topic`.

EXPECTED = "mqtt://[user[:password]@]host[:port]/topic, or mqtts:// with TLS"

_FILES = ("ca", "cert", "key")
_PORTS = {"mqtt": 1883, "mqtts": 8883}
_PASSWORD = re.compile(r"(\w+://[^/?#:@\s]*):[^/?#\s]*@")


@final
@dataclass(frozen=True)
class MqttAddress:
    """A topic of a broker.

    **Arguments:**

    - `host`, `port`, `topic`: the host and port of the broker, and the topic.
    - `user`, `password`: the name and the password; `None` if the address has none.
    - `tls`: whether the connection is encrypted (`mqtts://`).
    - `ca`, `cert`, `key`: the files of the certificate authority, and of the client's certificate
      and key, from `?ca=FILE&cert=FILE&key=FILE`; `None`: the authorities of the system, and no
      certificate.
    """

    host: str
    port: int
    topic: str
    user: str | None = None
    password: str | None = field(default=None, repr=False)
    tls: bool = False
    ca: str | None = None
    cert: str | None = None
    key: str | None = None

    @classmethod
    def parse(cls, url: str) -> "MqttAddress":
        """Parses a URL.

        **Raises:** `LinkError`, without the password, if it is not an MQTT address.
        """
        shown = without_password(url)
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port
        except ValueError:
            raise LinkError(f"link: expected {EXPECTED}, got {shown!r}") from None
        topic = unquote(parts.path.strip("/"))
        if parts.scheme not in _PORTS or not host or not topic:
            raise LinkError(f"link: expected {EXPECTED}, got {shown!r}")
        if "#" in url or re.search(r"[+#\0]", topic):
            raise LinkError(f"link: expected a topic without + and #, got {shown!r}")
        files = dict(parse_qsl(parts.query, keep_blank_values=True))
        tls = parts.scheme == "mqtts"
        if set(files) - set(_FILES) or (files and not tls) or ("key" in files) != ("cert" in files):
            raise LinkError(
                "link: expected mqtts:// and behind the ? ca=FILE, or cert=FILE&key=FILE, "
                f"got {shown!r}"
            )
        return cls(
            host,
            port or _PORTS[parts.scheme],
            topic,
            None if parts.username is None else unquote(parts.username),
            None if parts.password is None else unquote(parts.password),
            tls,
            **files,
        )


def without_password(url: str) -> str:
    """Removes the password from a link, so that it may be written to logs and recordings; also from
    a link inside other text, such as `--link=mqtt://...`."""
    return _PASSWORD.sub(r"\1:***@", url)


CONNECT_SECONDS = 5.0
# Silence after which a connection with a session is given up, s.
KEPT_ALIVE_SECONDS = 60
MAX_WAITING_BYTES = 2**22  # of the messages that have come and wait at most
# Largest message, bytes; the broker does not deliver larger ones (MQTT 5, maximum packet size).
MAX_MESSAGE_BYTES = 2 * PACKET_BYTES

log = logging.getLogger("jaxtwin.live")


@final
class MqttTransport:
    """A link through a broker: it reads messages from `TOPIC/up` and publishes on `TOPIC/down`.

    **Arguments:**

    - `address`: the address of the broker, with the topic.
    - `reads`, `writes`: the two topics below that topic.

    **Raises:** `OSError` if the broker cannot be reached, `LinkError` without paho-mqtt.
    """

    def __init__(self, address: MqttAddress, *, reads: str = "up", writes: str = "down"):
        topic = address.topic
        self._inbox: queue.Queue[bytes] = queue.Queue()
        self._lost = False
        self._waiting = 0  # bytes
        self._reads, self._writes = f"{topic}/{reads}", f"{topic}/{writes}"
        self._client = mqtt_client(address, reconnect=False)  # the link does that
        ready = threading.Event()

        def on_connect(client: Any, *_: Any) -> None:
            client.subscribe(self._reads, qos=1)

        def on_subscribe(*_: Any) -> None:
            ready.set()

        def on_disconnect(*_: Any) -> None:
            self._lost = True

        def on_message(_client: Any, _userdata: Any, message: Any) -> None:
            if message.retain:
                log.warning("%s: a retained message is passed over", message.topic)
                return
            # If the queue is full the message is lost, which the sequence numbers show.
            if self._waiting + len(message.payload) <= MAX_WAITING_BYTES:
                self._inbox.put_nowait(message.payload)
                self._waiting += len(message.payload)

        self._client.on_connect, self._client.on_subscribe = on_connect, on_subscribe
        self._client.on_disconnect, self._client.on_message = on_disconnect, on_message
        connect_client(self._client, address)
        self._client.loop_start()
        if not ready.wait(CONNECT_SECONDS):
            self.close()
            raise TimeoutError(
                f"the broker {address.host}:{address.port} does not answer, or refuses"
            )

    def read(self) -> bytes:
        if self._lost:
            raise ConnectionResetError("the broker is gone")
        try:
            first = self._inbox.get(timeout=READ_SECONDS)
        except queue.Empty:
            return b""
        self._waiting -= len(first)
        return first + self.waiting()

    def waiting(self) -> bytes:
        """The bytes that have arrived."""
        parts = []
        with contextlib.suppress(queue.Empty):
            while True:
                parts.append(self._inbox.get_nowait())
                self._waiting -= len(parts[-1])
        return b"".join(parts)

    def write(self, data: bytes) -> None:
        if self._lost:
            raise ConnectionResetError("the broker is gone")
        self._client.publish(self._writes, data, qos=1)

    def close(self) -> None:
        close_client(self._client)


def mqtt_client(address: MqttAddress, *, reconnect: bool, session: str = "") -> Any:
    """A client of a broker that is not connected yet.

    **Arguments:**

    - `session`: the name of a session that outlives the connection; its client acknowledges each
      message itself, by `client.ack`. `""`: there is none.

    **Raises:** `LinkError` without paho-mqtt.
    """
    try:
        from paho.mqtt.client import Client, MQTTv5
        from paho.mqtt.enums import CallbackAPIVersion
    except ImportError:
        raise LinkError(
            "mqtt:// needs paho-mqtt: pip install 'jaxtwin[mqtt]', in a checkout "
            "pip install -e '.[mqtt]'"
        ) from None
    client = Client(
        CallbackAPIVersion.VERSION2,
        client_id=session,
        protocol=MQTTv5,
        reconnect_on_failure=reconnect,
        manual_ack=bool(session),
    )
    if address.user is not None:
        client.username_pw_set(address.user, address.password)
    if address.tls:
        client.tls_set(address.ca, address.cert, address.key)
    return client


def close_client(client: Any) -> None:
    """Ends a connection, and closes the sockets by which a client wakes itself: paho-mqtt leaves
    them to the garbage collector, unless the client begins anew."""
    client.disconnect()
    client.loop_stop()
    client.reinitialise()


def connect_client(client: Any, address: MqttAddress, *, kept: int = 0) -> None:
    """Connects a client.

    **Arguments:**

    - `kept`: for how long the broker keeps its session, and the messages for it, after a connection
      was lost, s; 0: it has none.

    **Raises:** `OSError` if the broker cannot be reached.
    """
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.properties import Properties

    properties = Properties(PacketTypes.CONNECT)
    properties.MaximumPacketSize = MAX_MESSAGE_BYTES
    properties.SessionExpiryInterval = kept
    # Who keeps a session has time: its broker loses nothing meanwhile.
    keepalive = KEPT_ALIVE_SECONDS if kept else 10
    client.connect(
        address.host, address.port, keepalive, clean_start=not kept, properties=properties
    )
