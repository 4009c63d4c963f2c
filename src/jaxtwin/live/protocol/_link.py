"""One link: opened again without limit, and read by its own thread."""

import logging
import queue
import threading
from dataclasses import dataclass
from typing import final

from ._clock import Clock
from ._records import LinkChange, LinkState
from ._transport import Opener, Transport

# The pause after the first failure, s, and the longest pause. The pause doubles with each further
# failure.
FIRST_RETRY, LONGEST_RETRY = 0.1, 5.0

# A connection that was valid for this time, s, is opened again at once. A device that greets and
# then closes the connection is thus not opened ten times a second.
STABLE_SECONDS = 5.0

# Number of reads that may wait for the rig's connection. Beyond it the thread waits, and TCP lets
# the sender wait.
INBOX = 256

log = logging.getLogger("jaxtwin.live")


@final
@dataclass(frozen=True)
class Arrived:
    """Bytes that a link read at host time `arrival`, ns."""

    link: str
    arrival: int
    data: bytes


Inbox = queue.Queue[Arrived | LinkChange]


@final
class Link:
    """A connection to a device, opened again whenever it is lost.

    The thread opens, reads and closes, and does nothing else: no parsing, no waiting for a disk.
    It puts what it has read, and whether the link is open, into the inbox, in order. The connection
    parses the bytes; it calls `mark_valid` if they are valid and `drop` if they are not.

    **Arguments:**

    - `name`: the name in records and messages, for example the link's URL.
    - `open_transport`: opens a connection, or raises `OSError`.
    - `inbox`: the queue into which the link puts its bytes; several links may share it.
    - `clock`: host time.
    """

    def __init__(self, name: str, open_transport: Opener, inbox: Inbox, clock: Clock):
        self.name = name
        self._open = open_transport
        self._inbox = inbox
        self._clock = clock
        self._transport: Transport | None = None
        self._retry = FIRST_RETRY
        self._connected = 0
        self._drop: str | None = None
        self._reason: str | None = None  # why it is down
        self._logged: str | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"link {name}", daemon=True)

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    def close(self) -> None:
        """Ends the thread and the connection."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        self._end("closed here")

    def step(self) -> None:
        """Tries once to open the link, or reads it once. The thread repeats this."""
        transport = self._transport
        if transport is None:
            self._connect()
            return
        try:
            data = transport.read()
            if self._drop is not None:
                raise ConnectionAbortedError(self._drop)
        except OSError as error:
            self._end(_reason(error))
            self._pause()
            return
        if data:
            self._put(Arrived(self.name, self._clock.now(), data))

    def send(self, data: bytes) -> bool:
        """Sends bytes. Returns whether they were sent. A link that breaks here is opened again."""
        transport = self._transport
        if transport is None:
            return False
        try:
            transport.write(data)
        except OSError as error:
            self.drop(_reason(error))
            return False
        return True

    def mark_valid(self) -> None:
        """Registers that the other side sends valid messages. After a while of them, the next loss
        is followed by a quick retry."""
        if self._clock.now() - self._connected >= STABLE_SECONDS * 1e9:
            self._retry = FIRST_RETRY
            self._logged = None

    def drop(self, reason: str) -> None:
        """Makes the thread close the connection, because no other thread may close a connection
        that it reads."""
        self._drop = reason

    def _run(self) -> None:
        while not self._closing.is_set():
            self.step()

    def _connect(self) -> None:
        try:
            transport = self._open()
        except OSError as error:
            self._report(_reason(error))
            self._pause()
            return
        self._drop = self._reason = None
        self._connected = self._clock.now()
        self._put(LinkChange(self.name, self._clock.now(), LinkState.CONNECTING, ""))
        self._transport = transport

    def _pause(self) -> None:
        self._clock.wait(self._closing, self._retry)
        self._retry = min(2 * self._retry, LONGEST_RETRY)

    def _end(self, reason: str) -> None:
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.close()
            self._report(reason)

    def _report(self, reason: str) -> None:
        """Reports why the link is down, once and not for each further attempt."""
        if reason == self._reason:
            return
        self._reason = reason
        if reason != self._logged and not self._closing.is_set():
            log.warning("%s: down: %s", self.name, reason)
            self._logged = reason
        self._put(LinkChange(self.name, self._clock.now(), LinkState.DOWN, reason))

    def _put(self, item: Arrived | LinkChange) -> None:
        while True:
            try:
                self._inbox.put(item, timeout=0.2)
                return
            except queue.Full:
                if self._closing.is_set():
                    return


def _reason(error: OSError) -> str:
    return error.strerror or str(error) or type(error).__name__
