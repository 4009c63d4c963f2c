"""Records and findings as JSON for the subscribers of an MQTT broker."""

import json
import logging
import threading
from collections.abc import Callable
from typing import Any, final

from ..errors import LinkError
from ..rig import Rig
from ._json import finding_as_json, record_as_json
from .protocol._mqtt_transport import (
    CONNECT_SECONDS,
    MqttAddress,
    close_client,
    connect_client,
    mqtt_client,
    without_password,
)
from .protocol._records import Record
from .protocol._rig_state import RigState
from .safety._interlock import Finding

# The kinds of records that are published -> the topics below that of the rig.
TOPICS = {"reading": "readings", "duty": "duty", "event": "events", "estimate": "estimates"}


log = logging.getLogger("jaxtwin.live")

# The messages that wait at most while the broker is away: a quarter of an hour of a camera's rig.
MAX_QUEUED = 20_000


@final
class Publisher:
    """Publishes records as JSON: `TOPIC/readings`, `TOPIC/duty`, `TOPIC/events`. It consumes the
    records of a source. What does not come from there is sent to it: estimates of an observer
    (`TOPIC/estimates`), findings (`TOPIC/findings`), and what a page says of its store.

    If the broker is slow, messages are lost here, but never in the recording. Otherwise each is
    delivered at least once, also to a subscriber with a persistent session that comes back.

    **Arguments:**

    - `url`: `mqtt://host:port/topic`, as for `MqttAddress`.
    - `rig`: the rig, whose channels and cells name the numbers.

    **Raises:** `LinkError` if the broker cannot be reached.
    """

    def __init__(self, url: str, rig: Rig):
        address = MqttAddress.parse(url)
        self._topic, self._rig = address.topic, rig
        self._client = mqtt_client(address, reconnect=True)
        self._client.max_queued_messages_set(MAX_QUEUED)
        self._topics: list[str] = []
        self._connected, self._answered = threading.Event(), threading.Condition()
        self._is_allowed: dict[int, bool] = {}  # by the numbers of the subscriptions
        self._client.on_connect = self._on_connect  # also after the broker was away
        self._client.on_subscribe = self._on_subscribe
        try:
            connect_client(self._client, address)
        except OSError as error:
            raise LinkError(f"{without_password(url)}: {error}") from None
        self._client.loop_start()

    def on_record(self, record: Record, state: RigState) -> None:
        """Sends a record to the broker without waiting for it."""
        self.send(record)

    def on_time(self, state: RigState, now: int) -> None:
        """Does nothing: what is published are records."""

    def send(self, record: Record) -> None:
        """Sends a record, such as a `StateEstimate`."""
        content = record_as_json(record, self._rig)
        topic = TOPICS.get(content.pop("kind"))
        if topic is not None:
            self._publish(topic, content)

    def send_finding(self, finding: Finding) -> None:
        """Sends a finding of an alarm or of a monitor."""
        self._publish("findings", finding_as_json(finding))

    def send_log(self, level: str, text: str) -> None:
        """Sends a line of the log of a page (`TOPIC/log`)."""
        self._publish("log", {"level": level, "text": text})

    def send_answer(self, order: str, obeyed: bool, text: str) -> None:
        """Sends what became of an order (`TOPIC/answers`)."""
        self._publish("answers", {"order": order, "obeyed": obeyed, "text": text})

    def subscribe(self, topic: str, heard: Callable[[bytes], object]) -> None:
        """Calls `heard` with each message on a topic below that of the rig, in the thread of the
        client. Retained messages are passed over: an order counts once, when it is given.

        **Raises:** `LinkError` if the broker does not allow it, or does not answer.
        """
        topic = f"{self._topic}/{topic}"

        def on_message(_client: Any, _userdata: Any, message: Any) -> None:
            if message.retain:
                log.warning("%s: a retained message is passed over", message.topic)
            else:
                heard(message.payload)

        self._client.message_callback_add(topic, on_message)
        self._topics.append(topic)
        if self._connected.wait(CONNECT_SECONDS):
            _, number = self._client.subscribe(topic, qos=1)
            with self._answered:
                self._answered.wait_for(lambda: number in self._is_allowed, CONNECT_SECONDS)
                if self._is_allowed.get(number, False):
                    return
        raise LinkError(f"{topic}: the broker refuses to send what is published there")

    def _on_connect(self, client: Any, *_: Any) -> None:
        self._connected.set()
        for topic in self._topics:
            client.subscribe(topic, qos=1)

    def _on_subscribe(self, _client: Any, _userdata: Any, number: int, codes: Any, _: Any) -> None:
        with self._answered:
            self._is_allowed[number] = not any(code.is_failure for code in codes)
            self._answered.notify_all()

    def _publish(self, topic: str, content: dict[str, Any]) -> None:
        self._client.publish(f"{self._topic}/{topic}", json.dumps(content), qos=1)

    def close(self) -> None:
        """Ends the connection."""
        close_client(self._client)
