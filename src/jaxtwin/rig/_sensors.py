"""Kinds of sensors: what the sensor of a channel reads, weighs and shows. Sensors on named elements
and bodies, at a point of the plate, and over a rectangle of it.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, TypeAlias, TypeVar, final

from .._kinds import add_kind
from ..errors import RigError
from ._bodies import Body
from ._fields import Fields
from ._plate import Plate
from ._units import COORDINATE, Kind

# Left, right, top and bottom of a rectangle of the plate, m.
Extent: TypeAlias = tuple[float, float, float, float]


# Of the plate's size: sums of element sizes need not meet its edge exactly.
RELATIVE_TOLERANCE = 1e-9


class SensorSite(NamedTuple):
    """Where a sensor is read into: the rig's plate and bodies, and the channel's place in the file.

    - `field`: the channel, for messages, such as `channels[T1]`.
    - `fields`: converts texts of the file to numbers, and refuses with the name of the file.
    """

    plate: Plate
    bodies: tuple[Body, ...]
    field: str
    fields: Fields


@dataclass(frozen=True)
class AbstractSensor(ABC):
    """What the sensor of a channel measures: a weighted mean of temperatures of the rig.

    A kind of one's own is a frozen dataclass whose fields are the numbers that its table in a rig
    file gives. `register_sensor` makes rig files know it; the channel's gain and lag come with
    every kind.
    """

    kind: ClassVar[str]
    """The name of the kind in rig files: `sensor = "..."` in a table `[[channels]]`."""

    quantities: ClassVar[Mapping[str, Kind]] = {}
    """The keys of the kind in such a table, and which quantity each of them is."""

    @classmethod
    def read(cls, table: Mapping[str, Any], site: SensorSite) -> "AbstractSensor":
        """Makes the sensor from the keys of its table.

        **Arguments:**

        - `table`: the keys of the kind that the file gives, with the values of the file; `x` and
          `y` are lists of one or two texts.
        - `site`: plate, bodies and the conversion of texts.

        **Raises:** `RigError` if a key is missing or wrong.
        """
        numbers = {}
        for key, kind in cls.quantities.items():
            field = f"{site.field}.{key}"
            if key not in table:
                site.fields.refuse(field, f"missing, a sensor of kind {cls.kind!r} needs {kind}")
            text = table[key][0] if isinstance(table[key], list) else table[key]
            if not isinstance(text, str):
                site.fields.refuse(field, f"expected {kind}, got {text!r}")
            numbers[key] = site.fields.constant(field, text, kind)
        return cls(**numbers)

    @abstractmethod
    def weights(self, plate: Plate) -> dict[str, float]:
        """The weight of each node in the temperature that is measured: elements of the plate, for
        which `Plate.point_weights` and `Plate.mean_weights` interpolate, and bodies. They sum to
        1; nodes without a weight may be absent."""

    @abstractmethod
    def outline(self, plate: Plate) -> list[Extent]:
        """The rectangles of the plate that are measured, for pictures, and for the pixels that a
        camera reads in its frames; none for a sensor on a body."""


Registered = TypeVar("Registered", bound=type[AbstractSensor])

# Kind of sensor -> its class.
_KINDS: dict[str, type[AbstractSensor]] = {}


def register_sensor(sensor: Registered) -> Registered:
    """Makes rig files know a class of sensors by its `kind`. Returns the class, so that it can be a
    decorator.

    **Raises:** `RigError` for a class without a `kind`, or with the `kind` of another class.
    """
    add_kind(_KINDS, sensor, "register_sensor", "rig files, such as 'zone'", RigError)
    return sensor


def sensor_kinds() -> Mapping[str, type[AbstractSensor]]:
    """The registered kinds of sensors, kind -> class."""
    return _KINDS


@final
@register_sensor
@dataclass(frozen=True)
class NodesSensor(AbstractSensor):
    """The plain mean of named elements of the plate and bodies.

    - `nodes`: their names.
    """

    kind: ClassVar[str] = "nodes"
    nodes: tuple[str, ...]

    @classmethod
    def read(cls, table: Mapping[str, Any], site: SensorSite) -> "NodesSensor":
        nodes, field = table["nodes"], f"{site.field}.nodes"
        free = [body.name for body in site.bodies if body.temperature is None]
        for node in nodes:
            site.fields.check_element(field, node, site.plate.element_names, free)
        site.fields.check_unique(field, nodes)
        return cls(tuple(nodes))

    def weights(self, plate: Plate) -> dict[str, float]:
        return dict.fromkeys(self.nodes, 1 / len(self.nodes))

    def outline(self, plate: Plate) -> list[Extent]:
        return [plate.extent(node) for node in self.nodes if node in plate.element_names]


@final
@register_sensor
@dataclass(frozen=True)
class PointSensor(AbstractSensor):
    """The temperature at a point, interpolated between the centres of the elements.

    - `x`, `y`: the point, m.
    """

    kind: ClassVar[str] = "point"
    x: float
    y: float

    @classmethod
    def read(cls, table: Mapping[str, Any], site: SensorSite) -> "PointSensor":
        return cls(
            _place(f"{site.field}.x", table["x"][0], site.plate.width, site.fields),
            _place(f"{site.field}.y", table["y"][0], site.plate.height, site.fields),
        )

    def weights(self, plate: Plate) -> dict[str, float]:
        return plate.point_weights(self.x, self.y)

    def outline(self, plate: Plate) -> list[Extent]:
        """A square about the point, as large as the smallest side of an element."""
        half = min(*plate.columns, *plate.rows) / 2
        return [
            (
                max(self.x - half, 0.0),
                min(self.x + half, plate.width),
                max(self.y - half, 0.0),
                min(self.y + half, plate.height),
            )
        ]


def _place(field: str, text: str, size: float, fields: Fields) -> float:
    place = fields.constant(field, text, COORDINATE)
    if place > size * (1 + RELATIVE_TOLERANCE):
        fields.refuse(
            field, f"expected a position on the plate, 0 to {100 * size:g} cm, got {text!r}"
        )
    return place


@final
@register_sensor
@dataclass(frozen=True)
class ZoneSensor(AbstractSensor):
    """The mean over a rectangle of the plate, its zone, of the temperature, which is interpolated
    between the centres of the elements.

    - `x`, `y`: the rectangle, m.
    """

    kind: ClassVar[str] = "zone"
    x: tuple[float, float]
    y: tuple[float, float]

    @classmethod
    def read(cls, table: Mapping[str, Any], site: SensorSite) -> "ZoneSensor":
        return cls(
            _range(f"{site.field}.x", table["x"], site.plate.width, site.fields),
            _range(f"{site.field}.y", table["y"], site.plate.height, site.fields),
        )

    def weights(self, plate: Plate) -> dict[str, float]:
        return plate.mean_weights(self.x, self.y)

    def outline(self, plate: Plate) -> list[Extent]:
        return [(*self.x, *self.y)]


def _range(field: str, texts: list[str], size: float, fields: Fields) -> tuple[float, float]:
    first, last = (fields.constant(field, text, COORDINATE) for text in texts)
    if not first < last <= size * (1 + RELATIVE_TOLERANCE):
        fields.refuse(
            field, f"expected a range inside the plate, 0 to {100 * size:g} cm, got {texts}"
        )
    return first, min(last, size)
