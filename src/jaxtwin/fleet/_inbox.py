"""The messages of a fleet from its broker, acknowledged when the journal has them."""

import logging
import re
import time
from collections import Counter
from typing import Any, NamedTuple, final

from ..live import CONNECT_SECONDS, close_client, connect_client, mqtt_client
from ._fleet_file import FleetFile
from ._sample_queue import Kind

KINDS: tuple[Kind, ...] = ("readings", "duty")

# For how long a broker keeps messages for a fleet that is away, s.
SESSION_SECONDS = 7 * 86_400

# The number of alerts that wait at most while the broker is away.
MAX_ALERTS = 1000

# The number of messages that are taken at a time.
MAX_TAKEN = 2000

# A rig that sends more messages in this time, s, than this number of times those that it has to is
# not listened to for `MUTED_SECONDS`: what it sends would delay those of all others.
FLOOD_SECONDS = 10.0
FLOOD_MULTIPLE = 100.0
MUTED_SECONDS = 60.0

# For this time after a connection a broker hands over what it has kept, which is no flood, s.
GRACE_SECONDS = 60.0

# The time between two attempts to connect, s.
AGAIN_SECONDS = 2.0

log = logging.getLogger("jaxtwin.fleet")


class Received(NamedTuple):
    """A message, and what acknowledges it."""

    rig: str
    kind: Kind
    payload: bytes
    mid: int
    qos: int


@final
class Inbox:
    """Reads the topics of rigs from a broker, in a session that outlives this process.

    There is no thread: `receive` reads, so that the broker keeps what nobody has time for.

    **Arguments:**

    - `file`: the file of the fleet.
    - `session`: the name of the session.

    **Raises:** `LinkError` without paho-mqtt.
    """

    def __init__(self, file: FleetFile, session: str):
        self.is_connected = False
        """Whether the broker is there."""
        self.problem = ""
        """Why it is not."""
        self.muted: dict[str, float] = {}
        """Rig that floods -> when it is listened to again, s of the monotonic clock."""
        self._file, self._address = file, file.broker
        self._taken: list[Received] = []
        self._wanted: dict[str, float] = {}
        self._tried = -AGAIN_SECONDS
        self._counts: Counter[str] = Counter()
        self._counted = self._connected = time.monotonic()
        levels = re.escape(file.topic("{rig}", "")).replace(re.escape("{rig}"), "([^/]+)")
        self._pattern = re.compile(f"{levels}({'|'.join(KINDS)})")
        self._client = mqtt_client(file.broker, reconnect=False, session=session)
        self._client.connect_timeout = CONNECT_SECONDS
        self._client.max_queued_messages_set(MAX_ALERTS)
        self._client.on_message = self._on_message
        self._client.on_connect = self._on_connect
        self._client.on_disconnect = self._on_disconnect

    def listen(self, rigs: dict[str, float]) -> None:
        """Listens to these rigs, each with the time between its readings, s, and to no others."""
        if self.is_connected:
            self._unsubscribe([rig for rig in self._wanted if rig not in rigs])
            self._subscribe([rig for rig in rigs if rig not in self._wanted])
        self._wanted = dict(rigs)

    def receive(self, seconds: float) -> list[Received]:
        """Waits for at most this time, s, and returns what has come."""
        if self._client.socket() is None:
            self._connect(seconds)
        else:
            self._client.loop(seconds)
            count = -1
            while count < len(self._taken) < MAX_TAKEN:
                count = len(self._taken)
                self._client.loop(0.0)
        self._mute()
        taken, self._taken = self._taken, []
        return taken

    def acknowledge(self, messages: list[Received]) -> None:
        """Tells the broker that the journal has messages."""
        for message in messages:
            self._client.ack(message.mid, message.qos)

    def publish(self, topic: str, text: str) -> None:
        """Sends a message, such as an alarm, without waiting for it."""
        self._client.publish(topic, text, qos=1)

    def close(self) -> None:
        """Ends the connection. The broker keeps what comes."""
        self._client.on_disconnect = None
        close_client(self._client)

    def _connect(self, seconds: float) -> None:
        now = time.monotonic()
        if now - self._tried < AGAIN_SECONDS:
            time.sleep(min(seconds, AGAIN_SECONDS))
            return
        self._tried = now
        try:
            connect_client(self._client, self._address, kept=SESSION_SECONDS)
        except OSError as problem:
            self._lose(f"the broker cannot be reached: {problem}")

    def _on_connect(self, client: Any, _data: Any, _flags: Any, reason: Any, *_: Any) -> None:
        if reason.is_failure:
            self._lose(f"the broker refuses: {reason}")
            return
        self.is_connected, self.problem = True, ""
        self._connected = time.monotonic()
        self._subscribe(list(self._wanted))

    def _on_disconnect(self, *_: Any) -> None:
        self._lose("the broker is gone")

    def _lose(self, why: str) -> None:
        if why != self.problem:
            log.warning("%s:%d: %s", self._address.host, self._address.port, why)
        self.is_connected, self.problem = False, why

    def _on_message(self, client: Any, _data: Any, message: Any) -> None:
        parts = self._pattern.fullmatch(message.topic)
        if parts is None or message.retain or parts[1] not in self._wanted:
            client.ack(message.mid, message.qos)  # of a rig that was taken away
            return
        self._counts[parts[1]] += 1
        kind: Any = parts[2]
        self._taken.append(Received(parts[1], kind, message.payload, message.mid, message.qos))

    def _mute(self) -> None:
        now = time.monotonic()
        for rig, until in list(self.muted.items()):
            if now >= until:
                del self.muted[rig]
                self._subscribe([rig] if rig in self._wanted else [])
        passed = now - self._counted
        is_grace = now - self._connected < GRACE_SECONDS
        for rig, count in self._counts.items():
            allowed = FLOOD_MULTIPLE * FLOOD_SECONDS / self._wanted.get(rig, 1.0)
            if count > allowed and not is_grace and rig not in self.muted:
                log.warning("%s sends %d messages in %.0f s", rig, count, passed)
                self.muted[rig] = now + MUTED_SECONDS
                self._unsubscribe([rig])
        if passed >= FLOOD_SECONDS:
            self._counts.clear()
            self._counted = now

    def _subscribe(self, rigs: list[str]) -> None:
        topics = [
            (topic, 1) for rig in rigs if rig not in self.muted for topic in self._topics(rig)
        ]
        for start in range(0, len(topics), 500):
            self._client.subscribe(topics[start : start + 500])

    def _unsubscribe(self, rigs: list[str]) -> None:
        topics = [topic for rig in rigs for topic in self._topics(rig)]
        for start in range(0, len(topics), 500):
            self._client.unsubscribe(topics[start : start + 500])

    def _topics(self, rig: str) -> list[str]:
        return [self._file.topic(rig, kind) for kind in KINDS]
