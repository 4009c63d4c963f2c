"""The format of rig files: the keys of each table, and their types.

Conditions that involve more than one field (units, names, geometry) are checked when the parts are
built. The first mistake in a file is reported in one line.
"""

import reprlib
from collections.abc import Iterable
from typing import Annotated, Any, Literal, TypeVar

import pydantic
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    WithJsonSchema,
    model_validator,
)

from .._name_suggestions import unknown_name
from ._sensors import sensor_kinds
from ._toml import label, refuse


def _text(value: object) -> Any:
    if not isinstance(value, str) or not value.strip() or not value.strip().isprintable():
        raise ValueError(f"expected text on one line, got {reprlib.repr(value)}")
    return value.strip()


def _quantity(value: object) -> Any:
    if not isinstance(value, str):
        raise ValueError(
            "expected text, a number with its unit or the name of a parameter, got "
            f"{reprlib.repr(value)}"
        )
    return value.strip()


def _number(value: object) -> Any:
    if isinstance(value, bool):  # which Python takes for 1 or 0
        raise ValueError(f"expected a whole number, got {str(value).lower()}")
    return value


def _place(value: object) -> Any:
    if isinstance(value, list) and len(value) != 2:
        raise ValueError(f"expected one position or a range of two, got {len(value)} entries")
    return [_quantity(item) for item in value] if isinstance(value, list) else [_quantity(value)]


def _sensor_kind(value: str) -> str:
    if value not in sensor_kinds():
        raise ValueError(unknown_name("kind of sensor", value, sensor_kinds()))
    return value


def _quantity_or_switch(value: object) -> Any:
    if not isinstance(value, dict):
        return _quantity(value)
    if not isinstance(value.get("by"), str) or len(value) < 3:
        raise ValueError(
            'expected a quantity, or one for each state of an input, such as { closed = "2 K/W", '
            f'open = "0.1 K/W", by = "lid" }}, got {reprlib.repr(value)}'
        )
    return {key: _quantity(item) for key, item in value.items()}


def _quantity_or_list(value: object) -> Any:
    return [_quantity(item) for item in value] if isinstance(value, list) else _quantity(value)


def _names_or_resistances(value: object) -> Any:
    if isinstance(value, list):
        return [_text(item) for item in value]
    if isinstance(value, dict):
        return {name: _quantity(item) for name, item in value.items()}
    raise ValueError(
        'expected a list of one name such as ["air"], or a table of resistances such as '
        f'{{ air = "2 K/W" }}, got {reprlib.repr(value)}'
    )


Format = Annotated[Literal[1], BeforeValidator(_number)]
Text = Annotated[str, BeforeValidator(_text)]
Quantity = Annotated[str, BeforeValidator(_quantity)]
ONE_OR_SEVERAL = WithJsonSchema(
    {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]}
)
QuantityOrList = Annotated[Any, BeforeValidator(_quantity_or_list), ONE_OR_SEVERAL]
NamesOrResistances = Annotated[
    Any,
    BeforeValidator(_names_or_resistances),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "array", "items": {"type": "string"}},
                {"type": "object", "additionalProperties": {"type": "string"}},
            ]
        }
    ),
]
# A quantity, or one for each state of an input, which `by` names.
QuantityOrSwitch = Annotated[
    Any,
    BeforeValidator(_quantity_or_switch),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "string"},
                {
                    "type": "object",
                    "properties": {"by": {"type": "string"}},
                    "required": ["by"],
                    "additionalProperties": {"type": "string"},
                },
            ]
        }
    ),
]
Place = Annotated[list[str] | None, BeforeValidator(_place), ONE_OR_SEVERAL]
Bound = Annotated[float, Field(allow_inf_nan=True)]
_PLACES = ("nodes", "x", "y")  # the keys of a channel that say where its sensor is
PointOnPlate = Annotated[list[Quantity], Field(min_length=2, max_length=2)] | None
PixelRange = Annotated[list[float], Field(min_length=2, max_length=2)]


class SchemaTable(BaseModel):
    """A table of a rig file; unknown keys are errors that suggest the nearest known one."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: object) -> Any:
        if not isinstance(data, dict):
            raise ValueError(f"expected a table, got {reprlib.repr(data)}")
        known = cls.known_keys(data)
        for key in data:
            if key not in known:
                raise ValueError(unknown_name("key", key, known))
        return data

    @classmethod
    def known_keys(cls, data: dict[str, Any]) -> Iterable[str]:
        """The keys that such a table may have."""
        return cls.model_fields


class PlateTable(SchemaTable):
    columns: Annotated[list[Quantity], Field(min_length=1)] | None = None
    rows: Annotated[list[Quantity], Field(min_length=1)] | None = None
    width: Quantity | None = None
    height: Quantity | None = None
    resolution: Quantity | None = None
    thickness: Quantity
    material: Text | None = None
    density: Quantity | None = None
    specific_heat: Quantity | None = None
    conductivity: Quantity | None = None
    film_coefficient: QuantityOrList = None
    film_row_factor: Annotated[list[Quantity], Field(min_length=1)] | None = None
    film_exponent: Quantity | None = None
    emissivity: Quantity | None = None


class LinkTable(SchemaTable):
    resistance: Quantity
    factor: Annotated[float, Field(gt=0)] = 1.0
    between: Annotated[list[Text], Field(min_length=1)]


class CircuitTable(SchemaTable):
    capacitance: Quantity
    links: Annotated[list[LinkTable], Field(min_length=1)]


class BodyTable(SchemaTable):
    name: Text
    capacitance: Quantity | None = None
    initial_temperature: Quantity | None = None
    temperature: Quantity | None = None


class FanTable(SchemaTable):
    speed: Quantity
    exponent: Annotated[float, Field(gt=0, le=2)] = 0.5


class BodyLinkTable(SchemaTable):
    resistance: QuantityOrSwitch | None = None
    factor: Annotated[float, Field(gt=0)] = 1.0
    between: Annotated[list[Text], Field(min_length=1)]
    fan: FanTable | None = None
    convection: Quantity | None = None
    convection_exponent: Quantity | None = None
    radiating_area: Quantity | None = None
    emissivity: Quantity | None = None


class CellTable(SchemaTable):
    name: Text
    module: Text | None = None
    seebeck_coefficient: Quantity | None = None
    electrical_resistance: Quantity | None = None
    thermal_resistance: Quantity | None = None
    side_mass: Quantity | None = None
    side_specific_heat: Quantity | None = None
    side_capacitance: Quantity | None = None
    contacts: Annotated[dict[str, Quantity], Field(min_length=1)] | None = None
    at: PointOnPlate = None
    size: QuantityOrList = None
    angle: Quantity | None = None
    contact_resistance: Quantity | None = None
    area: Quantity | None = None
    sink_resistance: QuantityOrSwitch | None = None
    sink: Text | None = None
    sink_capacitance: Quantity | None = None
    sink_air_resistance: QuantityOrSwitch | None = None
    fan: FanTable | None = None
    initial_temperature: Quantity | None = None
    sink_initial_temperature: Quantity | None = None
    full_scale: Quantity | None = None


class TimeProportionalTable(SchemaTable):
    period: Quantity
    minimum_on: Quantity = "0 s"
    minimum_off: Quantity = "0 s"


class HeaterTable(SchemaTable):
    name: Text
    power: Quantity | None = None
    electrical_resistance: Quantity | None = None
    contacts: NamesOrResistances = None
    at: PointOnPlate = None
    size: QuantityOrList = None
    angle: Quantity | None = None
    contact_resistance: Quantity | None = None
    capacitance: Quantity | None = None
    initial_temperature: Quantity | None = None
    drive: Quantity = "proportional"
    full_scale: Quantity | None = None
    time_proportional: TimeProportionalTable | None = None


class DriverTable(SchemaTable):
    supply_voltage: Quantity | None = None
    supply_resistance: Quantity = "0 ohm"
    on_resistance: Quantity | None = None
    current_limit: Quantity | None = None
    lag: Quantity | None = None
    delay: Quantity | None = None
    counts: Annotated[int, Field(ge=1, le=2**31)] | None = None
    polarity: Annotated[Literal[1, -1], BeforeValidator(_number)] | None = None
    averaging: Literal["voltage", "on-off"] | None = None
    off_phase: Literal["brake", "open"] = "brake"


class ViewTable(SchemaTable):
    x: PixelRange
    y: PixelRange


class CommonErrorTable(SchemaTable):
    offset: Quantity
    drift: Quantity
    drift_time: Quantity
    jump: Quantity
    relaxation: Annotated[list[Quantity], Field(min_length=1)]
    events: Literal["detect", "none"] = "detect"
    interval: Quantity | None = None


class RegistrationTable(SchemaTable):
    shift_x: Quantity = "0 mm"
    shift_y: Quantity = "0 mm"
    scale: Quantity = "1"
    rotation: Quantity = "0 deg"


class CameraTable(SchemaTable):
    resolution: Annotated[
        list[Annotated[int, Field(ge=1, le=2**15)]], Field(min_length=2, max_length=2)
    ]
    noise: Quantity
    view: ViewTable
    common_error: CommonErrorTable | None = None
    registration: RegistrationTable | None = None


class SensorsTable(SchemaTable):
    noise: Quantity


class ChannelTable(SchemaTable):
    """A channel. A kind of sensor that somebody registered has keys of its own."""

    model_config = ConfigDict(extra="allow", json_schema_extra={"additionalProperties": False})

    name: Text
    sensor: Annotated[Text, AfterValidator(_sensor_kind)] | None = None
    nodes: Annotated[list[Text], Field(min_length=1)] | None = None
    x: Place = None
    y: Place = None
    gain: Quantity = "1"
    lag: Quantity | None = None

    @classmethod
    def known_keys(cls, data: dict[str, Any]) -> Iterable[str]:
        sensor = sensor_kinds().get(str(data.get("sensor")))
        own = () if sensor is None else sensor.quantities
        return (*[key for key in cls.model_fields if not own or key not in _PLACES], *own)

    def own_keys(self) -> dict[str, Any]:
        """The keys that belong to the kind of the sensor."""
        places = {key: getattr(self, key) for key in _PLACES}
        given = places | (self.model_extra or {})
        return {key: value for key, value in given.items() if value is not None}


class AmbientTable(SchemaTable):
    temperature: Quantity
    drift: Quantity | None = None


class InitialTable(SchemaTable):
    temperature: Quantity | None = None
    nodes: dict[str, Quantity] = {}


class PriorTable(SchemaTable):
    spread: Annotated[float, Field(gt=0)]
    value: float | None = None
    between_groups: Annotated[float, Field(gt=0)] | None = None


class LimitsTable(SchemaTable):
    temperature: Quantity
    cell_temperature: Quantity | None = None
    lowest: Quantity | None = None
    rate: Quantity | None = None
    frozen: Quantity | None = None
    deviation: Quantity | None = None
    command_delay: Quantity | None = None
    stop_on_alarm: bool = False
    relay: Text | None = None


class ParameterTable(SchemaTable):
    value: float
    unit: str
    bounds: Annotated[list[Bound], Field(min_length=2, max_length=2)] | None = None
    prior: PriorTable | None = None
    free: bool = False
    scope: Literal["shared", "group", "recording"] = "shared"
    description: str = ""


class InputTable(SchemaTable):
    name: Text
    value: float | Text | None = None
    unit: str | None = None
    states: list[Text] | None = None
    description: str = ""


class RigTable(SchemaTable):
    format: Format
    name: Text
    title: str = ""
    description: str = ""
    references: list[str] = []
    plate: PlateTable | None = None
    circuit: CircuitTable | None = None
    cells: list[CellTable] = []
    heaters: list[HeaterTable] = []
    bodies: list[BodyTable] = []
    links: list[BodyLinkTable] = []
    driver: DriverTable | None = None
    inputs: list[InputTable] = []
    camera: CameraTable | None = None
    sensors: SensorsTable | None = None
    channels: Annotated[list[ChannelTable], Field(min_length=1)]
    ambient: AmbientTable
    initial: InitialTable | None = None
    limits: LimitsTable | None = None
    parameters: dict[str, ParameterTable] = {}
    parameter_sets: dict[str, dict[str, float]] = {}


class ModuleTable(SchemaTable):
    format: Format
    name: Text
    title: str = ""
    references: list[str] = []
    notes: str = ""
    hot_side_temperature: Quantity
    maximum_voltage: Quantity
    maximum_current: Quantity
    maximum_temperature_difference: Quantity
    maximum_heat_flow: Quantity | None = None
    ac_resistance: Quantity | None = None
    mass: Quantity | None = None
    width: Quantity | None = None
    height: Quantity | None = None


class MaterialTable(SchemaTable):
    format: Format
    name: Text
    title: str = ""
    references: list[str] = []
    density: Quantity
    specific_heat: Quantity
    conductivity: Quantity
    diffusivity: Quantity | None = None


Model = TypeVar("Model", bound=pydantic.BaseModel)


def validate(model: type[Model], data: dict[str, Any], source: str) -> Model:
    """Checks keys and types of a whole file.

    **Arguments:**

    - `model`: the model that the file must match.
    - `data`: the file's tables, as `tomllib` reads them.
    - `source`: the file, for messages.

    **Raises:** `RigError` for the first mistake.
    """
    try:
        return model.model_validate(data)
    except pydantic.ValidationError as problem:
        first = problem.errors(include_url=False)[0]
        refuse(source, _path(data, first["loc"]), validation_message(first))


def _path(data: Any, location: tuple[int | str, ...]) -> str:
    path = ""
    for key in location:
        try:
            data = data[key]
        except (KeyError, TypeError):  # the key is missing, or its parent is not a table
            data = None
        path += f"[{label(data, key)}]" if isinstance(key, int) else f".{key}"
    return path.removeprefix(".")


def validation_message(error: Any) -> str:
    """One of the errors that pydantic found, as messages say it."""
    if error["type"] == "missing":
        return "missing, every file needs it here"
    if error["type"] == "value_error":
        return str(error["ctx"]["error"])
    if error["type"] in ("too_short", "too_long"):
        limits = error["ctx"]
        bound = "at least" if error["type"] == "too_short" else "at most"
        count = limits.get("min_length", limits.get("max_length"))
        return f"expected {bound} {count} entries, got {limits['actual_length']}"
    expected = error["msg"].removeprefix("Input should be ")
    return f"expected {expected}, got {reprlib.repr(error['input'])}"
