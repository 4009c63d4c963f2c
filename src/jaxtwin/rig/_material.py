"""Materials of plates, with values of handbooks."""

from dataclasses import dataclass
from typing import final

from ._bundled import read_bundled


@final
@dataclass(frozen=True)
class Material:
    """A solid at room temperature.

    **Arguments:**

    - `name`, `title`, `references`: its name, a title, and the sources of the numbers.
    - `density`: kg/m^3. `specific_heat`: J/(kg K). `conductivity`: W/(m K).
    - `diffusivity`: the thermal diffusivity in the same source, m^2/s, which is conductivity /
      (density * specific heat); None if it lists none.
    """

    name: str
    title: str
    references: tuple[str, ...]
    density: float
    specific_heat: float
    conductivity: float
    diffusivity: float | None


def load_material(name: str) -> Material:
    """Loads a bundled material.

    **Arguments:**

    - `name`: one of `bundled_materials()`.

    **Raises:** `RigError` if no material has this name.
    """
    # pydantic and pint take a while to import, and only readers of a file should pay for them.
    from . import _units as units
    from ._fields import Fields
    from ._schema import MaterialTable
    from ._validate import validate

    data, source = read_bundled("materials", name)
    table = validate(MaterialTable, data, source)
    fields = Fields(source, {}, {})
    kinds = {
        "density": units.DENSITY,
        "specific_heat": units.SPECIFIC_HEAT,
        "conductivity": units.CONDUCTIVITY,
    }
    numbers = {
        field: fields.constant(field, getattr(table, field), kind) for field, kind in kinds.items()
    }
    diffusivity = None
    if table.diffusivity is not None:
        diffusivity = fields.constant("diffusivity", table.diffusivity, units.DIFFUSIVITY)
    return Material(
        table.name, table.title, tuple(table.references), **numbers, diffusivity=diffusivity
    )
