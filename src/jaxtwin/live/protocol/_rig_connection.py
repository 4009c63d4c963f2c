"""The connection to a rig: all its links, one stream of records, which the journal gets first."""

import queue
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Literal, Protocol, final, runtime_checkable

from ...errors import JaxtwinError, LinkError
from ...rig import Rig
from ._clock import Clock, SystemClock
from ._codec import encode
from ._identity import Identity
from ._link import INBOX, Arrived, Inbox, Link
from ._message_counts import Counters
from ._messages import VERSION, Ask, Duty, Hello, Order
from ._mqtt_transport import without_password
from ._opener import opener
from ._receiver import Receiver
from ._records import Command, Greeting, LinkState, Record
from ._transport import Opener

# Largest number of reads that are written to the journal together.
BATCH = 128

# Interval at which a device is asked for its greeting, s.
ASK_AGAIN = 1.0


# What a device of a rig may have, and no second device beside it.
_PARTS: Mapping[str, Callable[[Hello], object]] = {
    "cells": lambda hello: hello.cells,
    "temperatures": lambda hello: hello.channels or hello.camera,
    "relay": lambda hello: hello.relay,
}


@runtime_checkable
class Journal(Protocol):
    """An object that keeps the records, such as a `Recorder`."""

    def counted(self, link: str) -> Counters:
        """Returns, for each device of a link, the last message that has been recorded."""
        ...

    def write(self, records: Sequence[Record]) -> None:
        """Keeps the records. If it raises, the connection does not hand them on."""
        ...


@final
class RigConnection:
    """A live rig: records come out, duty commands go in.

    It is used as a context manager, which starts and closes the links:

    ```python
    with connect(rig, "socket://127.0.0.1:7000", journal=recorder) as connection:
        for record in connection: ...
    ```

    **Arguments:**

    - `rig`: which rig must be at the other end.
    - `links`: the name of each link -> a function that opens it.
    - `journal`: keeps the records before the connection hands them on.
    - `clock`: host time.
    - `stale_after`: the silence after which a link counts as stale, s.
    """

    def __init__(
        self,
        rig: Rig,
        links: Mapping[str, Opener],
        *,
        journal: Journal | None = None,
        clock: Clock | None = None,
        stale_after: float | int = 2.0,
    ):
        self.rig = rig
        """The rig at the other end."""
        self.clock: Clock = clock or SystemClock()
        identity = Identity.of(rig)
        self.relay = identity.relay
        """The name of the relay in the supply of the cells; `""` if the rig file names none."""
        self._inbox: Inbox = queue.Queue(INBOX)
        self._links = {
            name: Link(name, open_link, self._inbox, self.clock)
            for name, open_link in links.items()
        }
        self._receivers = {
            name: Receiver(
                name,
                identity,
                stale_after=stale_after,
                counted=None if journal is None else journal.counted(name),
                conflict=partial(self._conflict, name),
            )
            for name in links
        }
        self._asked = dict.fromkeys(links, 0)
        self._dropped: set[str] = set()
        # The links of devices that can switch off and got a duty, and whether they drive cells.
        self._driven: dict[str, bool] = {}
        self._journal = journal
        self._commands: list[Record] = []
        self._number = 0
        self.owner = secrets.token_hex(4)
        """The name under which this host commands; a device obeys a single host at a time. It is
        not a secret."""
        self.tap: Callable[[list[Record]], list[Record]] | None = None
        """Changes the records that `poll` returns, for a proof test; the journal gets the true
        ones."""
        self.ended = False
        """Whether the connection has been closed; a replay also ends by itself."""

    def __enter__(self) -> "RigConnection":
        for link in self._links.values():
            link.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self.close()
        except JaxtwinError:
            if kind is None:  # otherwise the first error is the one to show
                raise

    def __iter__(self) -> Iterator[Record]:
        """Records, until it is closed."""
        while not self.ended:
            yield from self.poll()

    @property
    def states(self) -> dict[str, LinkState]:
        """The state of each link."""
        return {name: receiver.state for name, receiver in self._receivers.items()}

    @property
    def refusals(self) -> dict[str, str]:
        """The links whose device was refused, with the reason."""
        return {
            name: why for name, receiver in self._receivers.items() if (why := receiver.refused)
        }

    @property
    def greetings(self) -> list[Greeting]:
        """The present greetings of the connected devices, for who begins to read now."""
        now = self.clock.now()
        return [
            Greeting(name, now, receiver.hello)
            for name, receiver in self._receivers.items()
            if receiver.hello is not None
        ]

    @property
    def driven(self) -> frozenset[str]:
        """The links whose device drives cells and got a duty since it was last released."""
        return frozenset(name for name, drives_cells in self._driven.items() if drives_cells)

    def drop_links(self, reason: str) -> None:
        """Closes all links, which are then opened again."""
        for link in self._links.values():
            link.drop(reason)

    def record_into(self, journal: Journal | None) -> None:
        """Continues in another journal, which first gets the greetings of the connected devices, or
        without one."""
        if journal is not None:
            journal.write(self.greetings)
        self._journal = journal

    def step_links(self) -> None:
        """Opens or reads each link once, in this thread instead of the links' own (see `Link`)."""
        for link in self._links.values():
            link.step()

    def poll(self, timeout: float | int = 0.1) -> list[Record]:
        """Returns the records since the last call, after waiting for at most `timeout` seconds.

        **Returns:** records that have been written to the journal.

        **Raises:** the errors of the journal; the records are then not handed on.
        """
        records = self._commands
        self._commands = []
        for item in self._arrived(timeout):
            receiver = self._receivers[item.link]
            records += (
                receiver.receive(item) if isinstance(item, Arrived) else receiver.changed(item)
            )
            if receiver.hello is not None and receiver.verdict is None:
                self._links[item.link].mark_valid()
        now = self.clock.now()
        for name, receiver in self._receivers.items():
            if self._inbox.empty():
                records += receiver.on_time(now)
            self._request_greeting(name, receiver, now)
        if self._journal is not None:
            self._journal.write(records)
        return records if self.tap is None else self.tap(records)

    def send_duty(self, pwm: tuple[int, ...]) -> bool:
        """Sends counts to every device that drives cells. Returns whether all were sent.

        The command is written to the journal at the next poll, so that a command to switch off does
        not wait for the disk.
        """
        return self._send(lambda number: Duty(number, pwm, self.owner), pwm, "duty")

    def send_order(self, kind: Literal["stop", "reset", "release"]) -> bool:
        """Sends a command without counts. Returns whether it was sent.

        A `stop` also opens the relay of the rig, by a command of its own. Both also reach a device
        that got a duty and whose greeting has been refused since, or has not arrived yet after a
        lost connection.
        """
        sent = self._send(lambda number: Order(kind, number, self.owner), (), kind)
        if kind != "stop" or not self.relay:
            return sent
        return self.open_relay() and sent

    def open_relay(self) -> bool:
        """Sends the command that opens the relay of the rig. Returns whether it was sent."""
        relay = self.relay
        return self._send(lambda number: Order("relay", number, self.owner, relay), (), "relay")

    @property
    def number(self) -> int:
        """The number of the last command; each command has a new number."""
        return self._number

    def note(self, record: Record) -> None:
        """Adds a record of the host, which the next poll writes to the journal and returns."""
        self._commands.append(record)

    def close(self) -> None:
        """Closes the links, and writes the records that have arrived to the journal."""
        self.ended = True
        for link in self._links.values():
            link.close()
        while not self._inbox.empty() or self._commands:
            self.poll(0.0)

    def _send(
        self, command: Callable[[int], Duty | Order], pwm: tuple[int, ...], kind: str
    ) -> bool:
        self._number = (self._number + 1) % 2**32
        sent, content = [], encode(command(self._number))
        for name, receiver in self._receivers.items():
            hello = receiver.hello
            if hello is not None and hello.switches and kind == "duty":
                self._driven[name] = bool(hello.cells)
            has = hello is not None and (hello.cells if kind == "duty" else hello.switches)
            if has or (kind in ("stop", "relay") and name in self._driven):
                sent.append(self._links[name].send(content))
                now = self.clock.now()
                self._commands.append(Command(name, now, self._number, pwm, self.owner, kind))
                if kind == "release":
                    self._driven.pop(name, None)
        return bool(sent) and all(sent)

    def _conflict(self, name: str, hello: Hello) -> str | None:
        """The reason why a device cannot greet on a link beside those that have greeted on others:
        each part of the rig has one device. Two that drive the cells could not both be switched off
        by what one of them reports, and of two that read the same channels one may be wrong."""
        for link, receiver in self._receivers.items():
            other = receiver.hello
            if link == name or other is None:
                continue
            for what, parts in _PARTS.items():
                if parts(hello) and parts(other):
                    return f"{what}: expected one device, got a second one beside that on {link}"
        return None

    def _arrived(self, timeout: float) -> Iterator:
        try:
            yield self._inbox.get(timeout=timeout) if timeout else self._inbox.get_nowait()
            for _ in range(BATCH - 1):
                yield self._inbox.get_nowait()
        except queue.Empty:
            return

    def _request_greeting(self, name: str, receiver: Receiver, now: int) -> None:
        link = self._links[name]
        if receiver.verdict is not None:
            if name not in self._dropped:  # once for each connection
                self._dropped.add(name)
                if name in self._driven:  # nobody could switch it off through a closed link
                    self.send_order("stop")
                link.drop(receiver.verdict)
            return
        self._dropped.discard(name)
        if (
            receiver.hello is None
            and receiver.state is not LinkState.DOWN
            and now - self._asked[name] > ASK_AGAIN * 1e9
        ):
            self._asked[name] = now
            link.send(encode(Ask(VERSION)))


def connect(
    rig: Rig,
    *urls: str,
    journal: Journal | None = None,
    baud: int = 115_200,
    clock: Clock | None = None,
) -> RigConnection:
    """Makes the connection to a rig behind one or several links, such as those of a controller and
    of a camera.

    **Arguments:**

    - `rig`: which rig must be at the other end.
    - `urls`: `socket://host:port`, `/dev/ttyACM0`, `rfc2217://host:port`, `mqtt://host/topic`, ...
    - `journal`: the journal, for example a `Recorder`.
    - `baud`: the baud rate of serial ports.
    - `clock`: host time.

    **Raises:** `LinkError` for an address of no known kind. If a device is not connected yet, the
    connection waits for it.
    """
    if not urls or len(set(urls)) < len(urls):
        raise LinkError(f"links: expected at least one, each once, got {urls}")
    # Names stand in recordings: no passwords.
    openers: dict[str, Callable] = {
        without_password(url): opener(url, rig, baud=baud) for url in urls
    }
    return RigConnection(rig, openers, journal=journal, clock=clock)
