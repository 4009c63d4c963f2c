"""What the sensor of a channel measures: the frame of all kinds of sensors."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, TypeAlias, TypeVar

from .._kinds import add_kind
from ..errors import RigError
from ._body import Body
from ._fields import Fields
from ._plate import Plate
from ._units import Kind

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
