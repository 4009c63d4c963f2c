"""The messages of the protocol, version 2 (docs/protocol.md); `_codec.py` writes and reads them."""

from dataclasses import dataclass, field
from typing import Literal, final

import numpy as np
from jaxtyping import UInt16

# The version of the protocol.
VERSION = 2

RECALIBRATING = 1
"""The flag of a frame that was taken while the camera recalibrated itself (shutter closed, image
frozen)."""

MAX_NAMES = 64  # cells or channels in a greeting


@final
@dataclass(frozen=True)
class Hello:
    """A device's greeting: the rig to which it belongs, and the data that it will send.

    **Arguments:**

    - `version`: the version of the protocol.
    - `rig`: name of the rig.
    - `boot`: a word that differs at every start of the device, because its counters begin again.
    - `cells`, `channels`: names of the cells that it drives and the channels that it measures.
    - `camera`: width and height of its frames, pixels, or `None`.
    - `counts`: PWM counts of full duty.
    - `watchdog`: time without a duty command after which it switches the cells off, s of real
        time; `None` if it drives no cells.
    - `rate`: the seconds of device time in a second; 1 except for a virtual or replayed rig.
    - `relay`: the name of the relay in the supply that the device opens; `""` if it has none.
    - `heaters`: the names of those of its cells that only heat, whose counts are never negative.
    """

    version: int
    rig: str
    boot: str
    cells: tuple[str, ...] = ()
    channels: tuple[str, ...] = ()
    camera: tuple[int, int] | None = None
    counts: int = 255
    watchdog: float | None = None
    rate: float = 1.0
    relay: str = ""
    heaters: tuple[str, ...] = ()

    def lowest(self, cell: int) -> int:
        """The lowest counts of a cell, by its number: 0 for one that only heats."""
        return 0 if self.cells[cell] in self.heaters else -self.counts

    @property
    def switches(self) -> bool:
        """Whether the device can switch cells off: it drives them, or has the relay."""
        return bool(self.cells or self.relay)


@final
@dataclass(frozen=True)
class Data:
    """A controller's sample.

    **Arguments:**

    - `seq`: sequence number, modulo 2^32.
    - `device_us`: the time of the device's clock, microseconds since its start.
    - `pwm`: the counts that are applied to the cells now.
    - `ambient`: the ambient temperature, degC; `None` without a sensor for it.
    - `temperatures`: the readings of the greeting's channels, degC; empty if a camera measures
      them. The reading of a failed channel is NaN.
    - `faults`: number of a channel -> reason of its failure, a single word.
    - `owner`, `number`: the host that commands the cells, and the number of its last command that
        was applied; `""` and `None` if there is none.
    - `trip`: the reason why the device refuses every duty until it is reset; `""` if it has not
        tripped.
    - `relay`: `on` or `off`, the state of the supply behind the relay; `""` without a relay.
    """

    seq: int
    device_us: int
    pwm: tuple[int, ...] = ()
    ambient: float | None = None
    temperatures: tuple[float, ...] = ()
    faults: dict[int, str] = field(default_factory=dict)
    owner: str = ""
    number: int | None = None
    trip: str = ""
    relay: str = ""


@final
@dataclass(frozen=True, eq=False)
class Image:
    """A camera frame: pixels `(height, width)` in units of 0.01 K; the rest as in `Data`."""

    seq: int
    device_us: int
    flags: int
    pixels: UInt16[np.ndarray, "height width"]


@final
@dataclass(frozen=True)
class Notice:
    """An event on the device, such as a stop by its watchdog.

    **Arguments:**

    - `seq`, `device_us`: as in `Data`.
    - `kind`: the kind of event in a single word.
    - `owner`, `number`: those of the command that caused it, if any.
    - `why`: the reason in a single word.
    """

    seq: int
    device_us: int
    kind: str
    owner: str = ""
    number: int | None = None
    why: str = ""


@final
@dataclass(frozen=True)
class Beat:
    """The message of a device that has nothing else to send."""

    device_us: int


@final
@dataclass(frozen=True)
class Ask:
    """A host's greeting; the device answers with its own."""

    version: int


@final
@dataclass(frozen=True)
class Duty:
    """A host's command: PWM counts of the cells, held until the next or until the watchdog.

    **Arguments:**

    - `number`: the number of the command; a host increases it by 1.
    - `pwm`: counts.
    - `owner`: the host that commands. A device obeys a single host at a time.
    """

    number: int
    pwm: tuple[int, ...]
    owner: str


@final
@dataclass(frozen=True)
class Order:
    """A host's command without counts.

    **Arguments:**

    - `kind`: `stop`, from any host, switches the cells off and trips the device; `reset` ends a
      trip; `release` switches the cells off and lets another host command; `relay`, from any host,
      opens the relay in the supply, which also trips the device.
    - `number`, `owner`: as in `Duty`.
    - `name`: the name of the relay; `""` except for `relay`.
    """

    kind: Literal["stop", "reset", "release", "relay"]
    number: int
    owner: str
    name: str = ""


Message = Hello | Data | Image | Notice | Beat | Ask | Duty | Order
