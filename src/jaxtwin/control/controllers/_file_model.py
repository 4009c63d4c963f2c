"""The fields of controller files that describe a linear model and its Kalman filter.

An `LQI` and an `MPC` have them. All other numbers of such a controller follow from the model, the
gain of the filter and the controller's own fields, and are computed again.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from ..._celsius import ZERO_CELSIUS
from ..._name_suggestions import unknown_name
from ...errors import ControlError
from ...rig import TEMPERATURE, Kind
from ..linear._riccati import MAX_STABLE_POLE
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
from ._kalman import KalmanFilter
from ._plant import DesignPlant, Temperatures, checked_plant

Designed = TypeVar("Designed", bound=AbstractController)

# Operating point and model, which every controller that is designed on a model has.
MODEL_FIELDS = {"duty": REQUIRED_OWN, "outputs": REQUIRED_OWN, "model": REQUIRED_OWN}

PLAIN = Kind("a number without unit", "", "0.7", least="any")
PER_STATE = Kind("a temperature", "K", "1 K", least="any")
PER_KELVIN = Kind("a gain", "1/K", "1 1/K", least="any")

_MODEL = {"A": PLAIN, "B": PLAIN, "C": PER_STATE, "L": PER_KELVIN}

_LIMIT = ("lowest", "highest", "accepted_excess", "operating_point", "C", "L")

EXCESS = Kind("a temperature difference", "K", "0.1 K")


class FileModel(NamedTuple):
    """The model of a controller file, the gain of its Kalman filter, and the gains of the filters
    of the watched channels."""

    plant: DesignPlant
    L: Float[np.ndarray, "state reading"]
    of_watched: Float[np.ndarray, " watched"]


class FileEvenness(NamedTuple):
    """The channels and the points of a controller file that has some which are to be even, and the
    gain of the filter of the errors at the channels."""

    channels: Temperatures
    points: Temperatures
    L: float


NONE = Temperatures(np.zeros((0, 0)), np.zeros(0))

# That of a controller without such points.
NOT_EVEN = FileEvenness(NONE, NONE, 0.0)


def read_model(contents: FileContents, kind: str, evenness: FileEvenness = NOT_EVEN) -> FileModel:
    """Reads operating point, model and filter, and the models of channels with temperature limits.

    **Arguments:**

    - `kind`: the kind of the controller, for messages.
    - `evenness`: what the file says of points that are to be even.

    **Raises:** `ControlError` for values that are not allowed.
    """
    refuse = contents.refuse
    try:
        measured = checked_measured(kind, contents.common.get("measured"))
        outputs = len(means_of(measured, contents.channels))
    except ControlError as error:
        refuse("", str(error))
    return _file_model(contents, outputs, evenness)


def model_settings(controller: type[AbstractController], contents: FileContents) -> dict[str, Any]:
    """Reads the arguments of a controller beside its model, whose sample time it has."""
    common = {key: value for key, value in contents.common.items() if key != "sample_time_s"}
    return common | field_arguments(controller, controller.fields, contents)


def temperature_limits(contents: FileContents) -> dict[str, TemperatureLimit]:
    """Reads the limits of each limited channel."""
    result, refuse = {}, contents.refuse
    for name, row in contents.data.get("temperature_limits", {}).items():
        lowest, highest = (_celsius(row, name, key, refuse) for key in ("lowest", "highest"))
        field = f"temperature_limits.{name}.accepted_excess"
        excess = quantity(row["accepted_excess"], field, EXCESS, refuse, is_list=False)
        result[name] = TemperatureLimit(lowest, highest, float(excess))
    return result


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


def point_lines(duty: object, outputs: object) -> list[str]:
    """Returns the lines of the operating point."""
    return [f"duty = {np.asarray(duty, float).tolist()!r}", f"outputs = {as_celsius(outputs)}"]


def as_celsius(temperatures: object) -> str:
    """Returns the text of a list of temperatures."""
    written = (f'"{value!r} degC"' for value in np.asarray(temperatures, float).tolist())
    return f"[{', '.join(written)}]"


def model_lines(
    kalman: KalmanFilter, C: Float[np.ndarray, "outputs state"] | None = None
) -> list[str]:
    """Returns the table of the model and of its filter. `C`: that of the outputs, if the filter
    reads something else."""
    states = len(kalman.A) - min(kalman.B.shape[1], len(kalman.C))
    model = {
        "A": kalman.A[:states, :states],
        "B": kalman.B[:states],
        "C": kalman.C[:, :states] if C is None else C,
        "L": kalman.L,
    }
    written = [f"{name} = {as_matrix(value, _MODEL[name])}" for name, value in model.items()]
    about = "# x' = A x + B u, y = C x; deviations from duty and outputs. L: of the Kalman filter."
    return ["", about, "[model]", *written]


def designed(
    controller: Callable[..., Designed], model: FileModel, settings: dict[str, Any], refuse: Refuse
) -> Designed:
    """Designs a controller on the model of a file, with the filter of the file.

    **Raises:** `ControlError` if there is no such design, or the filter's error does not go to 0.
    """
    try:
        made: Any = controller(model.plant, **settings)
    except ControlError as error:
        refuse("", str(error))
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(made)):
        refuse(
            "model", "expected numbers that a controller can be designed for, got too large ones"
        )
    kalman = made.kalman
    error = np.asarray(kalman.A) @ (np.eye(len(kalman.A)) - model.L @ np.asarray(kalman.C))
    check_stable(error, "model.L", "a gain with which the error of the filter goes to 0", refuse)
    made = eqx.tree_at(lambda made: made.kalman.L, made, model.L)
    if len(model.of_watched):
        made = eqx.tree_at(lambda made: made.watched.L, made, model.of_watched)
    return made


def _file_model(contents: FileContents, outputs: int, evenness: FileEvenness) -> FileModel:
    """Reads the plant and the gains of the filters."""
    data, refuse = contents.data, contents.refuse
    cells, (own, points, own_gain) = len(contents.rig.driven), evenness
    limited = read_table(data.get("temperature_limits", {}), "temperature_limits", refuse)
    model = read_table(data["model"], "model", refuse, _MODEL)
    A = matrix(model["A"], "model.A", PLAIN, (None, None), refuse)
    n = len(A)
    read = len(limited) + len(own.at) if len(points.at) else outputs
    shapes = {"A": (n, n), "B": (n, cells), "C": (outputs, n), "L": (n + min(read, cells), read)}
    A, B, C, L = (
        matrix(model[name], f"model.{name}", unit, shapes[name], refuse)
        for name, unit in _MODEL.items()
    )
    duty = np.array(numbers(data["duty"], "duty", refuse))
    if duty.shape != (cells,) or not np.all(np.abs(duty) <= 1):
        refuse("duty", f"expected {cells} numbers from -1 to 1, got {data['duty']!r}")
    point = np.array(temperatures_of(data["outputs"], "outputs", outputs, refuse))
    rows, at, gains = np.zeros((0, n)), [], []
    for name, row in limited.items():
        field = f"temperature_limits.{name}"
        if name not in contents.channels:
            refuse(field, unknown_name("channel", name, contents.channels))
        values = read_table(row, field, refuse, _LIMIT)
        rows = np.vstack([rows, matrix(values["C"], f"{field}.C", PER_STATE, (1, n), refuse)])
        at.append(_celsius(values, name, "operating_point", refuse))
        gains.append(gain_of_error(values["L"], f"{field}.L", refuse))
    if len(points.at):
        for name, part in (("channels", own), ("points", points)):
            if part.C.shape[1] != n:
                refuse(f"evenness.{name}.C", f"expected {n} columns, as model.A has")
        rows, at = np.vstack([rows, own.C]), [*at, *own.at]
        gains += [own_gain] * len(own.at)
    else:
        points = Temperatures(np.zeros((0, n)), np.zeros(0))
    try:
        watched = Temperatures(rows, np.array(at))
        time = contents.common["sample_time_s"]
        plant = checked_plant("model", (A, B, C), (duty, point), watched, points, time)
    except ControlError as error:
        refuse("", str(error))
    return FileModel(plant, L, np.array(gains))


def gain_of_error(value: object, name: str, refuse: Refuse) -> float:
    """Reads the gain of the filter of a single error, with which the error goes to 0."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 2:
        refuse(name, f"expected a number above 0 and below 2, got {value!r}")
    return float(value)


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


def _celsius(row: Mapping[str, Any], channel: str, key: str, refuse: Refuse) -> float:
    return _degrees_of(row[key], f"temperature_limits.{channel}.{key}", refuse)


def _degrees_of(value: object, name: str, refuse: Refuse) -> float:
    """Converts a temperature to degC with the digits of the file: 313.15 - 273.15 is not 40."""
    if isinstance(value, str) and value.endswith(" degC"):
        try:
            number = float(value.removesuffix(" degC"))
        except ValueError:
            number = np.nan
        if -ZERO_CELSIUS < number < 1e4:
            return number
    kelvin = quantity(value if isinstance(value, str) else None, name, TEMPERATURE, refuse)
    return float(kelvin) - ZERO_CELSIUS
