"""The records of a connection, in their order: samples, readings, gaps, events, commands.

All records carry `arrival`, the host time (ns since 1970) at which their bytes were read.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal, final

import numpy as np
from jaxtyping import Float, UInt16

from ._messages import Hello

# The streams that a device counts separately: controller samples, camera frames, notices.
Stream = Literal["data", "image", "event"]


class LinkState(StrEnum):
    """State of a link.

    - `connecting`: open, but no device has identified itself yet.
    - `live`: valid frames of the rig come in.
    - `stale`: was live, but has been silent for longer than its limit.
    - `down`: not open; it is opened again after a pause, without limit.
    """

    CONNECTING = "connecting"
    LIVE = "live"
    STALE = "stale"
    DOWN = "down"


@final
@dataclass(frozen=True)
class Greeting:
    """A device has identified itself: the first record of every connection."""

    link: str
    arrival: int
    hello: Hello


@final
@dataclass(frozen=True)
class Sample:
    """A controller's sample: the counts on the cells, and ambient (degC) if it is measured.

    `owner` is the host that commands the cells, `number` that of its last command that was applied,
    and `trip` says why the device refuses every duty (`""`: it has not tripped); see `OutputStage`.
    `relay` is `on` or `off`, the state of the supply behind the device's relay (`""`: it has none);
    in a recording, its changes are events.
    """

    link: str
    boot: str
    arrival: int
    device_us: int
    seq: int
    pwm: tuple[int, ...]
    ambient: float | None
    owner: str = ""
    number: int | None = None
    trip: str = ""
    relay: str = ""


@final
@dataclass(frozen=True, eq=False)
class Reading:
    """Temperatures of the rig's channels `(channels,)`, degC, from a camera frame or a line.

    `recalibrating` is true while the camera's shutter is closed. `pixels` `(height, width)` are
    those of the frame, 0.01 K, or `None` if the controller measured the channels. A channel that
    has failed is NaN; `faults` gives the reason by its number, if the device gives one.
    """

    link: str
    boot: str
    arrival: int
    device_us: int
    seq: int
    temperatures: Float[np.ndarray, " channels"]
    recalibrating: bool
    pixels: UInt16[np.ndarray, "height width"] | None
    faults: dict[int, str] = field(default_factory=dict)


@final
@dataclass(frozen=True)
class Gap:
    """`count` messages of a stream, from number `first` on, are missing."""

    link: str
    arrival: int
    stream: Stream
    first: int
    count: int


@final
@dataclass(frozen=True)
class LinkChange:
    """The state of a link has changed; `detail` says why."""

    link: str
    arrival: int
    state: LinkState
    detail: str


@final
@dataclass(frozen=True)
class Event:
    """Any other event.

    `kind` is one word (`recalibration-start`, `duplicate`, `nonsense`, ...). The kind of a device's
    notice begins with `device/`, which distinguishes it from an event of the host. The `device_us`
    and the number `seq` are `None` for an event of the host.
    """

    link: str
    arrival: int
    kind: str
    detail: str = ""
    device_us: int | None = None
    seq: int | None = None


@final
@dataclass(frozen=True)
class Command:
    """A command that was sent to the link: `kind` is `duty`, `stop`, `reset`, `release` or
    `relay`."""

    link: str
    arrival: int
    number: int
    pwm: tuple[int, ...]
    owner: str = ""
    kind: str = "duty"


@final
@dataclass(frozen=True, eq=False)
class Document:
    """The start or the end of a commanded run (`kind` is `start` or `stop`), as in bluesky's
    documents.

    Both have the same `uid`. `content` holds the operator and plan at the start, the outcome at the
    stop. In between, each sample of a controller is a document of the kind `decision`, whose `uid`
    is `control`.
    """

    arrival: int
    kind: str
    uid: str
    content: Mapping[str, Any]


@final
@dataclass(frozen=True)
class StateEstimate:
    """What an observer of the rig estimates at a time: the host's, of the reading before.

    - `twin`: the twin that it observes with, for people.
    - `values`: name with unit -> number, such as `node_P1.TH_degC` with `node_P1.TH_spread_K`, the
      standard deviation.
    """

    arrival: int
    twin: str
    values: Mapping[str, float]


Record = Greeting | Sample | Reading | Gap | LinkChange | Event | Command | Document | StateEstimate
"""The records of which a recorded session consists."""
