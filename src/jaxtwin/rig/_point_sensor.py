"""Sensors at one point of the plate."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, final

from ._fields import Fields
from ._plate import Plate
from ._sensor import RELATIVE_TOLERANCE, AbstractSensor, Extent, SensorSite, register_sensor
from ._units import COORDINATE


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
