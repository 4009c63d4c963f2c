"""Writes a fit to a file: a parameter file, with the tables of `_stored_fit`.

```toml
[parameters]                # and [recordings.NAME]: a parameter file, see `jaxtwin.rig`
R_E = { value = 2.2, unit = "ohm", bounds = [1.0, 4.0], free = true }

[fit]                       # the numbers of the match
rig = "dual-cell"
rmse = 0.21

[fit.parameters.R_E]        # fields that the parameter table does not have
initial = 1.96
standard_error = 0.02

[fit.unknowns]              # the optimiser's vector; positive parameters are logarithms
labels = ["R_E", "T_amb[monday]"]
covariance = [[1e-4, 0.0], [0.0, 1e-2]]

[fit.recordings.monday]
fingerprint = "9f86d081..."
```
"""

import os
from collections.abc import Mapping
from typing import Any

from .._toml_text import toml_inline, toml_key
from .._whole_file import check_ending, write_whole_file
from ..errors import ParameterError
from ..rig import parameter_file_text
from ._fit import Fit
from ._fitted_parameters import matched_parameter
from ._stored_fit import STORED_FIT_ADAPTER, stored_fit


def save_fit(fit: Fit, path: str | os.PathLike[str]) -> None:
    """Implements `Fit.save`."""
    check_ending(path, [".toml"], ParameterError)
    source = os.fspath(path)
    write_whole_file(source, fit_text(fit, source).encode("utf-8", "replace"), ParameterError)


def fit_text(fit: Fit, source: str) -> str:
    """The text of a saved fit; `source` is the name of the file in messages.

    **Raises:** `ParameterError` if a value is no finite number or outside its bounds.
    """
    rig = fit.twin.rig
    return parameter_file_text(
        source,
        [matched_parameter(row, rig.parameters[row.name]) for row in fit.parameters.values()],
        {name: values for name, values in fit.recording_values.items() if values},
        f"{rig.name} matched to {', '.join(fit.recordings)}\n"
        f"mean fit {fit.mean_fit_percent:.2f} %, RMSE {fit.rmse:.4f} K\n{fit.status}",
        _fit_tables(fit),
    )


def _fit_tables(fit: Fit) -> str:
    """The table [fit] with all that belongs to it, as TOML."""
    entries = STORED_FIT_ADAPTER.dump_python(stored_fit(fit), exclude_none=True)
    tables = {"fit": entries, "fit.unknowns": entries.pop("unknowns")}
    for kind in ("parameters", "recordings"):
        rows = entries.pop(kind).items()
        tables |= {f"fit.{kind}.{toml_key(name)}": row for name, row in rows}
    return "\n".join(_table(name, table) for name, table in tables.items())


def _table(name: str, entries: Mapping[str, Any]) -> str:
    lines = [f"{toml_key(key)} = {_toml_value(value)}\n" for key, value in entries.items()]
    return f"[{name}]\n{''.join(lines)}"


def _toml_value(value: Any) -> str:
    """A value as people read it. A list of lists or tables, such as a matrix or the iterations, has
    a line for each entry. A text of several lines, such as a rig file, stands as it was written,
    where TOML can say that."""
    if isinstance(value, list | tuple) and value and isinstance(value[0], list | tuple | dict):
        return "[\n" + "".join(f"    {toml_inline(entry)},\n" for entry in value) + "]"
    if isinstance(value, str) and "\n" in value and _is_literal(value):
        return f"'''\n{value}'''"
    return toml_inline(value)


def _is_literal(text: str) -> bool:
    return "'''" not in text and all(c.isprintable() or c in "\n\t" for c in text)
