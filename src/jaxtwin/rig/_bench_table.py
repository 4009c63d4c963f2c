"""Tables around the plate: `[driver]`, `[camera]`, `[limits]` of a rig file."""

from collections.abc import Sequence

from ._camera import Camera, CommonError, Registration
from ._cell import Cell
from ._driver import Driver
from ._fields import Fields
from ._heater import Heater
from ._limits import Limits
from ._schema import (
    CameraTable,
    CommonErrorTable,
    DriverTable,
    LimitsTable,
    RegistrationTable,
)
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

# The keys of `[driver]` that a rig with cells needs.
_OF_CELLS = ("supply_voltage", "on_resistance", "counts", "polarity", "averaging")


def build_driver(
    table: DriverTable | None, cells: Sequence[Cell], heaters: Sequence[Heater], fields: Fields
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
    lag, delay = (
        None if text is None else fields.value(f"driver.{name}", text, DURATION)
        for name, text in (("lag", table.lag), ("delay", table.delay))
    )
    supply_resistance, on_resistance = (
        fields.value(f"driver.{name}", getattr(table, name) or "0 ohm", SERIES_RESISTANCE)
        for name in ("supply_resistance", "on_resistance")
    )
    voltage = table.supply_voltage or "1 V"  # which nothing uses
    limit = table.current_limit
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
        current_limit=None
        if limit is None
        else fields.value("driver.current_limit", limit, CURRENT),
    )


# The largest number of characters of a relay's name, which a device repeats in its greeting.
MAX_RELAY = 32


def build_limits(table: LimitsTable, fields: Fields) -> Limits:
    """The limits.

    **Raises:** `RigError` if a value is wrong, or the lowest reading is above the highest.
    """

    def optional(name: str, kind: Kind) -> float | None:
        text = getattr(table, name)
        return None if text is None else fields.constant(f"limits.{name}", text, kind)

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


def build_camera(table: CameraTable, fields: Fields) -> Camera:
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


def _registration(table: RegistrationTable, fields: Fields) -> Registration:
    kinds = {"shift_x": SHIFT, "shift_y": SHIFT, "scale": FACTOR, "rotation": ANGLE}
    return Registration(
        **{
            name: fields.value(f"camera.registration.{name}", getattr(table, name), kind)
            for name, kind in kinds.items()
        }
    )


def _common_error(table: CommonErrorTable, fields: Fields) -> CommonError:
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
