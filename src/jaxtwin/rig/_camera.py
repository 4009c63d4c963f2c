"""What reads the channels: an infrared camera, or point sensors."""

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
    - `interval`: the time between two corrections, s, of a camera that corrects itself at equal
      intervals, from which an observer expects the next one; None if it does not.
    """

    offset: float
    drift: float
    drift_time: float
    jump: float
    relaxation: tuple[float, ...]
    detect: bool
    interval: float | None = None


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
