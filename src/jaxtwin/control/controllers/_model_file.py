"""The fields of controller files that describe a linear model and its Kalman filter.

An `LQI` and an `MPC` have them. All other numbers of such a controller follow from the model, the
gain of the filter and the controller's own fields, and are computed again.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from ..._celsius import ZERO_CELSIUS
from ..._name_suggestions import unknown_name
from ...errors import ControlError
from ...rig import TEMPERATURE, Kind
from ..linear._operating_point import OperatingPoint
from ..linear._riccati import MAX_STABLE_POLE
from ..linear._state_space import StateSpace
from ._controller import AbstractController, TemperatureLimit, checked_measured, means_of
from ._controller_fields import (
    REQUIRED_OWN,
    FileContents,
    Refuse,
    as_matrix,
    field_arguments,
    matrix,
    numbers,
    quantity,
)
from ._design_model import check_plant, linear_plant
from ._duty_limits import checked_limits
from ._kalman import KalmanFilter, filter_with_gain, is_stable

# Operating point and model, which every controller that is designed on a model has.
MODEL_FIELDS = {"duty": REQUIRED_OWN, "outputs": REQUIRED_OWN, "model": REQUIRED_OWN}

PLAIN = Kind("a number without unit", "", "0.7", least="any")
PER_STATE = Kind("a temperature", "K", "1 K", least="any")
PER_KELVIN = Kind("a gain", "1/K", "1 1/K", least="any")

_MODEL = {"A": PLAIN, "B": PLAIN, "C": PER_STATE, "L": PER_KELVIN}

_LIMIT = ("lowest", "highest", "accepted_excess", "operating_point", "C", "L")

EXCESS = Kind("a temperature difference", "K", "0.1 K")


def read_model(contents: FileContents, measured: tuple[tuple[str, ...], ...] | None) -> StateSpace:
    """Reads operating point and model.

    **Arguments:**

    - `measured`: the channels of each output, as `field_settings` has them.

    **Raises:** `ControlError` for values that are not allowed.
    """
    data, refuse, cells = contents.data, contents.refuse, len(contents.rig.driven)
    try:
        outputs = len(means_of(measured, contents.channels))
    except ControlError as error:
        refuse("", str(error))
    model = read_table(data["model"], "model", refuse, _MODEL)
    A = matrix(model["A"], "model.A", PLAIN, (None, None), refuse)
    shapes = {"A": (len(A), len(A)), "B": (len(A), cells), "C": (outputs, len(A))}
    A, B, C = (
        matrix(model[name], f"model.{name}", _MODEL[name], shape, refuse)
        for name, shape in shapes.items()
    )
    duty = np.array(numbers(data["duty"], "duty", refuse))
    if duty.shape != (cells,) or not np.all(np.abs(duty) <= 1):
        refuse("duty", f"expected {cells} numbers from -1 to 1, got {data['duty']!r}")
    point = np.array(temperatures_of(data["outputs"], "outputs", outputs, refuse))
    time = contents.common["sample_time_s"]
    return linear_plant((A, B, C), duty, point, time, contents.rig.name)


def read_filter(contents: FileContents, plant: StateSpace, read: StateSpace) -> KalmanFilter:
    """Reads the Kalman filter of a model.

    **Arguments:**

    - `plant`: the model. `read`: the same with what the filter reads as its outputs.

    **Raises:** `ControlError` if there is no controller of the model, or the filter's error does
    not go to 0.
    """
    try:
        check_plant("model", plant, read)
    except ControlError as error:
        contents.refuse("", str(error))
    refuse, (readings, cells) = contents.refuse, np.shape(read.D)
    shape = len(read.A) + min(readings, cells), readings
    L = matrix(contents.data["model"]["L"], "model.L", PER_KELVIN, shape, refuse)
    kalman = filter_with_gain(read, L)
    if not is_stable(kalman):
        refuse("model.L", "expected a gain with which the error of the filter goes to 0")
    return kalman


def field_settings(controller: type[AbstractController], contents: FileContents) -> dict[str, Any]:
    """Reads the arguments of a controller beside its model."""
    limits, measured = contents.common.get("limits"), contents.common.get("measured")
    try:
        settings: dict[str, Any] = {
            "limits": checked_limits(controller.__name__, limits),
            "has_own_limits": limits is not None,
            "measured": checked_measured(controller.__name__, measured),
        }
    except ControlError as error:
        contents.refuse("", str(error))
    return settings | field_arguments(controller, controller.fields, contents)


class LimitedChannels(NamedTuple):
    """The channels with temperature limits of a file: their limits by name, and their rows of the
    model.

    - `C`, `at`: the rows, and the temperatures at the operating point, degC.
    - `L`: the gain of the filter of the error of the model at each.
    """

    limits: Mapping[str, TemperatureLimit]
    C: Float[np.ndarray, "limited state"]
    at: Float[np.ndarray, " limited"]
    L: Float[np.ndarray, " limited"]


def limited_channels(contents: FileContents, states: int) -> LimitedChannels:
    """Reads the channels with temperature limits; `states` is the number of states of the model."""
    refuse, limits = contents.refuse, {}
    C, at, L = np.zeros((0, states)), [], []
    given = contents.data.get("temperature_limits", {})
    for name, table in read_table(given, "temperature_limits", refuse).items():
        field = f"temperature_limits.{name}"
        if name not in contents.channels:
            refuse(field, unknown_name("channel", name, contents.channels))
        row = read_table(table, field, refuse, _LIMIT)
        lowest, highest, point = (
            _degrees_of(row[key], f"{field}.{key}", refuse)
            for key in ("lowest", "highest", "operating_point")
        )
        accepted = quantity(
            row["accepted_excess"], f"{field}.accepted_excess", EXCESS, refuse, is_list=False
        )
        limits[name] = TemperatureLimit(lowest, highest, float(accepted))
        C = np.vstack([C, matrix(row["C"], f"{field}.C", PER_STATE, (1, states), refuse)])
        at.append(point)
        L.append(gain_of_error(row["L"], f"{field}.L", refuse))
    return LimitedChannels(limits, C, np.array(at), np.array(L))


def limit_lines(
    name: str,
    limit: TemperatureLimit,
    operating_point: float,
    C: np.ndarray,
    L: float,
) -> list[str]:
    """Returns the table of a temperature limit of a channel."""
    lowest, highest, excess = limit
    return [
        "",
        f"[temperature_limits.{json.dumps(name)}]",
        f'lowest = "{lowest!r} degC"',
        f'highest = "{highest!r} degC"',
        f'accepted_excess = "{excess!r} K"',
        f'operating_point = "{operating_point!r} degC"',
        f"C = {as_matrix(C[None], PER_STATE)}",
        f"L = {L!r}",
    ]


def point_lines(point: OperatingPoint) -> list[str]:
    """Returns the lines of the operating point."""
    duty = np.asarray(point.duty, float).tolist()
    return [f"duty = {duty!r}", f"outputs = {as_celsius(point.outputs)}"]


def as_celsius(temperatures: object) -> str:
    """Returns the text of a list of temperatures."""
    written = (f'"{value!r} degC"' for value in np.asarray(temperatures, float).tolist())
    return f"[{', '.join(written)}]"


def model_lines(plant: StateSpace, kalman: KalmanFilter) -> list[str]:
    """Returns the table of the model and of its filter."""
    matrices = {"A": plant.A, "B": plant.B, "C": plant.C, "L": kalman.L}
    written = [f"{name} = {as_matrix(value, _MODEL[name])}" for name, value in matrices.items()]
    about = (
        "# x(k+1) = A x(k) + B u(k), y = C x: deviations from duty and outputs. L: Kalman filter's."
    )
    return ["", about, "[model]", *written]


def gain_of_error(value: object, name: str, refuse: Refuse) -> float:
    """Reads the gain of the filter of a single error, with which the error goes to 0."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 2:
        refuse(name, f"expected a number above 0 and below 2, got {value!r}")
    return float(value)


def check_numbers(controller: AbstractController, refuse: Refuse) -> None:
    """Refuses a controller whose numbers became too large for floating point."""
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(controller)):
        refuse(
            "model", "expected numbers that a controller can be designed for, got too large ones"
        )


def check_stable(transition: np.ndarray, field: str, expected: str, refuse: Refuse) -> None:
    """Refuses numbers of a file with which deviations do not die away."""
    largest = np.abs(np.linalg.eigvals(transition)).max()
    if not largest < MAX_STABLE_POLE:
        refuse(field, f"expected {expected}, got a pole at {largest:.9f} from 0")


def read_table(
    value: object,
    name: str,
    refuse: Refuse,
    fields: Sequence[str] | Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Reads a table. If `fields` are given, it must have all of them and no other."""
    if not isinstance(value, dict):
        refuse(name, f"expected a table, got {value!r}")
    known = value if fields is None else fields
    for key in value:
        if key not in known:
            refuse(f"{name}.{key}", unknown_name("field", key, known))
    for key in known:
        if key not in value:
            refuse(f"{name}.{key}", "expected this field, got none")
    return value


def temperatures_of(value: object, name: str, count: int, refuse: Refuse) -> list[float]:
    """Reads a list of `count` temperatures, degC."""
    if not isinstance(value, list) or len(value) != count:
        refuse(name, f'expected {count} temperatures such as "40 degC", got {value!r}')
    return [_degrees_of(part, f"{name}[{n}]", refuse) for n, part in enumerate(value)]


def _degrees_of(value: object, name: str, refuse: Refuse) -> float:
    """Converts a temperature to degC with the digits of the file: 313.15 - 273.15 is not 40."""
    if isinstance(value, str) and value.endswith(" degC"):
        try:
            number = float(value.removesuffix(" degC"))
        except ValueError:
            number = np.nan
        if -ZERO_CELSIUS < number < 1e4:
            return number
    kelvin = quantity(value, name, TEMPERATURE, refuse, is_list=False)
    return float(kelvin) - ZERO_CELSIUS
