"""What measures: an infrared camera or point sensors, and the channels read from them."""

import re
from dataclasses import dataclass
from typing import final

from ._value import Value


@final
@dataclass(frozen=True)
class CommonError:
    """The error that all channels of a camera share, each part with its prior standard deviation.

    An uncooled infrared camera drifts, and corrects itself from time to time behind a shutter
    (flat-field correction): its readings then jump and the jump fades as the shutter's heat does.

    **Arguments:**

    - `offset`: constant, K.
    - `drift`: slow changes about the offset, K; `drift_time`: between its corners, s.
    - `jump`: at a correction, K, for each part of it: one that fades with each time constant of
      `relaxation`, s.
    - `detect`: whether corrections are looked for in the residuals of a match.
    """

    offset: float
    drift: float
    drift_time: float
    jump: float
    relaxation: tuple[float, ...]
    detect: bool


@final
@dataclass(frozen=True)
class Registration:
    """The position of a camera's picture on the plate, relative to the rig file.

    A point $p$ of the rig file is at $c + d + s R (p - c)$, with the plate's centre $c$.

    **Arguments:**

    - `shift_x`, `shift_y`: $d$, to the right and down, m.
    - `scale`: $s$, above 1 where a zone covers more of the plate.
    - `rotation`: of $R$, clockwise as x runs to the right and y down, rad.
    """

    shift_x: Value
    shift_y: Value
    scale: Value
    rotation: Value


@final
@dataclass(frozen=True)
class Camera:
    """An infrared camera over the plate.

    **Arguments:**

    - `width`, `height`: of a frame, pixels.
    - `noise`: standard deviation of a reading, K.
    - `view_x`, `view_y`: first and last edge of the plate's outline in a frame, pixels.
    - `common_error`: of all channels alike, None for none.
    - `registration`: of its pictures against the plate, None where zones lie as the rig file says.
    """

    width: int
    height: int
    noise: float
    view_x: tuple[float, float]
    view_y: tuple[float, float]
    common_error: CommonError | None = None
    registration: Registration | None = None


@final
@dataclass(frozen=True)
class Sensors:
    """Point sensors on the plate, such as thermocouples, in place of a camera.

    **Arguments:**

    - `noise`: standard deviation of a reading, K.
    """

    noise: float


@final
@dataclass(frozen=True)
class Channel:
    """One recorded temperature: reading = ambient + gain * (T - ambient).

    **Arguments:**

    - `name`: unique in the rig, as recordings name it.
    - `nodes`: T is the plain mean of these plate elements and bodies, where there are some.
    - `x`, `y`: otherwise T is the mean over this rectangle of the plate, m.
    - `gain`: dimensionless. Below 1 where the surface reflects part of the room (bare metal).
    - `lag`: time constant with which the sensor follows T, s; None where it is T at once.
    """

    name: str
    nodes: tuple[str, ...]
    x: tuple[float, float] | None
    y: tuple[float, float] | None
    gain: Value
    lag: Value | None = None


def is_channel_name(name: str) -> bool:
    """Whether a channel may have a name: whatever a column of a recording can be called."""
    return re.fullmatch(r"\w([\w .-]*\w)?", name) is not None
