"""A device that simulates a rig behind the protocol, including faults.

It performs no input or output and reads no clock: `receive` and `due` get bytes and time as
arguments. It can thus run behind TCP, behind a pseudo-terminal, or inside a test.
"""

import math
import secrets
from typing import final

import jax
import numpy as np

from ..._celsius import ZERO_CELSIUS
from ...errors import LinkError
from ...physics import Fault, Faults, Twin
from ...physics._recalibrations import Recalibrations
from ..protocol._codec import encode, parse
from ..protocol._framing import delines
from ..protocol._identity import Identity
from ..protocol._messages import (
    RECALIBRATING,
    VERSION,
    Ask,
    Data,
    Duty,
    Hello,
    Image,
    Message,
    Notice,
    Order,
)
from ..protocol._output_stage import Answer, OutputStage
from ._picture import VirtualPicture
from ._plant import Plant

# The device trips by itself if a channel is this far above the rig file's limit, K.
OVER_LIMIT = 10.0

# The longest time that a single call simulates, s of the rig. After a longer pause the rest is
# skipped.
MAX_BEHIND = 5.0


@final
class VirtualRig:
    """A device that measures and drives a twin.

    **Arguments:**

    - `twin`: the twin that it simulates.
    - `speed`: the seconds of the rig in a second.
    - `seed`: the seed of noise and faults; the same seed, boot and calls give the same bytes.
    - `camera_rate`, `controller_rate`: frames and controller samples per rig second. Without a
      camera the controller reads the sensors.
    - `faults`: the faults that it simulates.
    - `watchdog`: time without a duty command after which the cells are switched off, s of the host:
      0.1 to 5.
    - `boot`: names this start of the device; `None`: a new name.

    **Raises:** `SimulationError` if a fault names a part that the rig does not have;
    `LinkError` for recalibrations of a camera that it does not have, and for a device that every
    host would refuse, such as one with a watchdog of 20 s.
    """

    def __init__(
        self,
        twin: Twin,
        *,
        speed: float | int = 1.0,
        seed: int = 0,
        camera_rate: float | int = 9.0,
        controller_rate: float | int = 10.0,
        faults: Faults | None = None,
        watchdog: float | int = 2.0,
        boot: str | None = None,
    ):
        rig = twin.rig
        self.faults = faults or Faults()
        self._to_come = [(fault.time, fault.of(twin)) for fault in self.faults.rig]
        # The output stage runs in real time, because a watchdog counts real seconds.
        relay = "" if rig.limits is None else rig.limits.relay or ""
        self.stage = OutputStage(
            len(rig.driven), rig.driver.counts, float(watchdog), relay, len(rig.heaters)
        )
        self.twin = Plant(twin)
        with jax.enable_x64(True):
            for _, fault in self._to_come:
                fault(self.twin.system)  # compiles: nobody waits for messages yet
        self._driver = rig.driver
        self._random = np.random.default_rng(seed)
        self._noise = rig.noise
        self._twin, self._camera = twin, rig.camera
        camera, self._picture = rig.camera, None
        self._periods = {"data": 1 / controller_rate}
        if camera is not None:
            self._picture = VirtualPicture(twin, camera, self.twin.system)
            self._periods["image"] = 1 / camera_rate
        elif self.faults.jumps:
            raise LinkError(
                f"faults: jumps: expected 0 for a rig without a camera, got {self.faults.jumps:g}"
            )
        self._made = dict.fromkeys(self._periods, 0)
        self._seq = {"data": 0, "image": 0, "event": 0}
        self._start: int | None = None
        self._driven = self.stage.pwm
        self._hottest = (
            math.inf
            if rig.maximum_temperature is None
            else (rig.maximum_temperature - ZERO_CELSIUS + OVER_LIMIT)
        )
        self._rests: dict[object, bytes] = {}
        self._recalibrations = Recalibrations(self.faults.jumps, seed, rig.common_error)
        self._frozen: np.ndarray | None = None
        self._cuts = 0
        self._answer = b""
        self.hello = Hello(
            VERSION,
            rig.name,
            boot=boot or secrets.token_hex(4),
            cells=rig.driven,
            channels=() if camera else tuple(channel.name for channel in rig.channels),
            camera=camera and (camera.width, camera.height),
            counts=rig.driver.counts,
            watchdog=float(watchdog),
            rate=float(speed),
            relay=relay,
            heaters=tuple(heater.name for heater in rig.heaters),
        )
        if refusal := Identity.of(rig).refusal(self.hello):
            raise LinkError(f"virtual rig: {refusal}")

    @property
    def pwm(self) -> tuple[int, ...]:
        """Counts that are applied to the cells now."""
        return self.stage.pwm

    @property
    def supplied(self) -> tuple[int, ...]:
        """Counts by which the cells are heated now: 0 behind an open relay."""
        return self.pwm if self.stage.supplied else (0,) * len(self.pwm)

    def connected(self, client: object = None) -> bytes:
        """Returns the greeting of a new connection; `client` is its name."""
        self._rests[client] = b""
        return encode(self.hello)

    def disconnected(self, client: object) -> None:
        """Registers that a connection has ended."""
        self._rests.pop(client, None)

    def receive(self, data: bytes, client: object = None) -> bool:
        """Handles bytes from a host. Bytes that are not a command for this rig are ignored.

        **Returns:** whether there was a message among them.
        """
        # Each host has a separate remainder, so that its incomplete line does not mix with others.
        lines, self._rests[client] = delines(self._rests.get(client, b""), data)
        understood = False
        for frame in lines:
            try:
                message = parse(frame)
            except LinkError:
                continue
            if isinstance(message, Ask):
                understood = True
                self._answer += encode(self.hello)
            elif isinstance(message, Duty | Order):
                understood = True
                answer = self.stage.obey(message, self.twin.time / self.hello.rate)
                if answer is not None:
                    self._answer += self._notice(answer, message)
                self._follow()
        return understood

    def due(self, now: int) -> bytes:
        """Advances the rig to host time `now`, ns. Returns the bytes that it sends meanwhile."""
        if self._start is None:
            self._start = now
        rate = self.hello.rate
        until = (now - self._start) * 1e-9 * rate
        for stream, period in self._periods.items():
            self._made[stream] = max(self._made[stream], int((until - MAX_BEHIND * rate) / period))
        sent, self._answer = [self._answer], b""
        while True:
            # Multiples of the period: sums of it would drift.
            due = {name: made * self._periods[name] for name, made in self._made.items()}
            stream = min(due, key=lambda name: due[name])
            time = due[stream]
            if time > until:
                break
            self._made[stream] += 1
            sent += self._advance(time)
            sent.append(self._message(stream, time))
        return b"".join(sent)

    def cuts_connection(self) -> bool:
        """Whether the connection is to be cut now, a fault; true once for each."""
        if not self.faults.disconnect:
            return False
        cuts = int(self.twin.time / self.faults.disconnect)
        self._cuts, due = cuts, cuts > self._cuts
        return due

    def _advance(self, time: float) -> list[bytes]:
        """Advances physics, watchdog and slow faults to a time."""
        self.twin.advance(time)
        for begin, fault in list(self._to_come):
            if time >= begin:
                self._to_come.remove((begin, fault))
                self._replace(fault)
        self._recalibrations.advance(time)
        answer = self.stage.on_time(time / self.hello.rate)
        if any(self.pwm) and self.twin.temperatures.max() > self._hottest:
            answer = self.stage.trip("over-temperature")
        self._follow()
        return [] if answer is None else [self._notice(answer)]

    def _replace(self, fault: Fault) -> None:
        """Goes on with a faulty rig; its picture shows the channels as they are then."""
        with jax.enable_x64(True):
            self.twin.replace(fault(self.twin.system))
        if self._camera is not None:
            self._picture = VirtualPicture(self._twin, self._camera, self.twin.system)

    def _notice(self, answer: Answer, about: Duty | Order | None = None) -> bytes:
        kind, why = answer
        stamp = self._count("event"), _us(self.twin.time)
        if about is None:
            return self._sent(Notice(*stamp, kind, why=why))
        return self._sent(Notice(*stamp, kind, about.owner, about.number, why))

    def _follow(self) -> None:
        """Applies the counts of the output stage to the cells."""
        if self.supplied != self._driven:
            self._driven = self.supplied
            self.twin.drive(self._driver.duty(self._driven))

    def _message(self, stream: str, time: float) -> bytes:
        seq = self._count(stream)
        if stream == "data":
            ambient = round(self.twin.ambient, 2)
            stage = self.stage
            data = Data(
                seq,
                _us(time),
                stage.pwm,
                ambient,
                self._sensors(),
                owner=stage.owner,
                number=stage.number,
                trip=stage.trip_reason,
                relay=("on" if stage.supplied else "off") * bool(self.hello.relay),
            )
            return self._sent(data)
        assert self._picture is not None
        closed = self._recalibrations.is_closed(time)
        if not closed or self._frozen is None:
            offset = self._recalibrations.offset(time)
            shape = (self.hello.camera or (1, 1))[::-1]
            error = offset + self._random.normal(0, self._noise, shape)
            self._frozen = self._picture.frame(self.twin.nodes, self.twin.ambient, error)
        return self._sent(Image(seq, _us(time), RECALIBRATING * closed, self._frozen))

    def _sensors(self) -> tuple[float, ...]:
        """Readings of point sensors, degC; empty for a rig with a camera."""
        if self._picture is not None:
            return ()
        exact = np.asarray(self.twin.temperatures)
        return tuple((exact + self._random.normal(0, self._noise, exact.shape)).tolist())

    def _count(self, stream: str) -> int:
        number = self._seq[stream]
        self._seq[stream] = (number + 1) % 2**32
        return number

    def _sent(self, message: Message) -> bytes:
        """Returns the bytes of a message as a device with these faults sends them."""
        faults, random = self.faults, self._random
        if faults.stall:
            every, length = faults.stall
            if self.twin.time >= every and self.twin.time % every < length:
                return b""
        if faults.drop and random.random() < faults.drop:
            return b""
        data = encode(message)
        if faults.corrupt and random.random() < faults.corrupt:
            damaged = bytearray(data)
            for place in random.integers(len(data), size=random.integers(1, 5)):
                damaged[place] = random.integers(256)
            return bytes(damaged)
        return data


def _us(time: float) -> int:
    return round(time * 1e6)
