"""Controllers as files.

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
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

import numpy as np

from .._errors import ControlError
from .._whole_file import check_ending, write_whole_file
from ..rig import Rig
from ..rig._bundled import read_toml
from ..rig._problems import refuse, unknown
from ..rig._units import Kind, parse_quantity, range_problem
from ._controller import AbstractController
from ._decoupled_pi import DecoupledPI
from ._pid import PID

Refuse: TypeAlias = Callable[[str, str], NoReturn]
"""Of field and message."""

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
}
"""Kind of controller -> its parameters, as they are called in a file."""

_REQUIRED = {"pid": ("Kp",), "decoupled-pi": tuple(_FIELDS["decoupled-pi"])[:4]}

_COMMON = ("format", "rig", "kind", "sample_time", "measured", "limits")

_ARGUMENTS = {"tracking_time": "tracking_time_s"}
"""Fields that are called otherwise in Python, where the name carries the unit."""


def read_controller(path: str | os.PathLike[str], rig: Rig) -> AbstractController:
    """Reads a controller for a rig.

    **Arguments:**

    - `path`: of the file, .toml.
    - `rig`: that it must be for.

    **Raises:** `ControlError` that names the file, the field and what is allowed, where the file
    cannot be read, is for another rig, or holds what no controller of its kind has.
    """
    data, source = read_toml(path, ControlError)

    def no(field: str, message: str) -> NoReturn:
        refuse(source, field, message, ControlError)

    if data.get("format") != FORMAT:
        no("format", f"expected {FORMAT}, got {data.get('format')!r}")
    if data.get("rig") != rig.name:
        no("rig", f"expected a controller for {rig.name!r}, got one for {data.get('rig')!r}")
    kind = data.get("kind")
    if not isinstance(kind, str) or kind not in _FIELDS:
        no("kind", f"expected one of {', '.join(_FIELDS)}, got {kind!r}")
    fields = _FIELDS[kind]
    known = (*_COMMON, *fields, *(["decoupling"] if kind == "decoupled-pi" else []))
    for name in data:
        if name not in known:
            no(name, unknown("field", name, known))
    for name in ("sample_time", *_REQUIRED[kind], *(["measured"] if kind != "pid" else [])):
        if name not in data:
            no(name, "expected this field, got none")
    arguments: dict[str, Any] = {
        _ARGUMENTS.get(name, name): _quantity(data[name], name, unit, no)
        for name, unit in fields.items()
        if name in data
    }
    arguments["sample_time_s"] = float(_quantity(data["sample_time"], "sample_time", _INTERVAL, no))
    if "limits" in data:
        arguments["limits"] = _numbers(data["limits"], "limits", no)
    if "decoupling" in data:
        rows = data["decoupling"] if isinstance(data["decoupling"], list) else [data["decoupling"]]
        arguments["decoupling"] = [_numbers(row, "decoupling", no) for row in rows]
    if "measured" in data:
        arguments["measured"] = _checked_measured(data["measured"], no)
    try:
        controller: AbstractController = (PID if kind == "pid" else DecoupledPI)(**arguments)
        outputs = len(controller.output_weights([channel.name for channel in rig.channels]))
    except (ControlError, TypeError, ValueError) as error:
        no("", str(error))
    if outputs not in (1, len(rig.cells)) or (kind != "pid" and outputs != len(rig.cells)):
        no("measured", f"expected an output for each of the {len(rig.cells)} cells, got {outputs}")
    _check_cells(arguments, fields, len(rig.cells), no)
    return controller


def save_controller(path: str | os.PathLike[str], controller: AbstractController, rig: Rig) -> None:
    """Writes a controller for a rig: as a whole or not at all.

    **Raises:** `ControlError` where it is of a kind that has no file, the ending is another than
    .toml, or the file cannot be written.
    """
    check_ending(path, [".toml"], ControlError)
    kind = {PID: "pid", DecoupledPI: "decoupled-pi"}.get(type(controller))
    if kind is None:
        raise ControlError(
            f"save_controller: controller: expected a PID or a DecoupledPI, got {controller!r}"
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
    lines.append(f"limits = {json.dumps(getattr(controller, 'limits', (-1.0, 1.0)))}")
    for name, unit in _FIELDS[kind].items():
        value = getattr(controller, _ARGUMENTS.get(name, name))
        if value is not None:
            texts = [f"{number!r} {unit.unit}".strip() for number in np.ravel(value).tolist()]
            lines.append(f"{name} = {json.dumps(texts[0] if np.ndim(value) == 0 else texts)}")
    if isinstance(controller, DecoupledPI):
        lines.append(f"decoupling = {json.dumps(np.asarray(controller.decoupling).tolist())}")
    write_whole_file(Path(path), ("\n".join(lines) + "\n").encode(), ControlError)


def _quantity(found: Any, name: str, kind: Kind, no: Refuse) -> Any:
    """A number with its unit, or a list with one for each cell; in SI units."""
    if isinstance(found, list) and found:
        return np.array([_quantity(part, f"{name}[{n}]", kind, no) for n, part in enumerate(found)])
    if not isinstance(found, str):
        no(name, f"expected {kind}, got {found!r}")
    try:
        number = parse_quantity(found, kind)
    except ValueError as problem:
        no(name, f"expected {kind}, got {found!r}, {problem}")
    problem = range_problem(number, kind)
    if problem:
        no(name, f"expected {problem}, got {found!r}")
    return number


def _numbers(found: Any, name: str, no: Refuse) -> list[float]:
    is_list = isinstance(found, list)
    if not is_list or any(isinstance(n, bool) or not isinstance(n, int | float) for n in found):
        no(name, f"expected a list of numbers, got {found!r}")
    return [float(number) for number in found]


def _checked_measured(found: Any, no: Refuse) -> list[Any]:
    def is_names(part: Any) -> bool:
        return isinstance(part, list) and bool(part) and all(isinstance(n, str) for n in part)

    if not (
        isinstance(found, list) and found and all(isinstance(p, str) or is_names(p) for p in found)
    ):
        no("measured", f"expected channels, or lists of channels, got {found!r}")
    return found


def _check_cells(
    arguments: Mapping[str, Any], fields: Mapping[str, Kind], cells: int, no: Refuse
) -> None:
    for name in fields:
        value = arguments.get(_ARGUMENTS.get(name, name))
        if value is not None and np.ndim(value) and np.shape(value) != (cells,):
            no(name, f"expected one value, or one for each of the {cells} cells, got {len(value)}")
