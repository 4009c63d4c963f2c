"""The sensors: an infrared camera or point sensors, and the channels read from them."""

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

    - `offset`: the constant part, K.
    - `drift`: slow changes about the offset, K; `drift_time`: the time between the corners of this
      piecewise linear function, s.
    - `jump`: the jump at a correction, K. It has a part that fades with each time constant of
      `relaxation`, s; this is the standard deviation of each part.
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
    - `scale`: $s$, above 1 if a zone covers more of the plate than the rig file says.
    - `rotation`: the angle of $R$, rad, clockwise, because x runs to the right and y down.
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

    - `width`, `height`: the size of a frame, pixels.
    - `noise`: standard deviation of a reading, K.
    - `view_x`, `view_y`: the first and the last edge of the plate's outline in a frame, pixels.
    - `common_error`: the error that all channels share; None for no such error.
    - `registration`: the position of its pictures on the plate; None if zones lie as the rig file
      says.
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
    """A recorded temperature: reading = ambient + gain * (T - ambient).

    **Arguments:**

    - `name`: the name in recordings, unique in the rig.
    - `nodes`: the plate elements and bodies of which T is the plain mean; empty for a channel over
      a rectangle; the element in which the point of a point sensor lies, whose pixels a camera
      reads for it.
    - `x`, `y`: the rectangle of the plate over which T is the mean otherwise, m.
    - `gain`: the gain, dimensionless. It is below 1 if the surface reflects part of the room, as
      bare metal does.
    - `lag`: the time constant with which the sensor follows T, s; None for no lag.
    - `point`: x and y of a point sensor, m, at which T is interpolated between the centres of the
      elements; None for any other channel.
    """

    name: str
    nodes: tuple[str, ...]
    x: tuple[float, float] | None
    y: tuple[float, float] | None
    gain: Value
    lag: Value | None = None
    point: tuple[float, float] | None = None


def is_channel_name(name: str) -> bool:
    """Whether a channel may have this name, which is also the name of a column in recordings."""
    return re.fullmatch(r"\w([\w .-]*\w)?", name) is not None
