"""Tables around the plate: `[driver]`, `[camera]`, `[[channels]]`, `[limits]` of a rig file."""

from collections.abc import Sequence

from ._body import Body
from ._camera import Camera, Channel, CommonError, Registration, is_channel_name
from ._driver import Driver
from ._fields import Fields
from ._limits import Limits
from ._plate import AMBIENT, Plate
from ._schema import (
    CameraTable,
    ChannelTable,
    CommonErrorTable,
    DriverTable,
    LimitsTable,
    RegistrationTable,
)
from ._units import (
    ANGLE,
    COORDINATE,
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

_ROUNDING = 1e-9  # of the plate's size: sums of element sizes need not meet its edge exactly


def build_driver(table: DriverTable, fields: Fields) -> Driver:
    """The driver.

    **Raises:** `RigError` if a value is wrong.
    """
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
        fields.value(f"driver.{name}", getattr(table, name), SERIES_RESISTANCE)
        for name in ("supply_resistance", "on_resistance")
    )
    limit = table.current_limit
    return Driver(
        supply_voltage=fields.value("driver.supply_voltage", table.supply_voltage, VOLTAGE),
        supply_resistance=supply_resistance,
        on_resistance=on_resistance,
        counts=table.counts,
        polarity=table.polarity,
        averaging=table.averaging,
        off_phase=table.off_phase,
        lag=lag,
        delay=delay,
        current_limit=None
        if limit is None
        else fields.value("driver.current_limit", limit, CURRENT),
    )


LONGEST_RELAY = 32
"""The largest number of characters of a relay's name, which a device repeats in its greeting."""


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
        relay=table.relay,
    )
    name = limits.relay
    if name is not None and not (0 < len(name) <= LONGEST_RELAY and name.isprintable()):
        fields.refuse(
            "limits.relay", f"expected 1 to {LONGEST_RELAY} printable characters, got {name!r}"
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
    )


def build_channel(
    table: ChannelTable, plate: Plate, bodies: Sequence[Body], fields: Fields
) -> Channel:
    """A channel: over named elements and bodies, over a rectangle of the plate, or at one point.

    **Raises:** `RigError` if it has both or neither, or is not on the plate.
    """
    at = f"channels[{table.name}]"
    if not is_channel_name(table.name) or table.name == AMBIENT:
        # Recordings have a column for each channel, and one for the ambient temperature.
        fields.refuse(
            f"{at}.name",
            f"expected letters, digits and, between them, '_-.' and blanks, and not {AMBIENT!r}, "
            f"got {table.name!r}",
        )
    gain = fields.value(f"{at}.gain", table.gain, FACTOR)
    lag = None if table.lag is None else fields.value(f"{at}.lag", table.lag, DURATION)
    if table.nodes is not None and table.x is None and table.y is None:
        for node in table.nodes:
            free = [body.name for body in bodies if body.temperature is None]
            fields.check_element(f"{at}.nodes", node, plate.element_names, free)
        fields.check_unique(f"{at}.nodes", table.nodes)
        return Channel(table.name, tuple(table.nodes), None, None, gain, lag)
    if table.nodes is not None or table.x is None or table.y is None:
        fields.refuse(at, "expected either nodes or x with y; give one of them")
    if len(table.x) != len(table.y):
        fields.refuse(at, "expected a position in both x and y, or a range in both")
    if len(table.x) == 1:
        point = (
            _place(f"{at}.x", table.x[0], plate.width, fields),
            _place(f"{at}.y", table.y[0], plate.height, fields),
        )
        element = _element_at(plate, *point)
        return Channel(table.name, (element,), None, None, gain, lag, point)
    x = _range(f"{at}.x", table.x, plate.width, fields)
    y = _range(f"{at}.y", table.y, plate.height, fields)
    return Channel(table.name, (), x, y, gain, lag)


def _place(field: str, text: str, size: float, fields: Fields) -> float:
    place = fields.constant(field, text, COORDINATE)
    if place > size * (1 + _ROUNDING):
        fields.refuse(
            field, f"expected a position on the plate, 0 to {100 * size:g} cm, got {text!r}"
        )
    return place


def _element_at(plate: Plate, x: float, y: float) -> str:
    """The element that holds a point; on the border of two, the right or the lower one."""
    for element in reversed(plate.element_names):
        left, _, top, _ = plate.extent(element)
        if left <= x * (1 + _ROUNDING) and top <= y * (1 + _ROUNDING):
            return element
    raise AssertionError("the first element begins at the plate's corner")


def _range(field: str, texts: list[str], size: float, fields: Fields) -> tuple[float, float]:
    first, last = (fields.constant(field, text, COORDINATE) for text in texts)
    if not first < last <= size * (1 + _ROUNDING):
        fields.refuse(
            field, f"expected a range inside the plate, 0 to {100 * size:g} cm, got {texts}"
        )
    return first, min(last, size)
