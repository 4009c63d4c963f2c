"""Turns the bytes of a link into records: each message once, with the gaps between them."""

import logging
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import fields, replace
from typing import final

import numpy as np

from ...errors import LinkError
from ._clock import seconds
from ._codec import parse
from ._framing import deframe
from ._identity import Identity
from ._link import Arrived
from ._message_counts import Counters, MessageCounts
from ._messages import RECALIBRATING, Beat, Data, Hello, Image, Notice
from ._records import (
    Event,
    Gap,
    Greeting,
    LinkChange,
    LinkState,
    Reading,
    Record,
    Sample,
    Stream,
)

# Number of bytes without a valid message after which a device is disconnected: about those of three
# damaged camera frames, or of a serial line with the wrong baud rate for 15 s.
MAX_GARBAGE = 200_000

# The number of messages in a second above which a device is disconnected.
MAX_MESSAGES = 20_000

# Number of implausible messages that are logged for a connection.
MAX_REPORTED = 20

_DIGITS = re.compile("[0-9.]+")

log = logging.getLogger("jaxtwin.live")


@final
class Receiver:
    """Turns the bytes of a link into records. It has no thread, and no clock but arrival times.

    Messages before a greeting that fits the rig are ignored. Each stream of a device has sequence
    numbers: a repeated message is dropped, missing ones become a `Gap`. The numbers continue after
    a lost connection, and begin again with a new start (`boot`) of the device.

    **Arguments:**

    - `link`: the name of the link.
    - `identity`: the rig to which the device must belong.
    - `stale_after`: silence after which the link is stale, s. After three times this silence it
        should be closed, because a lost connection may show no other sign.
    - `counted`: the last messages of its devices that were counted in an earlier run.
    - `conflict`: the reason why a device that greets cannot belong to the rig beside those on other
      links; None if it can.
    """

    def __init__(
        self,
        link: str,
        identity: Identity,
        *,
        stale_after: float | int = 2.0,
        counted: Counters | None = None,
        conflict: Callable[[Hello], str | None] = lambda hello: None,
    ):
        self.state = LinkState.DOWN
        self.hello: Hello | None = None
        self.verdict: str | None = None
        """The reason why the device should be disconnected; `None` if it should not."""
        self.refused: str | None = None
        """The reason why the last greeting was refused; `None` once a greeting was accepted."""
        self.last_valid = 0
        self._link = link
        self._identity = identity
        self._conflict = conflict
        self._stale_after = stale_after
        self._rest = b""
        self._greeting: Hello | None = None  # of this connection, as it was sent
        self._garbage = 0
        self._second = self._messages = 0
        self._counts = MessageCounts(counted)
        self._recalibrating = False
        self._reported: set[str] = set()
        self._faults: dict[int, str] = {}
        self._relay = ""

    def changed(self, change: LinkChange) -> list[Record]:
        """Returns the records that follow when the link is opened or lost."""
        self.state = change.state
        self._rest, self.hello, self.verdict = b"", None, None
        self._greeting = None
        self._garbage = 0
        self._reported.clear()
        self.last_valid = change.arrival
        return [change]

    def receive(self, arrived: Arrived) -> list[Record]:
        """Returns the records in the bytes that arrived."""
        if self.verdict is not None:
            return []
        arrival = arrived.arrival
        frames, self._rest, discarded = deframe(self._rest, arrived.data)
        records: list[Record] = []
        counts: Counter[str] = Counter()
        why = ""
        for frame in frames:
            try:
                new = self._accept(frame, arrival, counts)
            except LinkError as error:
                counts["nonsense"] += 1
                discarded += len(frame)
                why = str(error)
                self._log_once(why)
                continue
            records += new
            self._garbage = 0
            if self.verdict is not None:
                break
            self.last_valid = arrival
            if self.hello is not None and self.state is not LinkState.LIVE:
                self.state = LinkState.LIVE
                records.append(LinkChange(self._link, arrival, LinkState.LIVE, ""))
        if discarded:
            self._garbage += discarded
            records.append(Event(self._link, arrival, "garbage", f"{discarded} bytes"))
        for kind, number in counts.items():
            detail = f"{number}: {why}" if kind == "nonsense" else str(number)
            records.append(Event(self._link, arrival, kind, detail))
        self._judge(arrival, len(frames))
        return records

    def on_time(self, now: int) -> list[Record]:
        """Checks for silence at host time `now`, ns, after all arrived bytes were received."""
        silent = seconds(now - self.last_valid)
        if self.state is LinkState.DOWN or silent <= self._stale_after:
            return []
        if silent > 3 * self._stale_after and self.verdict is None:
            self.verdict = f"silent for {silent:.1f} s"
        if self.state is not LinkState.LIVE:
            return []
        self.state = LinkState.STALE
        return [LinkChange(self._link, now, LinkState.STALE, f"silent for {silent:.1f} s")]

    def _accept(self, frame: str | bytes, arrival: int, counts: Counter[str]) -> list[Record]:
        message = parse(frame)
        if isinstance(message, Hello):
            return self._greeted(message, arrival)
        hello = self.hello
        if hello is None or isinstance(message, Beat):
            return []
        match message:
            case Data():
                _check_data(message, hello)
                stream: Stream = "data"
            case Image():
                if message.pixels.shape[::-1] != hello.camera:
                    raise LinkError(f"an image of {message.pixels.shape[::-1]} pixels (w, h)")
                stream = "image"
            case Notice():
                stream = "event"
            case _:
                raise LinkError("a host's message from a device")
        place = self._counts.place(hello.boot, stream, message.seq, message.device_us, arrival)
        if place is None:
            counts["duplicate"] += 1
            return []
        records: list[Record] = []
        if place.boot != hello.boot:
            self.hello = hello = replace(hello, boot=place.boot)
            stepped = Event(self._link, arrival, "device-clock-step", "", message.device_us)
            records += [stepped, Greeting(self._link, arrival, hello)]
        if place.missing:
            records.append(Gap(self._link, arrival, stream, place.first, place.missing))
        return records + self._records(message, hello, arrival)

    def _greeted(self, hello: Hello, arrival: int) -> list[Record]:
        refusal = self._identity.refusal(hello) or self._change(hello) or self._conflict(hello)
        self.refused = refusal
        if refusal is not None:
            self.verdict = refusal
            return [Event(self._link, arrival, "refused", refusal)]
        self._greeting = hello
        hello = replace(hello, boot=self._counts.begin(hello.boot, hello.rate))
        if self.hello == hello:
            return []
        self.hello = hello
        return [Greeting(self._link, arrival, hello)]

    def _change(self, hello: Hello) -> str | None:
        """The reason why a device cannot have greeted so after its first greeting of this
        connection: only a restart changes what a device is."""
        before = self._greeting
        if before is None or before.boot != hello.boot:
            return None
        for field in fields(hello):
            was, now = getattr(before, field.name), getattr(hello, field.name)
            if was != now:
                return f"{field.name}: expected {was} until a restart (another boot), got {now}"
        return None

    def _records(self, message: Data | Image | Notice, hello: Hello, arrival: int) -> list[Record]:
        link, boot = self._link, hello.boot
        seq, device_us = message.seq, message.device_us
        match message:
            case Notice():
                return [
                    Event(
                        link,
                        arrival,
                        f"device/{message.kind}",
                        _detail(message),
                        device_us,
                        seq,
                    )
                ]
            case Data():
                records = self._relay_changed(message.relay, arrival, device_us)
                records.append(
                    Sample(
                        link,
                        boot,
                        arrival,
                        device_us,
                        seq,
                        message.pwm,
                        message.ambient,
                        message.owner,
                        message.number,
                        message.trip,
                        message.relay,
                    )
                )
                if message.temperatures:
                    values = np.array(message.temperatures)
                    faults = message.faults
                    records += self._faults_changed(faults, arrival, device_us)
                    records.append(
                        Reading(link, boot, arrival, device_us, seq, values, False, None, faults)
                    )
                return records
            case Image():
                flag = bool(message.flags & RECALIBRATING)
                values = self._identity.temperatures(message.pixels)
                reading = Reading(link, boot, arrival, device_us, seq, values, flag, message.pixels)
                if flag == self._recalibrating:
                    return [reading]
                self._recalibrating = flag
                kind = "recalibration-start" if flag else "recalibration-end"
                return [Event(link, arrival, kind, "", device_us), reading]

    def _faults_changed(self, faults: dict[int, str], arrival: int, device_us: int) -> list[Record]:
        """An event if the failed channels, or the reasons of their failures, have changed."""
        if faults == self._faults:
            return []
        self._faults = faults
        names = self._identity.channels
        detail = ", ".join(f"{names[place]} {why}" for place, why in faults.items())
        kind = "channel-fault" if faults else "channels-work"
        return [Event(self._link, arrival, kind, detail, device_us)]

    def _relay_changed(self, relay: str, arrival: int, device_us: int) -> list[Record]:
        """An event if the relay in the supply has been opened or closed."""
        if relay == self._relay:
            return []
        self._relay = relay
        return [Event(self._link, arrival, "relay", relay or "none", device_us)]

    def _log_once(self, why: str) -> None:
        """Logs each reason once for a connection, because a faulty device repeats its error."""
        reason = _DIGITS.sub("", why.rpartition(":")[2])
        if reason not in self._reported and len(self._reported) < MAX_REPORTED:
            self._reported.add(reason)
            log.warning("%s: %s", self._link, why)

    def _judge(self, arrival: int, messages: int) -> None:
        if self._garbage > MAX_GARBAGE:
            self.verdict = f"{self._garbage} bytes without a valid message"
        if arrival // 10**9 != self._second:
            self._second, self._messages = arrival // 10**9, 0
        self._messages += messages
        if self._messages > MAX_MESSAGES:
            self.verdict = f"more than {MAX_MESSAGES} messages in a second"


def _detail(notice: Notice) -> str:
    """The command to which a notice refers, as text."""
    words = [f"of {notice.owner}"] if notice.owner else []
    words += [f"command {notice.number}"] if notice.number is not None else []
    return ", ".join(words + ([notice.why] if notice.why else []))


def _check_data(message: Data, hello: Hello) -> None:
    if len(message.pwm) != len(hello.cells):
        raise LinkError(f"expected counts for {len(hello.cells)} cells, got {len(message.pwm)}")
    for cell, count in enumerate(message.pwm):
        if not hello.lowest(cell) <= count <= hello.counts:
            raise LinkError(
                f"expected counts from {hello.lowest(cell)} to {hello.counts} of "
                f"{hello.cells[cell]}, got {message.pwm}"
            )
    # Without new readings there are none: those of the last sample would look frozen.
    if len(message.temperatures) not in (0, len(hello.channels)):
        raise LinkError(
            f"expected temperatures of {len(hello.channels)} channels, got "
            f"{len(message.temperatures)}"
        )
