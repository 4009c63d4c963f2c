"""What drives and reads a rig: driver, limits, camera or point sensors, and channels, which are the
recorded temperatures. The tables `[driver]`, `[camera]`, `[limits]` and `[[channels]]` of a rig
file.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal, final

import numpy as np
from jaxtyping import Float

from ._bodies import Body
from ._cell import Cell
from ._fields import Fields
from ._heater import Heater
from ._plate import AMBIENT, Plate
from ._sensors import AbstractSensor, NodesSensor, PointSensor, SensorSite, ZoneSensor, sensor_kinds
from ._units import (
    ANGLE,
    CURRENT,
    DURATION,
    FACTOR,
    NOISE,
    SERIES_RESISTANCE,
    SHIFT,
    TEMPERATURE,
    TEMPERATURE_DIFFERENCE,
    TEMPERATURE_RATE,
    VOLTAGE,
    Kind,
)
from ._value import Value

if TYPE_CHECKING:
    from ._schema import (
        CameraTable,
        ChannelTable,
        CommonErrorTable,
        DriverTable,
        LimitsTable,
        RegistrationTable,
    )


@final
@dataclass(frozen=True)
class Driver:
    """Supply and H-bridge.

    **Arguments:**

    - `supply_voltage`: V; without effect on a rig whose heaters all have a given power.
    - `supply_resistance`: the resistance in series with each cell while it is connected, ohm.
    - `on_resistance`: the resistance of the bridge while it is on, ohm.
    - `lag`: the time constant with which the duty cycle that reaches the cells follows the command,
      s; None for no lag.
    - `delay`: the delay of that duty cycle, s; only with a lag.
    - `counts`: the PWM command that means full duty.
    - `polarity`: +1 if positive commands heat the plate, -1 if they cool it.
    - `averaging`: `"voltage"` puts the mean voltage on the cell, `"on-off"` averages the heat flows
      of the connected and the disconnected part of a PWM period.
    - `current_limit`: the largest current that the controller allows through a connected cell, A;
      None for no limit.
    - `states_counts`: whether the rig file states the counts, without which a recording in counts
      has no meaning.
    - `off_phase`: what the bridge does with the cell in the rest of a period: `"brake"` shorts it,
      `"open"` leaves it open.
    """

    supply_voltage: Value
    supply_resistance: Value
    on_resistance: Value
    counts: int = 255
    polarity: Literal[1, -1] = 1
    averaging: Literal["voltage", "on-off"] = "on-off"
    off_phase: Literal["brake", "open"] = "brake"
    lag: Value | None = None
    delay: Value | None = None
    current_limit: Value | None = None
    states_counts: bool = True

    def duty(self, pwm: Sequence[int]) -> Float[np.ndarray, " cells"]:
        """Returns the duty cycles of PWM commands in counts, -1 to 1; positive heats the plate."""
        return np.array(pwm) * self.polarity / self.counts


# The melting point of bismuth-tin, the softest solder of ordinary modules, degC: the default limit
# of a cell.
SOLDER = 138.0


@final
@dataclass(frozen=True)
class Limits:
    """Limits of `jaxtwin drive`. A field that is None has a default that follows from the physics.

    **Arguments:**

    - `temperature`: the highest temperature of any channel, K.
    - `cell_temperature`: the highest temperature of both sides of a cell, as the twin predicts
      them, K.
    - `lowest`: the temperature below which a reading is implausible, K.
    - `rate`: the rate above which the change of a reading is implausible, K/s.
    - `frozen`: the time at full duty after which a reading that does not change is implausible, s.
      At a lower duty the time is longer by the same factor.
    - `deviation`: the largest deviation of a reading from the twin's prediction, in addition to
      half of its rise, K.
    - `command_delay`: the longest time until the driver has applied a command, including its ramp,
      s.
    - `stop_on_alarm`: whether an alarm of a monitor switches the cells off, as an interlock does.
    - `relay`: the name of the relay in the supply of the cells, which a device opens; `None` for a
      rig without one.
    """

    temperature: float
    cell_temperature: float | None = None
    lowest: float | None = None
    rate: float | None = None
    frozen: float | None = None
    deviation: float | None = None
    command_delay: float | None = None
    stop_on_alarm: bool = False
    relay: str | None = None


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


@final
@dataclass(frozen=True)
class Channel:
    """A recorded temperature: reading = ambient + gain * (T - ambient).

    **Arguments:**

    - `name`: the name in recordings, unique in the rig.
    - `sensor`: what T is: the mean of nodes or over a zone of the plate, or that at a point.
    - `gain`: the gain, dimensionless. It is below 1 if the surface reflects part of the room, as
      bare metal does.
    - `lag`: the time constant with which the sensor follows T, s; None for no lag.
    """

    name: str
    sensor: AbstractSensor
    gain: Value = Value(1.0)  # noqa: RUF009  # a frozen dataclass
    lag: Value | None = None


def is_channel_name(name: str) -> bool:
    """Whether a channel may have this name, which is also the name of a column in recordings."""
    return re.fullmatch(r"\w([\w .-]*\w)?", name) is not None


def build_channel(
    table: "ChannelTable", plate: Plate, bodies: Sequence[Body], fields: Fields
) -> Channel:
    """A channel from its table.

    **Raises:** `RigError` if its sensor is not on the rig, or another value is wrong.
    """
    at = f"channels[{table.name}]"
    if not is_channel_name(table.name) or table.name == AMBIENT:
        # Recordings have a column for each channel, and one for the ambient temperature.
        fields.refuse(
            f"{at}.name",
            f"expected letters, digits and, between them, '_-.' and blanks, and not {AMBIENT!r}, "
            f"got {table.name!r}",
        )
    if not plate.columns and (table.x is not None or table.y is not None):
        fields.refuse(
            at,
            "expected nodes, the names of bodies, because the rig has no [plate] on which x and y "
            "are places, got x or y",
        )
    return Channel(
        table.name,
        _sensor_class(table, at, fields).read(
            table.own_keys(), SensorSite(plate, tuple(bodies), at, fields)
        ),
        fields.value(f"{at}.gain", table.gain, FACTOR),
        fields.optional(at, table, "lag", DURATION),
    )


def _sensor_class(table: "ChannelTable", at: str, fields: Fields) -> type[AbstractSensor]:
    """The kind that the table names, or else the one that its keys belong to."""
    named = None if table.sensor is None else sensor_kinds()[table.sensor]
    if named not in (None, NodesSensor, ZoneSensor, PointSensor):
        return named
    result = _kind_of_keys(table, at, fields)
    if named not in (None, result):
        fields.refuse(
            f"{at}.sensor", f"expected {result.kind!r} beside these keys, got {table.sensor!r}"
        )
    return result


def _kind_of_keys(table: "ChannelTable", at: str, fields: Fields) -> type[AbstractSensor]:
    if table.nodes is not None and table.x is None and table.y is None:
        return NodesSensor
    if table.nodes is not None or table.x is None or table.y is None:
        fields.refuse(at, "expected either nodes or x with y; give one of them")
    if len(table.x) != len(table.y):
        fields.refuse(at, "expected a position in both x and y, or a range in both")
    return PointSensor if len(table.x) == 1 else ZoneSensor


# The keys of `[driver]` that a rig with cells needs.
_OF_CELLS = ("supply_voltage", "on_resistance", "counts", "polarity", "averaging")


def build_driver(
    table: "DriverTable | None", cells: Sequence[Cell], heaters: Sequence[Heater], fields: Fields
) -> Driver:
    """The driver.

    **Arguments:**

    - `table`: its table. Heaters of a given power need none, heaters with a resistance need the
      voltage of the supply, and cells need all.
    - `cells`, `heaters`: what it drives.

    **Raises:** `RigError` if a value is wrong or missing.
    """
    if table is None:
        if cells:
            fields.refuse("driver", "missing, every rig with cells needs it")
        from ._schema import (
            DriverTable,  # with pydantic, which only readers of a rig should pay for
        )

        table = DriverTable()
    needed = _OF_CELLS if cells else ()
    if any(heater.power is None for heater in heaters):
        needed = needed or ("supply_voltage",)
    for name in needed:
        if getattr(table, name) is None:
            fields.refuse(
                f"driver.{name}",
                "missing, every rig with cells needs it"
                if cells
                else "missing, heaters with an electrical_resistance need it",
            )
    if heaters and table.polarity == -1:
        fields.refuse(
            "driver.polarity",
            "expected 1 in a rig with heaters, whose counts are never negative, got -1; let the "
            "device reverse the counts of its cells",
        )
    if table.averaging == "voltage" and table.off_phase != "brake":
        fields.refuse(
            "driver.off_phase",
            f'expected "brake" with averaging = "voltage", got {table.off_phase!r}',
        )
    if table.delay is not None and table.lag is None:
        # Without a ramp the temperatures would not be smooth in the delay.
        fields.refuse("driver.delay", "expected a lag beside the delay, got none; give driver.lag")
    lag, delay = (fields.optional("driver", table, name, DURATION) for name in ("lag", "delay"))
    supply_resistance, on_resistance = (
        fields.value(f"driver.{name}", getattr(table, name) or "0 ohm", SERIES_RESISTANCE)
        for name in ("supply_resistance", "on_resistance")
    )
    voltage = table.supply_voltage or "1 V"  # which nothing uses
    return Driver(
        supply_voltage=fields.input_or_value("driver.supply_voltage", voltage, VOLTAGE),
        supply_resistance=supply_resistance,
        on_resistance=on_resistance,
        counts=255 if table.counts is None else table.counts,
        states_counts=table.counts is not None,
        polarity=table.polarity or 1,
        averaging=table.averaging or "on-off",
        off_phase=table.off_phase,
        lag=lag,
        delay=delay,
        current_limit=fields.optional("driver", table, "current_limit", CURRENT),
    )


# The largest number of characters of a relay's name, which a device repeats in its greeting.
MAX_RELAY = 32


def build_limits(table: "LimitsTable", fields: Fields) -> Limits:
    """The limits.

    **Raises:** `RigError` if a value is wrong, or the lowest reading is above the highest.
    """
    optional = partial(fields.optional_constant, "limits", table)
    limits = Limits(
        temperature=fields.constant("limits.temperature", table.temperature, TEMPERATURE),
        cell_temperature=optional("cell_temperature", TEMPERATURE),
        lowest=optional("lowest", TEMPERATURE),
        rate=optional("rate", TEMPERATURE_RATE),
        frozen=optional("frozen", DURATION),
        deviation=optional("deviation", TEMPERATURE_DIFFERENCE),
        command_delay=optional("command_delay", DURATION),
        stop_on_alarm=table.stop_on_alarm,
        relay=table.relay,
    )
    name = limits.relay
    if name is not None and not (0 < len(name) <= MAX_RELAY and name.isprintable()):
        fields.refuse(
            "limits.relay", f"expected 1 to {MAX_RELAY} printable characters, got {name!r}"
        )
    if limits.lowest is not None and limits.lowest >= limits.temperature:
        fields.refuse(
            "limits.lowest",
            f"expected a temperature below limits.temperature, got {table.lowest!r}",
        )
    if limits.rate is not None and limits.rate <= 0:
        fields.refuse("limits.rate", f"expected a rate above 0, got {table.rate!r}")
    return limits


def build_camera(table: "CameraTable", fields: Fields) -> Camera:
    """The camera.

    **Raises:** `RigError` if the view is not inside a frame.
    """
    width, height = table.resolution
    for axis, view, size in (("x", table.view.x, width), ("y", table.view.y, height)):
        if not 0 <= view[0] < view[1] <= size:
            fields.refuse(
                f"camera.view.{axis}",
                f"expected a range of pixels inside the frame, 0 to {size}, got {view}",
            )
    return Camera(
        width=width,
        height=height,
        noise=fields.constant("camera.noise", table.noise, NOISE),
        view_x=(table.view.x[0], table.view.x[1]),
        view_y=(table.view.y[0], table.view.y[1]),
        common_error=table.common_error and _common_error(table.common_error, fields),
        registration=table.registration and _registration(table.registration, fields),
    )


def _registration(table: "RegistrationTable", fields: Fields) -> Registration:
    kinds = {"shift_x": SHIFT, "shift_y": SHIFT, "scale": FACTOR, "rotation": ANGLE}
    return Registration(
        **{
            name: fields.value(f"camera.registration.{name}", getattr(table, name), kind)
            for name, kind in kinds.items()
        }
    )


def _common_error(table: "CommonErrorTable", fields: Fields) -> CommonError:
    def constant(name: str, text: str, kind: Kind) -> float:
        return fields.constant(f"camera.common_error.{name}", text, kind)

    return CommonError(
        offset=constant("offset", table.offset, TEMPERATURE_DIFFERENCE),
        drift=constant("drift", table.drift, TEMPERATURE_DIFFERENCE),
        drift_time=constant("drift_time", table.drift_time, DURATION),
        jump=constant("jump", table.jump, TEMPERATURE_DIFFERENCE),
        relaxation=tuple(constant("relaxation", text, DURATION) for text in table.relaxation),
        detect=table.events == "detect",
        interval=None if table.interval is None else constant("interval", table.interval, DURATION),
    )
