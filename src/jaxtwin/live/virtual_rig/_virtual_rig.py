"""A device that simulates a rig behind the protocol, including faults.

It performs no input or output and reads no clock: `receive` and `due` get bytes and time as
arguments. It can thus run behind TCP, behind a pseudo-terminal, or inside a test.
"""

import math
import secrets
from dataclasses import replace
from typing import final

import jax
import numpy as np
from jaxtyping import Float, UInt16

from ..._celsius import ZERO_CELSIUS
from ...errors import LinkError
from ...physics import Fault, Faults, Recalibrations, System, Twin, pixel_weights
from ...rig import Camera, Channel, NodesSensor, RelayWindow, Rig
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
from ._plant import Plant


@final
class VirtualPicture:
    """Renders frames of a twin, linear in its temperatures.

    A pixel is the mean by area of the plate elements, and of the surroundings, that it covers. The
    smallest correction (least squares) is added that makes each channel's mean equal to its
    reading, including its gain. It represents the uneven emissivity of the surface, of which only
    the means over the channels are known.
    """

    def __init__(self, twin: Twin, camera: Camera, system: System):
        rig = twin.rig
        self._shape = (camera.height, camera.width)
        elements = _elements(rig, camera)
        nodes = len(twin.netlist.nodes)
        plain = np.zeros((self._shape[0] * self._shape[1], nodes))
        plain[:, : elements.shape[1]] = elements
        means = pixel_weights(rig).reshape(len(rig.channels), -1)
        with jax.enable_x64(True):
            wanted = np.asarray(system.output_matrices()[0])
        spread = np.linalg.pinv(means)
        self._map = plain + spread @ (wanted - means @ plain)
        offset = np.zeros(len(means)) if system.offset is None else np.asarray(system.offset)
        self._offset = (spread @ offset).reshape(self._shape)

    def frame(
        self,
        nodes: Float[np.ndarray, " nodes"],
        ambient: float,
        error: Float[np.ndarray, "height width"] | float = 0.0,
    ) -> UInt16[np.ndarray, "height width"]:
        """Returns a frame in units of 0.01 K, for temperatures in degC and an error of the camera
        in K."""
        rise = (self._map @ (nodes - ambient)).reshape(self._shape)
        celsius = ambient + rise + self._offset + error
        return np.clip(np.rint((celsius + ZERO_CELSIUS) * 100), 0, 65535).astype(np.uint16)


def _elements(rig: Rig, camera: Camera) -> Float[np.ndarray, "pixels elements"]:
    """The fraction of each pixel that each element of the plate covers."""
    plate = rig.plate
    names = plate.element_names
    channels = tuple(Channel(name, NodesSensor((name,))) for name in names)
    shares = pixel_weights(replace(rig, channels=channels)).reshape(len(names), -1)
    x = (camera.view_x[1] - camera.view_x[0]) / plate.width
    y = (camera.view_y[1] - camera.view_y[0]) / plate.height
    extents = np.array([plate.extent(name) for name in names])
    areas = (extents[:, 1] - extents[:, 0]) * x * (extents[:, 3] - extents[:, 2]) * y
    return (shares * areas[:, None]).T


# Times that differ by less are the same, s.
ROUNDING = 1e-9


@final
class Relays:
    """The relays of all heaters of a rig that have one. Windows begin at the start of the device.

    A commanded duty takes effect with the next window. A device that nobody commands, or that has
    tripped, switches off at once, whatever the minimum times: these protect the relay, and off
    protects the rig.

    **Arguments:**

    - `rig`: the rig.
    """

    def __init__(self, rig: Rig):
        self._relays = {column: _Relay(relay) for column, relay in rig.relays.items()}

    def applied(
        self, duty: Float[np.ndarray, " cells"], time: float, *, is_off: bool
    ) -> Float[np.ndarray, " cells"]:
        """The duty of all cells and heaters from a time on, s, with 1 or 0 for those with a relay.

        **Arguments:**

        - `is_off`: whether all relays are to be off at once.
        """
        applied = np.array(duty, float)
        for column, relay in self._relays.items():
            applied[column] = relay.applied(float(duty[column]), time, is_off)
        return applied

    def next_switch(self, time: float) -> float:
        """The next time at which a relay may switch, s; infinite without relays."""
        return min((relay.next_switch(time) for relay in self._relays.values()), default=math.inf)


class _Relay:
    def __init__(self, relay: RelayWindow):
        self._relay = relay
        self._window = -1
        self._on_until = 0.0
        self._carried = 0.0

    def applied(self, duty: float, time: float, is_off: bool) -> float:
        window = math.floor((time + ROUNDING) / self._relay.period)
        if is_off:
            self._window, self._on_until, self._carried = window, time, 0.0
        elif window > self._window:
            on, self._carried = self._relay.on_time(duty, self._carried)
            self._window, self._on_until = window, window * self._relay.period + on
        return float(time + ROUNDING < self._on_until)

    def next_switch(self, time: float) -> float:
        end = self._relay.period * (math.floor((time + ROUNDING) / self._relay.period) + 1)
        return self._on_until if time + ROUNDING < self._on_until < end else end


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
        self._relays, self._applied = Relays(rig), np.zeros(len(rig.driven))
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
            due = {name: count * self._periods[name] for name, count in self._made.items()}
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
        while (switch := self._relays.next_switch(self.twin.time)) < time:
            self.twin.advance(switch)
            self._switch()
        self.twin.advance(time)
        self._switch()
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
            self._switch()

    def _switch(self) -> None:
        """Drives the plant by the counts and by what the relays make of them now."""
        duty = self._driver.duty(self._driven)
        is_off = not (self.stage.owner and self.stage.supplied)
        applied = self._relays.applied(duty, self.twin.time, is_off=is_off)
        if not np.array_equal(applied, self._applied):
            self._applied = applied
            self.twin.drive(applied)

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
