"""The part of a controller file that describes an `LQI` or an `MPC`.

The file contains the model of the outputs, the gain of the Kalman filter, and the gains of the LQI
or the accepted deviations of the MPC. All other numbers follow from these and are computed again.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np

from .._errors import ControlError
from .._name_suggestions import unknown_name
from ..rig import Rig
from ..rig._units import TEMPERATURE, TEMPERATURE_DIFFERENCE, Kind
from ._controller import checked_measured, means_of, with_values
from ._controller_fields import Refuse, as_matrix, as_quantity, matrix, numbers, quantity
from ._lqi import LQI
from ._mpc import MPC
from ._plant import Plant, checked_plant
from ._riccati import STABLE

KINDS = {LQI: "lqi", MPC: "mpc"}

_PLAIN = Kind("a number without unit", "", "0.7", least="any")
_WEIGHT = Kind("a number without unit", "", "0.7", least="zero")
_ACCEPTED_DUTY = Kind("a duty", "", "0.05")
_RATE = Kind("a rate of the duty", "1/s", "0.05 1/s")
_PER_STATE = Kind("a temperature", "K", "1 K", least="any")
_PER_KELVIN = Kind("a gain", "1/K", "1 1/K", least="any")
_INTEGRAL = Kind("a gain", "1/(K s)", "1 1/(K s)", least="any")
_TRACKING = Kind("a gain", "K s", "1 K s", least="any")

_MODEL = {"A": _PLAIN, "B": _PLAIN, "C": _PER_STATE, "L": _PER_KELVIN}

_GAINS = {"Kx": _PLAIN, "Ki": _INTEGRAL, "Kt": _TRACKING, "N": _PER_KELVIN}

_DEVIATIONS = {
    "output_deviation": TEMPERATURE_DIFFERENCE,
    "duty_deviation": _ACCEPTED_DUTY,
    "duty_change_deviation": _ACCEPTED_DUTY,
}

_LIMIT = ("lowest", "highest", "operating_point", "C")

POINT = ("duty", "outputs", "model")

FIELDS = {
    "lqi": (*POINT, "setpoint_weight", "gains"),
    "mpc": (
        *POINT,
        "horizon",
        "preview",
        *_DEVIATIONS,
        "rate_limit",
        "excess_deviation",
        "temperature_limits",
    ),
}
"""Kind of controller -> its fields, without those of all controllers."""

REQUIRED = {
    "lqi": FIELDS["lqi"],
    "mpc": (*POINT, "horizon", *_DEVIATIONS),
}


def model_controller(
    kind: str, data: Mapping[str, Any], common: Mapping[str, Any], rig: Rig, no: Refuse
) -> LQI | MPC:
    """Makes the controller of a file.

    **Arguments:**

    - `kind`: "lqi" or "mpc".
    - `data`: the contents of the file, with all required fields and no unknown one.
    - `common`: the checked sample time, limits and measured channels.
    - `no`: raises the error.

    **Raises:** `ControlError` for values that are not allowed.
    """
    cells = len(rig.cells)
    channels = [channel.name for channel in rig.channels]
    try:
        measured = checked_measured(kind, common.get("measured"))
        outputs = len(means_of(measured, channels))
    except ControlError as error:
        no("", str(error))
    limited = _table(data.get("temperature_limits", {}), "temperature_limits", no)
    plant, L = _plant(data, limited, common["sample_time_s"], cells, outputs, channels, no)
    settings: dict[str, Any] = {key: common[key] for key in ("limits", "measured") if key in common}
    if kind == "lqi":
        settings["setpoint_weight"] = quantity(
            data["setpoint_weight"], "setpoint_weight", _WEIGHT, no
        )
        if np.ndim(settings["setpoint_weight"]) and np.size(settings["setpoint_weight"]) != cells:
            no("setpoint_weight", f"expected a number, or one for each of the {cells} cells")
        gains = _gains(data["gains"], len(plant.A), outputs, cells, no)
        lqi = with_values(_made(LQI, plant, settings, no), gains)
        _check_regulator(lqi, plant, no)
        return _with_filter(lqi, L, no)
    for name, unit in _DEVIATIONS.items():
        settings[name] = quantity(data[name], name, unit, no)
    if "rate_limit" in data:
        settings["rate_limit"] = quantity(data["rate_limit"], "rate_limit", _RATE, no)
    if limited:
        settings["temperature_limits"] = {
            name: [_celsius(row, name, key, no) for key in ("lowest", "highest")]
            for name, row in limited.items()
        }
        if "excess_deviation" not in data:
            no("excess_deviation", "expected this field, got none")
    if "excess_deviation" in data:
        settings["excess_deviation"] = quantity(
            data["excess_deviation"], "excess_deviation", TEMPERATURE_DIFFERENCE, no
        )
    settings["horizon"], settings["preview"] = data["horizon"], data.get("preview", False)
    if not isinstance(settings["preview"], bool):
        no("preview", f"expected true or false, got {settings['preview']!r}")
    return _with_filter(_made(MPC, plant, settings, no), L, no)


def model_controller_lines(controller: LQI | MPC) -> list[str]:
    """Returns the lines of the file of an `LQI` or an `MPC`, without those of all controllers."""
    filter_ = controller.kalman
    states = len(filter_.A) - len(filter_.C)
    duty = np.asarray(controller.duty, float).tolist()
    lines = [
        f"duty = {duty!r}",
        f"outputs = {_degrees(controller.outputs)}",
    ]
    tables = []
    if isinstance(controller, LQI):
        lines.append(f"setpoint_weight = {as_quantity(controller.setpoint_weight, _WEIGHT)}")
        gains = {name: as_matrix(getattr(controller, name), unit) for name, unit in _GAINS.items()}
        tables += ["", "[gains]", *(f"{name} = {text}" for name, text in gains.items())]
    else:
        lines.append(f"horizon = {controller.horizon}")
        lines.append(f"preview = {json.dumps(controller.preview)}")
        for (name, unit), value in zip(_DEVIATIONS.items(), controller.deviations, strict=True):
            lines.append(f"{name} = {as_quantity(value, unit)}")
        if controller.rate_limit is not None:
            lines.append(f"rate_limit = {as_quantity(controller.rate_limit, _RATE)}")
        soft = controller.soft
        if soft is not None:
            excess = as_quantity(soft.excess, TEMPERATURE_DIFFERENCE)
            lines.append(f"excess_deviation = {excess}")
            for row, (name, lowest, highest) in enumerate(controller.temperature_limits):
                tables += [
                    "",
                    f"[temperature_limits.{json.dumps(name)}]",
                    f'lowest = "{lowest!r} degC"',
                    f'highest = "{highest!r} degC"',
                    f'operating_point = "{float(soft.outputs[row])!r} degC"',
                    f"C = {as_matrix(np.asarray(soft.C)[row : row + 1], _PER_STATE)}",
                ]
    model = {
        "A": filter_.A[:states, :states],
        "B": filter_.B[:states],
        "C": filter_.C[:, :states],
        "L": filter_.L,
    }
    written = [f"{name} = {as_matrix(value, _MODEL[name])}" for name, value in model.items()]
    about = "# x' = A x + B u, y = C x; deviations from duty and outputs. L: of the Kalman filter."
    return [*lines, *tables, "", about, "[model]", *written]


def _plant(
    data: Mapping[str, Any],
    limited: Mapping[str, Any],
    sample_time_s: float,
    cells: int,
    outputs: int,
    channels: Sequence[str],
    no: Refuse,
) -> tuple[Plant, np.ndarray]:
    """Reads the plant and the gain of the Kalman filter."""
    model = _table(data["model"], "model", no, _MODEL)
    A = matrix(model["A"], "model.A", _PLAIN, (None, None), no)
    n = len(A)
    shapes = {"A": (n, n), "B": (n, cells), "C": (outputs, n), "L": (n + outputs, outputs)}
    A, B, C, L = (
        matrix(model[name], f"model.{name}", unit, shapes[name], no)
        for name, unit in _MODEL.items()
    )
    duty = np.array(numbers(data["duty"], "duty", no))
    if duty.shape != (cells,) or not np.all(np.abs(duty) <= 1):
        no("duty", f"expected {cells} numbers from -1 to 1, got {data['duty']!r}")
    point = np.array(_temperatures(data["outputs"], "outputs", outputs, no))
    rows, at = np.zeros((0, n)), []
    for name, row in limited.items():
        field = f"temperature_limits.{name}"
        if name not in channels:
            no(field, unknown_name("channel", name, channels))
        values = _table(row, field, no, _LIMIT)
        rows = np.vstack([rows, matrix(values["C"], f"{field}.C", _PER_STATE, (1, n), no)])
        at.append(_celsius(values, name, "operating_point", no))
    try:
        watched = rows, np.array(at)
        return checked_plant("model", (A, B, C), (duty, point), watched, sample_time_s), L
    except ControlError as error:
        no("", str(error))


def _made(
    controller: Callable[..., Any], plant: Plant, settings: Mapping[str, Any], no: Refuse
) -> Any:
    try:
        made = controller(plant, **settings)
    except ControlError as error:
        no("", str(error))
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(made)):
        no("model", "expected numbers that a controller can be designed for, got too large ones")
    return made


def _gains(
    found: object, states: int, outputs: int, cells: int, no: Refuse
) -> dict[str, np.ndarray]:
    table = _table(found, "gains", no, _GAINS)
    shapes = {
        "Kx": (cells, states),
        "Ki": (cells, outputs),
        "Kt": (outputs, cells),
        "N": (cells, outputs),
    }
    return {
        name: matrix(table[name], f"gains.{name}", unit, shapes[name], no)
        for name, unit in _GAINS.items()
    }


def _check_regulator(lqi: LQI, plant: Plant, no: Refuse) -> None:
    """Refuses gains with which the loop of the model is not stable."""
    Kx, Ki = np.asarray(lqi.Kx), np.asarray(lqi.Ki)
    outputs = len(plant.C)
    loop = np.block(
        [
            [plant.A - plant.B @ Kx, plant.B @ Ki],
            [-plant.sample_time_s * plant.C, np.eye(outputs)],
        ]
    )
    _check_stable(loop, "gains", "gains with which the loop on the model is stable", no)


def _with_filter(controller: Any, L: np.ndarray, no: Refuse) -> Any:
    found = controller.kalman
    unit = np.eye(len(found.A))
    error = np.asarray(found.A) @ (unit - L @ np.asarray(found.C))
    _check_stable(error, "model.L", "a gain with which the error of the filter goes to 0", no)
    return eqx.tree_at(lambda made: made.kalman.L, controller, L)


def _check_stable(transition: np.ndarray, field: str, expected: str, no: Refuse) -> None:
    largest = np.abs(np.linalg.eigvals(transition)).max()
    if not largest < STABLE:
        no(field, f"expected {expected}, got a pole at {largest:.9f} from 0")


def _table(
    found: object, name: str, no: Refuse, fields: Sequence[str] | Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Reads a table. If `fields` are given, it must have all of them and no other."""
    if not isinstance(found, dict):
        no(name, f"expected a table, got {found!r}")
    known = found if fields is None else fields
    for key in found:
        if key not in known:
            no(f"{name}.{key}", unknown_name("field", key, known))
    for key in known:
        if key not in found:
            no(f"{name}.{key}", "expected this field, got none")
    return found


def _temperatures(found: object, name: str, count: int, no: Refuse) -> list[float]:
    if not isinstance(found, list) or len(found) != count:
        no(name, f'expected {count} temperatures such as "40 degC", got {found!r}')
    return [_degrees_of(part, f"{name}[{n}]", no) for n, part in enumerate(found)]


def _celsius(row: Mapping[str, Any], channel: str, key: str, no: Refuse) -> float:
    return _degrees_of(row[key], f"temperature_limits.{channel}.{key}", no)


def _degrees_of(found: object, name: str, no: Refuse) -> float:
    """Converts a temperature to degC with the digits of the file: 313.15 - 273.15 is not 40."""
    if isinstance(found, str) and found.endswith(" degC"):
        try:
            number = float(found.removesuffix(" degC"))
        except ValueError:
            number = np.nan
        if -273.15 < number < 1e4:
            return number
    kelvin = quantity(found if isinstance(found, str) else None, name, TEMPERATURE, no)
    return float(kelvin) - 273.15


def _degrees(values: object) -> str:
    return (
        "[" + ", ".join(f'"{value!r} degC"' for value in np.asarray(values, float).tolist()) + "]"
    )
