"""Records and findings as JSON for the subscribers of an MQTT broker."""

import json
from typing import Any, final

from ..errors import LinkError
from ..rig import Rig
from ._json import finding_as_json, record_as_json
from .protocol._mqtt_address import MqttAddress, without_password
from .protocol._mqtt_transport import connect_client, mqtt_client
from .protocol._records import Record
from .protocol._rig_state import RigState
from .safety._interlock import Finding

# The kinds of records that are published -> the topics below that of the rig.
TOPICS = {"reading": "readings", "duty": "duty", "event": "events", "estimate": "estimates"}


# The messages that wait at most while the broker is away: a quarter of an hour of a camera's rig.
MAX_QUEUED = 20_000


@final
class Publisher:
    """Publishes records as JSON: `TOPIC/readings`, `TOPIC/duty`, `TOPIC/events`. It consumes the
    records of a source. What does not come from there is sent to it: estimates of an observer
    (`TOPIC/estimates`) and findings (`TOPIC/findings`).

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

    def _publish(self, topic: str, content: dict[str, Any]) -> None:
        self._client.publish(f"{self._topic}/{topic}", json.dumps(content), qos=1)

    def close(self) -> None:
        """Ends the connection."""
        self._client.disconnect()
        self._client.loop_stop()
