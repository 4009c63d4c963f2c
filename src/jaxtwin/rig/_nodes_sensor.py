"""Sensors on named elements and bodies."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, final

from ._plate import Plate
from ._sensor import AbstractSensor, Extent, SensorSite, register_sensor


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
