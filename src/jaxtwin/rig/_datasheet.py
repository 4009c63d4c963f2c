"""Datasheets of thermoelectric modules."""

from dataclasses import dataclass
from typing import final

from ._bundled import read_bundled


@final
@dataclass(frozen=True)
class Datasheet:
    r"""The datasheet of a thermoelectric module.

    **Arguments:**

    - `name`, `title`, `references`, `notes`: its name, a title, the sources of the numbers, and
      notes.
    - `hot_side_temperature`: $T_h$, the temperature of the hot side for which the other numbers are
      stated, K.
    - `maximum_current`, `maximum_voltage`: $I_{max}$ (A) and $V_{max}$ (V), at which the
      temperature difference without load is largest.
    - `maximum_temperature_difference`: $\Delta T_{max}$, K.
    - `maximum_heat_flow`: the heat flow that is absorbed at $I_{max}$ without a temperature
      difference, W; None if not known.
    - `ac_resistance`: the resistance measured with alternating current, without a temperature
      difference, ohm; None if not known.
    - `mass`: kg; None if not known.
    - `width`, `height`: width and height of its faces, m; None if not known.

    The constants follow from eq. (10) of the paper.
    """

    name: str
    title: str
    references: tuple[str, ...]
    notes: str
    hot_side_temperature: float
    maximum_voltage: float
    maximum_current: float
    maximum_temperature_difference: float
    maximum_heat_flow: float | None = None
    ac_resistance: float | None = None
    mass: float | None = None
    width: float | None = None
    height: float | None = None

    @property
    def seebeck_coefficient(self) -> float:
        r"""$\alpha = V_{max} / T_h$, V/K."""
        return self.maximum_voltage / self.hot_side_temperature

    @property
    def electrical_resistance(self) -> float:
        r"""$R_E = (V_{max} / I_{max}) (T_h - \Delta T_{max}) / T_h$, ohm."""
        lowest = self.hot_side_temperature - self.maximum_temperature_difference
        return self.maximum_voltage / self.maximum_current * lowest / self.hot_side_temperature

    @property
    def thermal_resistance(self) -> float:
        r"""The thermal resistance of the module, K/W:

        $$R_{Th} = \frac{\Delta T_{max}}{I_{max} V_{max}} \frac{2 T_h}{T_h - \Delta T_{max}}$$
        """
        lowest = self.hot_side_temperature - self.maximum_temperature_difference
        power = self.maximum_voltage * self.maximum_current
        return self.maximum_temperature_difference / power * 2 * self.hot_side_temperature / lowest


def load_module(name: str) -> Datasheet:
    """Loads a bundled datasheet.

    **Arguments:**

    - `name`: one of `bundled_modules()`.

    **Raises:** `RigError` if no datasheet has this name.
    """
    # pydantic and pint take a while to import, and only readers of a file should pay for them.
    from . import _units as units
    from ._fields import Fields
    from ._schema import ModuleTable
    from ._validate import validate

    data, source = read_bundled("modules", name)
    table = validate(ModuleTable, data, source)
    fields = Fields(source, {}, {})

    def number(field: str, kind: units.Kind) -> float:
        return fields.constant(field, getattr(table, field), kind)

    def optional(field: str, kind: units.Kind) -> float | None:
        return None if getattr(table, field) is None else number(field, kind)

    return Datasheet(
        name=table.name,
        title=table.title,
        references=tuple(table.references),
        notes=table.notes,
        hot_side_temperature=number("hot_side_temperature", units.TEMPERATURE),
        maximum_voltage=number("maximum_voltage", units.VOLTAGE),
        maximum_current=number("maximum_current", units.CURRENT),
        maximum_temperature_difference=number(
            "maximum_temperature_difference", units.TEMPERATURE_DIFFERENCE
        ),
        maximum_heat_flow=optional("maximum_heat_flow", units.POWER),
        ac_resistance=optional("ac_resistance", units.ELECTRICAL_RESISTANCE),
        mass=optional("mass", units.MASS),
        width=optional("width", units.LENGTH),
        height=optional("height", units.LENGTH),
    )
