"""Channels: the recorded temperatures of a rig."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from ._body import Body
from ._fields import Fields
from ._nodes_sensor import NodesSensor
from ._plate import AMBIENT, Plate
from ._point_sensor import PointSensor
from ._sensor import AbstractSensor, SensorSite, sensor_kinds
from ._units import DURATION, FACTOR
from ._value import Value
from ._zone_sensor import ZoneSensor

if TYPE_CHECKING:  # pydantic, which only readers of a rig should pay for
    from ._schema import ChannelTable


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
        None if table.lag is None else fields.value(f"{at}.lag", table.lag, DURATION),
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
