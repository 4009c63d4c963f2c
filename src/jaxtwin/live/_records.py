"""What a bench yields: samples, readings, and everything that happened to them, in one order.

All records carry `arrival`, the host time (ns since 1970) at which their bytes were read.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, final

import numpy as np
from jaxtyping import Float, UInt16

from ._messages import Hello

Stream = Literal["data", "image", "event"]
"""What a device counts separately: controller samples, camera frames, notices."""


class LinkState(StrEnum):
    """How a link stands.

    - `connecting`: open, but nobody has made himself known yet.
    - `live`: valid frames of the rig come in.
    - `stale`: was live, but silent for longer than its limit.
    - `down`: not open; it is tried again after a while, for ever.
    """

    CONNECTING = "connecting"
    LIVE = "live"
    STALE = "stale"
    DOWN = "down"


@final
@dataclass(frozen=True)
class Greeting:
    """A device made itself known: first record of every connection."""

    link: str
    arrival: int
    hello: Hello


@final
@dataclass(frozen=True)
class Sample:
    """A controller's sample: the counts on the cells, and ambient (degC) where it is measured."""

    link: str
    boot: str
    arrival: int
    device_us: int
    seq: int
    pwm: tuple[int, ...]
    ambient: float | None


@final
@dataclass(frozen=True, eq=False)
class Reading:
    """Temperatures of the rig's channels `(channels,)`, degC, from a camera frame or a line.

    `recalibrating` is true while the camera's shutter is closed. `pixels` `(height, width)` are
    those of the frame, 0.01 K, or `None` where the controller measured the channels.
    """

    link: str
    boot: str
    arrival: int
    device_us: int
    seq: int
    temperatures: Float[np.ndarray, " channels"]
    recalibrating: bool
    pixels: UInt16[np.ndarray, "height width"] | None


@final
@dataclass(frozen=True)
class Gap:
    """`count` messages of a stream, from number `first` on, never came."""

    link: str
    arrival: int
    stream: Stream
    first: int
    count: int


@final
@dataclass(frozen=True)
class LinkChange:
    """A link is in another state now; `detail` says why."""

    link: str
    arrival: int
    state: LinkState
    detail: str


@final
@dataclass(frozen=True)
class Event:
    """Anything else that a reader of a recording must know.

    `kind` is one word (`recalibration-start`, `watchdog`, `duplicate`, `nonsense`, `stop`, ...).
    `device_us` is `None` where it happened on the host.
    """

    link: str
    arrival: int
    kind: str
    detail: str = ""
    device_us: int | None = None


@final
@dataclass(frozen=True)
class Command:
    """A duty command that was handed to the link."""

    link: str
    arrival: int
    number: int
    pwm: tuple[int, ...]


Record = Greeting | Sample | Reading | Gap | LinkChange | Event | Command
