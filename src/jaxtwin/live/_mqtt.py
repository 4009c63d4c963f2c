"""MQTT: the protocol through a broker, and decoded records for whoever subscribes.

A broker carries the bytes of a link unchanged, device to host on `TOPIC/up` and host to device on
`TOPIC/down`, so all that holds for other links holds here: sequence numbers show what a broker
lost. Needs the extra `mqtt` (paho-mqtt).
"""

import contextlib
import json
import queue
import threading
from collections.abc import Sequence
from typing import Any, final
from urllib.parse import urlsplit

from .._errors import LinkError
from ._records import Event, Gap, Greeting, LinkChange, Reading, Record, Sample
from ._transport import READ_SECONDS

CONNECT_SECONDS = 5.0
WAITING = 1000  # messages that wait at most, coming and going


@final
class MqttTransport:
    """A link through a broker: what is published on `TOPIC/up` is read, `TOPIC/down` is written.

    **Raises:** `OSError` where the broker cannot be reached, `LinkError` without paho-mqtt.
    """

    def __init__(
        self, host: str, port: int, topic: str, *, reads: str = "up", writes: str = "down"
    ):
        self._inbox: queue.Queue[bytes] = queue.Queue(WAITING)
        self._lost = False
        self._reads, self._writes = f"{topic}/{reads}", f"{topic}/{writes}"
        self._client = _client(reconnect=False)  # the link does that
        ready = threading.Event()

        def on_connect(client: Any, *_: Any) -> None:
            client.subscribe(self._reads, qos=1)

        def on_subscribe(*_: Any) -> None:
            ready.set()

        def on_disconnect(*_: Any) -> None:
            self._lost = True

        def on_message(_client: Any, _userdata: Any, message: Any) -> None:
            # Full: what is lost here shows in the sequence numbers.
            with contextlib.suppress(queue.Full):
                self._inbox.put_nowait(message.payload)

        self._client.on_connect, self._client.on_subscribe = on_connect, on_subscribe
        self._client.on_disconnect, self._client.on_message = on_disconnect, on_message
        self._client.connect(host, port, keepalive=10)
        self._client.loop_start()
        if not ready.wait(CONNECT_SECONDS):
            self.close()
            raise TimeoutError(f"the broker {host}:{port} does not answer")

    def read(self) -> bytes:
        if self._lost:
            raise ConnectionResetError("the broker is gone")
        try:
            return self._inbox.get(timeout=READ_SECONDS) + self.waiting()
        except queue.Empty:
            return b""

    def waiting(self) -> bytes:
        """What is there already."""
        parts = []
        with contextlib.suppress(queue.Empty):
            while True:
                parts.append(self._inbox.get_nowait())
        return b"".join(parts)

    def write(self, data: bytes) -> None:
        if self._lost:
            raise ConnectionResetError("the broker is gone")
        self._client.publish(self._writes, data, qos=1)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


@final
class Publisher:
    """Publishes records as JSON: `TOPIC/readings`, `TOPIC/duty`, `TOPIC/events`.

    A view like any other: a slow broker loses messages here, never in the recording.

    **Arguments:**

    - `url`: `mqtt://host:port/topic`.
    - `channels`, `cells`: names of the columns.

    **Raises:** `LinkError` where the broker cannot be reached.
    """

    def __init__(self, url: str, channels: Sequence[str], cells: Sequence[str]):
        host, port, self._topic = mqtt_address(url)
        self._channels, self._cells = channels, cells
        self._client = _client(reconnect=True)
        self._client.max_queued_messages_set(WAITING)
        try:
            self._client.connect(host, port, keepalive=10)
        except OSError as error:
            raise LinkError(f"{url}: {error}") from None
        self._client.loop_start()

    def publish(self, records: Sequence[Record]) -> None:
        """Hands records to the broker; does not wait for it."""
        for record in records:
            topic, content = self._message(record)
            if topic:
                content["time"] = record.arrival * 1e-9
                self._client.publish(f"{self._topic}/{topic}", json.dumps(content), qos=0)

    def close(self) -> None:
        """Ends the connection."""
        self._client.disconnect()
        self._client.loop_stop()

    def _message(self, record: Record) -> tuple[str, dict[str, Any]]:
        match record:
            case Reading():
                values = [round(value, 3) for value in record.temperatures.tolist()]
                return "readings", dict(zip(self._channels, values, strict=True))
            case Sample():
                return "duty", dict(zip(self._cells, record.pwm, strict=True))
            case LinkChange():
                return "events", {"link": record.link, "state": str(record.state)}
            case Event() | Gap():
                kind = record.kind if isinstance(record, Event) else "gap"
                return "events", {"link": record.link, "kind": kind}
            case Greeting():
                return "events", {"link": record.link, "rig": record.hello.rig}
        return "", {}


def mqtt_address(url: str) -> tuple[str, int, str]:
    """Host, port and topic of `mqtt://host:port/topic`.

    **Raises:** `LinkError` where the text is something else.
    """
    parts = urlsplit(url)
    if parts.scheme != "mqtt" or not parts.hostname or not parts.path.strip("/"):
        raise LinkError(f"{url!r}: allowed is mqtt://host:port/topic")
    return parts.hostname, parts.port or 1883, parts.path.strip("/")


def _client(*, reconnect: bool) -> Any:
    try:
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion
    except ImportError:
        raise LinkError(
            "mqtt:// needs paho-mqtt: pip install 'jaxtwin[mqtt]', in a checkout "
            "pip install -e '.[mqtt]'"
        ) from None
    return Client(CallbackAPIVersion.VERSION2, reconnect_on_failure=reconnect)
