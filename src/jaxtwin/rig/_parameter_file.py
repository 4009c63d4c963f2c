"""Parameter files: values in the form of a rig file's parameter table, as matching saves them.

```toml
[parameters]
R_E = { value = 2.2, unit = "ohm", bounds = [1.0, 4.0], free = true }
T_amb = { value = 16.0, unit = "degC", scope = "recording" }

[recordings.zone-A]         # values that differ between recordings, in the units above
T_amb = 16.4
```
"""

import json
import math
import os
import reprlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any, NoReturn

from .._name_suggestions import unknown_name
from .._whole_file import check_ending, write_whole_file
from ..errors import ParameterError
from ._build import load_rig
from ._rig import Rig
from ._toml import read_toml, refuse
from ._units import unit_scale
from ._value import Parameter


def write_parameters(
    path: str | os.PathLike[str],
    parameters: Iterable[Parameter],
    recordings: Mapping[str, Mapping[str, float]] | None = None,
    comment: str = "",
    tables: str = "",
) -> None:
    """Writes a parameter file: as a whole or not at all.

    **Arguments:**

    - `path`: the path of the file, .toml. An existing file is replaced.
    - `parameters`: the parameters with the values to write;
      `dataclasses.replace(parameter, value=...)` makes a parameter with another value.
    - `recordings`: recording -> parameter -> value in the parameter's unit, for those that have a
      value for each recording.
    - `comment`: a comment at the top of the file.
    - `tables`: the TOML of other tables at the end of the file, which readers of parameters skip.

    **Raises:** `ParameterError` if a value is no finite number or outside its bounds, a
    recording has an unknown parameter, the ending is another, or the file cannot be written.
    """
    check_ending(path, [".toml"], ParameterError)
    source = os.fspath(path)
    text = parameter_file_text(source, parameters, recordings, comment, tables)
    write_whole_file(source, text.encode("utf-8", "replace"), ParameterError)


def parameter_file_text(
    source: str,
    parameters: Iterable[Parameter],
    recordings: Mapping[str, Mapping[str, float]] | None,
    comment: str,
    tables: str,
) -> str:
    """The text of a parameter file; `source` is the name of the file in messages. The other
    arguments and the errors are those of `write_parameters`."""
    table = {parameter.name: parameter for parameter in parameters}
    for name, parameter in table.items():
        _bounded(source, f"parameters.{name}", parameter.value, parameter)
    for recording, values in (recordings or {}).items():
        for name, value in values.items():
            field = f"recordings.{recording}.{name}"
            if name not in table:
                _refuse(source, field, unknown_name("parameter", name, table))
            _bounded(source, field, value, table[name])
    text = "".join(f"# {line}\n" for line in comment.splitlines() if line.isprintable())
    text += parameters_toml(table.values())
    for recording, values in (recordings or {}).items():
        text += f"\n[recordings.{_quoted(recording)}]\n"
        text += "".join(f"{name} = {float(value)!r}\n" for name, value in values.items())
    return text + f"\n{tables}" * bool(tables)


def parameters_toml(parameters: Iterable[Parameter]) -> str:
    """The `[parameters]` table of a rig file or a parameter file."""
    lines = ["[parameters]"]
    for p in parameters:
        entries = [f"value = {float(p.value)!r}", f"unit = {_quoted(p.unit)}"]
        if math.isfinite(p.lower) or math.isfinite(p.upper):
            entries.append(f"bounds = [{float(p.lower)!r}, {float(p.upper)!r}]")
        if p.prior_spread is not None:
            # The value may have been matched since; the prior keeps its centre.
            prior = {
                "value": p.prior_value,
                "spread": p.prior_spread,
                "between_groups": p.group_spread,
            }
            known = ", ".join(f"{k} = {float(v)!r}" for k, v in prior.items() if v is not None)
            entries.append(f"prior = {{ {known} }}")
        entries += ["free = true"] * p.free
        entries += [f"scope = {_quoted(p.scope)}"] * (p.scope != "shared")
        entries += [f"description = {_quoted(p.description)}"] * bool(p.description)
        lines.append(f"{p.name} = {{ {', '.join(entries)} }}")
    return "\n".join(lines) + "\n"


def read_parameters(
    path: str | os.PathLike[str],
    rig: Rig | str | os.PathLike[str],
    recording: str | None = None,
) -> dict[str, float]:
    """Reads the values of a parameter file for a rig.

    **Arguments:**

    - `path`: the path of the file, which may also be a rig file.
    - `rig`: the rig to which the parameters belong.
    - `recording`: the recording whose values are taken, if the file has values for it.

    **Returns:** name -> value in the unit of the rig's parameter table, for the parameters in the
    file.

    **Raises:** `ParameterError` if the file cannot be read, a parameter is not the rig's, its
    unit measures something else, or its value is no finite number or outside its bounds: those in
    the file if it has some (matching may have widened them), else those of the rig.
    """
    rig = load_rig(rig)
    data, source = read_toml(path, ParameterError)
    return parsed_values(data, source, rig, recording)


def parsed_values(
    data: Mapping[str, Any], source: str, rig: Rig, recording: str | None = None
) -> dict[str, float]:
    """The values in the tables of a parameter file; `source` is the name of the file in messages.
    The other arguments, the result and the errors are those of `read_parameters`."""
    table = data.get("parameters")
    if not isinstance(table, dict):
        _refuse(source, "parameters", "expected a table [parameters], got none")
    recordings = data.get("recordings", {})
    own = recordings.get(recording, {}) if isinstance(recordings, dict) else None
    if not isinstance(own, dict):
        _refuse(source, "recordings", "expected tables [recordings.NAME]")
    values = {}
    for name, row in table.items():
        values[name] = _value(source, f"parameters.{name}", name, row, rig)
    for name, value in own.items():
        field = f"recordings.{recording}.{name}"
        if name not in table:
            _refuse(source, field, unknown_name("parameter", name, table))
        values[name] = _value(source, field, name, {**table[name], "value": value}, rig)
    return values


def _value(source: str, field: str, name: str, row: object, rig: Rig) -> float:
    if name not in rig.parameters:
        _refuse(source, field, unknown_name(f"parameter of {rig.name}", name, rig.parameters))
    parameter = rig.parameters[name]
    if not isinstance(row, dict) or not isinstance(row.get("unit"), str):
        _refuse(source, field, f'expected {{ value = 1.0, unit = "..." }}, got {reprlib.repr(row)}')
    try:
        scale, offset = unit_scale(row["unit"], parameter.unit)
    except ValueError as problem:
        _refuse(source, field, f"expected a unit like {parameter.unit!r}, but {problem}")

    def number(value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            _refuse(source, field, f"expected a number, got {reprlib.repr(value)}")
        with suppress(OverflowError):
            value = float(value)
        if (scale, offset) == (parameter.scale, parameter.offset):
            return value  # exactly as written
        return parameter.from_si(scale * value + offset)

    bounds = row.get("bounds", [])
    if not isinstance(bounds, list) or len(bounds) not in (0, 2):
        _refuse(source, field, f"expected bounds as [lower, upper], got {reprlib.repr(bounds)}")
    if bounds:
        lower, upper = (number(bound) for bound in bounds)
        if parameter.lower > 0 >= lower:
            _refuse(source, field, f"expected a lower bound above 0, got {lower:.10g}")
        parameter = replace(parameter, lower=lower, upper=upper)
    return _bounded(source, field, number(row.get("value")), parameter)


def _bounded(source: str, field: str, value: float, parameter: Parameter) -> float:
    lower, upper = parameter.lower, parameter.upper
    # A value at a bound may have been through a logarithm or another unit.
    if any(math.isclose(value, bound, rel_tol=1e-12) for bound in (lower, upper)):
        value = min(max(value, lower), upper)
    if not (lower <= value <= upper and math.isfinite(value)):
        _refuse(source, field, f"expected {lower:.10g} to {upper:.10g}, got {value:.10g}")
    return value


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _refuse(source: str, field: str, message: str) -> NoReturn:
    refuse(source, field, message, ParameterError)
