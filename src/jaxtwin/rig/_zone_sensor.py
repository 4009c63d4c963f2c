"""Sensors that see a rectangle of the plate."""

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
