"""Reads and writes controllers as TOML files.

`save_controller` writes the file of an `LQI` or an `MPC`, see `_model_controller_file`. The files
of the others, such as a `PID`, can also be written by hand:

```toml
format = 1
rig = "dual-cell"
kind = "pid"
sample_time = "1 s"
measured = [["T11", "T21"], ["T16", "T26"]]
limits = [0.0, 1.0]
Kp = "0.1 1/K"
Ki = "0.002 1/(K s)"
```
"""

import json
import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from scipy.linalg import LinAlgError

from .._errors import ControlError
from .._name_suggestions import did_you_mean, unknown_name
from .._whole_file import check_ending, write_whole_file
from ..rig import Rig
from ..rig._bundled import parse_toml, read_toml
from ..rig._problems import refuse
from ..rig._units import NOISE, Kind
from ._controller import AbstractController
from ._controller_fields import Refuse, as_quantity, groups, numbers, quantity
from ._decoupled_pi import DecoupledPI
from ._lqi import LQI
from ._model_controller_file import (
    FIELDS,
    KINDS,
    REQUIRED,
    model_controller,
    model_controller_lines,
)
from ._mpc import MPC
from ._pid import PID
from ._relay import Relay

FORMAT = 1

_PROPORTIONAL = Kind("a gain", "1/K", "0.1 1/K", least="zero")
_INTEGRAL = Kind("a gain", "1/(K s)", "0.002 1/(K s)", least="zero")
_DERIVATIVE = Kind("a gain", "s/K", "0.5 s/K", least="zero")
_INTERVAL = Kind("a time", "s", "1 s")
_FILTER = Kind("a time", "s", "2 s", least="zero")
_WEIGHT = Kind("a number without unit", "", "0.7", least="zero")

_FIELDS: dict[str, dict[str, Kind]] = {
    "pid": {
        "Kp": _PROPORTIONAL,
        "Ki": _INTEGRAL,
        "Kd": _DERIVATIVE,
        "Tf": _FILTER,
        "setpoint_weight": _WEIGHT,
        "derivative_weight": _WEIGHT,
        "tracking_time": _INTERVAL,
    },
    "decoupled-pi": {
        "Kp_mean": _PROPORTIONAL,
        "Ki_mean": _INTEGRAL,
        "Kp_difference": _PROPORTIONAL,
        "Ki_difference": _INTEGRAL,
        "setpoint_weight": _WEIGHT,
    },
    "relay": {
        "amplitude": Kind("a duty", "", "0.1", least="zero"),
        "bias": Kind("a duty", "", "0.4", least="any"),
        "hysteresis": NOISE,
        "timeout": _INTERVAL,
    },
}
"""Kind of controller -> name of a parameter in the file -> its quantity."""

_LAWS: dict[str, type[AbstractController]] = {
    "pid": PID,
    "decoupled-pi": DecoupledPI,
    "relay": Relay,
}
"""Kind of controller -> its class, for those whose file holds their parameters."""

_NAMES = {law: kind for kind, law in _LAWS.items()} | KINDS

PID_UNITS = {name: _FIELDS["pid"][name].unit for name in ("Kp", "Ki", "Kd", "Tf")}
"""Gain or filter time of a PID -> its unit in the file."""

_KNOWN = {
    "pid": tuple(_FIELDS["pid"]),
    "decoupled-pi": (*_FIELDS["decoupled-pi"], "decoupling"),
    "relay": tuple(_FIELDS["relay"]),
    **FIELDS,
}

_REQUIRED = {
    "pid": ("Kp",),
    "decoupled-pi": ("measured", *tuple(_FIELDS["decoupled-pi"])[:4]),
    "relay": ("amplitude", "bias", "hysteresis"),
    **REQUIRED,
}

_COMMON = ("format", "rig", "kind", "sample_time", "measured", "limits")

_ARGUMENTS = {"tracking_time": "tracking_time_s", "timeout": "timeout_s"}
"""Name of a field -> name of its argument in Python, if the argument's name has a unit."""

_OF_ALL_CELLS = ("hysteresis", "timeout")
"""Fields that are one number, not one for each cell."""


def read_controller(path: str | os.PathLike[str], rig: Rig) -> AbstractController:
    """Reads a controller for a rig.

    **Arguments:**

    - `path`: the .toml file.
    - `rig`: the rig that the file must name.

    **Returns:** a `PID`, a `DecoupledPI`, an `LQI`, an `MPC` or a `Relay`.

    **Raises:** `ControlError` if the file cannot be read, is for another rig, or has a field or a
    value that is not allowed. The message names the file and the field.
    """
    return _controller(*read_toml(path, ControlError), rig)


def save_controller(path: str | os.PathLike[str], controller: AbstractController, rig: Rig) -> None:
    """Writes a controller for a rig to a .toml file. If writing fails, the file is left as it was.

    **Arguments:**

    - `path`: the .toml file.
    - `controller`: a `PID`, a `DecoupledPI`, an `LQI`, an `MPC` or a `Relay`.
    - `rig`: the rig that the controller is for.

    **Raises:** `ControlError` for another kind of controller, for a controller that does not fit
    the rig, for another ending than .toml, and if the file cannot be written.
    """
    if isinstance(path, AbstractController) or not isinstance(rig, Rig):
        order = (type(given).__name__ for given in (path, controller, rig))
        raise ControlError(
            "save_controller: expected save_controller(path, controller, rig), in this order, got "
            f"save_controller({', '.join(order)})"
        )
    check_ending(path, [".toml"], ControlError)
    kind = _NAMES.get(type(controller))
    if kind is None:
        raise ControlError(
            "save_controller: controller: expected a PID, a DecoupledPI, an LQI, an MPC or a "
            f"Relay, got {controller!r}"
        )
    lines = [
        f"format = {FORMAT}",
        f"rig = {json.dumps(rig.name)}",
        f'kind = "{kind}"',
        f'sample_time = "{controller.sample_time_s!r} s"',
    ]
    measured = getattr(controller, "measured", None)
    if measured is not None:
        lines.append(f"measured = {json.dumps(measured)}")
    lines.append(f"limits = {json.dumps(controller.limits)}")
    if isinstance(controller, LQI | MPC):
        lines += model_controller_lines(controller)
    else:
        for name, unit in _FIELDS[kind].items():
            value = getattr(controller, _ARGUMENTS.get(name, name))
            if value is not None:
                lines.append(f"{name} = {as_quantity(value, unit)}")
    if isinstance(controller, DecoupledPI):
        lines.append(f"decoupling = {json.dumps(np.asarray(controller.decoupling).tolist())}")
    content = ("\n".join(lines) + "\n").encode()
    _controller(parse_toml(content, f"save_controller: {path}", ControlError), str(path), rig)
    write_whole_file(Path(path), content, ControlError)


def _controller(data: Mapping[str, Any], source: str, rig: Rig) -> AbstractController:
    """Makes a controller from the contents of a file.

    **Arguments:**

    - `source`: the name of the file in messages.
    """

    def no(field: str, message: str) -> NoReturn:
        refuse(source, field, message, ControlError)

    if data.get("format") != FORMAT:
        no("format", f"expected {FORMAT}, got {data.get('format')!r}")
    if data.get("rig") != rig.name:
        no("rig", f"expected a controller for {rig.name!r}, got one for {data.get('rig')!r}")
    kind = data.get("kind")
    if not isinstance(kind, str) or kind not in _NAMES.values():
        hint = did_you_mean([str(kind)], _NAMES.values())
        no("kind", f"expected one of {', '.join(_NAMES.values())}, got {kind!r}{hint}")
    known = (*_COMMON, *_KNOWN[kind])
    for name in data:
        if name not in known:
            no(name, unknown_name("field", name, known))
    for name in ("sample_time", *_REQUIRED[kind]):
        if name not in data:
            no(name, "expected this field, got none")
    arguments: dict[str, Any] = {
        "sample_time_s": quantity(data["sample_time"], "sample_time", _INTERVAL, no, is_list=False)
    }
    if "limits" in data:
        arguments["limits"] = numbers(data["limits"], "limits", no)
    if "measured" in data:
        arguments["measured"] = groups(data["measured"], no)
    channels = [channel.name for channel in rig.channels]
    try:
        if kind in FIELDS:
            # Overflows warn here; they are refused at the end as numbers that are not finite.
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # includes LinAlgWarning
                return model_controller(kind, data, arguments, rig, no)
        return _law(kind, data, arguments, rig, channels, no)
    except (ArithmeticError, LinAlgError, TypeError, ValueError) as error:
        no("", str(error))


def _law(
    kind: str,
    data: Mapping[str, Any],
    arguments: dict[str, Any],
    rig: Rig,
    channels: Sequence[str],
    no: Refuse,
) -> AbstractController:
    """Makes a controller whose file holds its parameters, without a model."""
    fields = _FIELDS[kind]
    arguments |= {
        _ARGUMENTS.get(name, name): quantity(
            data[name], name, unit, no, is_list=name not in _OF_ALL_CELLS
        )
        for name, unit in fields.items()
        if name in data
    }
    if "decoupling" in data:
        rows = data["decoupling"] if isinstance(data["decoupling"], list) else [data["decoupling"]]
        arguments["decoupling"] = [numbers(row, "decoupling", no) for row in rows]
    if kind == "relay" and "measured" in arguments:
        if len(arguments["measured"]) != 1:
            no(
                "measured",
                f"expected one output, got {len(arguments['measured'])}; channels that are "
                'averaged have brackets of their own, such as [["T11", "T16"]]',
            )
        (arguments["measured"],) = arguments["measured"]
    try:
        controller = _LAWS[kind](**arguments)
        outputs = len(controller.output_weights(channels))
    except ControlError as error:
        no("", str(error))
    if outputs not in (1, len(rig.cells)) or (kind == "decoupled-pi" and outputs != len(rig.cells)):
        no("measured", f"expected an output for each of the {len(rig.cells)} cells, got {outputs}")
    _check_cells(arguments, fields, len(rig.cells), no)
    return controller


def _check_cells(
    arguments: Mapping[str, Any], fields: Mapping[str, Kind], cells: int, no: Refuse
) -> None:
    for name in fields:
        value = arguments.get(_ARGUMENTS.get(name, name))
        if value is not None and np.ndim(value) and np.shape(value) != (cells,):
            no(name, f"expected one value, or one for each of the {cells} cells, got {len(value)}")
