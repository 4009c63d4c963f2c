"""The messages of the protocol, version 2 (docs/protocol.md); `_codec.py` writes and reads them."""

from dataclasses import dataclass, field
from typing import Literal, final

import numpy as np
from jaxtyping import UInt16

VERSION = 2
"""Of the protocol."""

RECALIBRATING = 1
"""Flag of a frame taken while the camera recalibrates itself (shutter closed, image frozen)."""

MOST_NAMES = 64  # cells or channels in a greeting


@final
@dataclass(frozen=True)
class Hello:
    """A device's greeting: who it is and what it will send.

    **Arguments:**

    - `version`: of the protocol.
    - `rig`: name of the rig.
    - `boot`: new at every start of the device, since its counters begin anew then.
    - `cells`, `channels`: names; cells where it drives any, channels where it measures them itself.
    - `camera`: width and height of its frames, pixels, or `None`.
    - `counts`: PWM counts of full duty.
    - `watchdog`: without a duty command for this long it switches the cells off, seconds of a
        clock on the wall; `None` where it drives no cells.
    - `rate`: seconds of device time in a second; 1 but for a virtual or replayed rig.
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


@final
@dataclass(frozen=True)
class Data:
    """A controller's sample.

    **Arguments:**

    - `seq`: counts up by 1, modulo 2^32.
    - `device_us`: when, on the device's clock, microseconds since its start.
    - `pwm`: counts that are applied to the cells now.
    - `ambient`: degC, or `None` without a sensor for it.
    - `temperatures`: of the greeting's channels, degC; empty where a camera measures them. NaN
        where a channel has failed.
    - `faults`: number of a channel -> in one word, why it has failed.
    - `owner`, `number`: who commands the cells, and the number of his last command that was obeyed;
        `""` and `None` while nobody does.
    - `trip`: why the device refuses every duty until it is reset; `""` while it does not.
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
    """Something that happened on the device, such as its watchdog's stop.

    **Arguments:**

    - `seq`, `device_us`: as in `Data`.
    - `kind`: in one word.
    - `owner`, `number`: of the command that it is about, if any.
    - `why`: in one word.
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
    """Sign of life of a device that has nothing to say."""

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

    - `number`: counts a host's commands.
    - `pwm`: counts.
    - `owner`: who commands. A device obeys one at a time.
    """

    number: int
    pwm: tuple[int, ...]
    owner: str


@final
@dataclass(frozen=True)
class Order:
    """A host's command without counts.

    **Arguments:**

    - `kind`: `stop` switches off, whoever says it, and the device trips; `reset` ends a trip;
        `release` switches off and lets another command.
    - `number`, `owner`: as in `Duty`.
    """

    kind: Literal["stop", "reset", "release"]
    number: int
    owner: str


Message = Hello | Data | Image | Notice | Beat | Ask | Duty | Order
