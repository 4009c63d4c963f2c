"""What every result can do with its numbers.

A result declares its numbers once, in `to_xarray`: name -> dimensions, values and unit. Everything
else follows: the table, plain values for JSON, and what a notebook and a terminal show. A result
whose usual table is another one, such as a row for each parameter, has its own `to_dataframe`.
"""

import os
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ._display import aligned, html_table
from ._json_values import json_value
from ._number_text import short_number
from ._whole_file import check_ending, whole_file
from .errors import RecordingError

if TYPE_CHECKING:
    import pandas
    import xarray


class AbstractResult(ABC):
    """Numbers with names and units, as a table, a dataset, JSON, a file, text or HTML.

    A class of results must have `to_xarray`. It may have a `to_dataframe` of its own, an
    `_overview` (the table that is shown) and a `_for_json` (what `to_dict` converts).
    """

    @abstractmethod
    def to_xarray(self) -> "xarray.Dataset":
        """The numbers as a labelled dataset, with units in the attributes."""

    def to_dataframe(self) -> "pandas.DataFrame":
        """The dataset as a table, with a row for each combination of its labels (the index)."""
        return self.to_xarray().to_dataframe()

    def to_dict(self) -> dict[str, Any]:
        """The result as plain types for JSON; numbers that are not finite become None."""
        return json_value(self._for_json())

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the dataset as netCDF 3 (.nc), which needs no further library, as a whole or not
        at all.

        **Returns:** the path.

        **Raises:** `RecordingError` for another ending, and if the file cannot be written.
        """
        check_ending(path, [".nc"], RecordingError)
        data = self.to_xarray()
        for name, variable in data.variables.items():
            if variable.dtype == bool:  # which netCDF 3 does not have
                data[name] = data[name].astype("int8")
        with whole_file(path, RecordingError) as stream:
            data.to_netcdf(stream.name, engine="scipy")
        return Path(path)

    def summary(self) -> str:
        """The result in a line, and the table that a notebook shows as text."""
        return "\n".join([repr(self).removeprefix("<").removesuffix(">"), aligned(self._texts())])

    def _for_json(self) -> dict[str, Any]:
        """What `to_dict` converts: by default all variables and attributes of the dataset."""
        data = self.to_xarray()
        values = {str(name): variable.to_numpy() for name, variable in data.variables.items()}
        return data.attrs | values

    def _overview(self) -> "pandas.DataFrame":
        """The table that a notebook and `summary` show: by default the whole of `to_dataframe`."""
        return self.to_dataframe()

    def _repr_html_(self) -> str:
        head, *rows = self._texts()
        return html_table(repr(self), head, rows)

    def _texts(self) -> list[list[str]]:
        """The overview as text: the head, with the units of the dataset, and the rows, whose names
        stand first."""
        frame = self._overview()
        named = frame.reset_index() if frame.index.names != [None] else frame
        variables = self.to_xarray().variables
        units = [
            variables[name].attrs.get("units", "") if name in variables else "" for name in named
        ]
        head = [
            f"{name}, {unit}" if unit not in ("", "1") else str(name)
            for name, unit in zip(named, units, strict=True)
        ]
        rows = named.itertuples(index=False, name=None)
        return [head, *([_text(cell) for cell in row] for row in rows)]


def dataset(
    variables: Mapping[str, tuple[Any, ...]], attributes: Mapping[str, Any], **labels: Any
) -> "xarray.Dataset":
    """A labelled dataset.

    **Arguments:**

    - `variables`: name -> its dimensions, such as `"time channel"`, and its values; then its unit,
      unless it has none or several, and a longer name.
    - `attributes`: what holds for all of it.
    - `labels`: dimension -> the names along it.
    """
    import pandas
    import xarray

    data = {}
    for name, (dimensions, values, *described) in variables.items():
        axes = dimensions.split()
        # Along dimensions, indices of pandas: to convert other sequences, xarray imports pint if it
        # is installed, which takes 0.3 s.
        array = pandas.Index(values) if axes == [name] else np.asarray(values)
        data[name] = (axes, array, dict(zip(("units", "long_name"), described, strict=False)))
    indices = {name: pandas.Index(values, name=name) for name, values in labels.items()}
    return xarray.Dataset(data, indices, dict(attributes))


def table(
    data: Mapping[str, Any] | Iterable[Any],
    *index: str,
    columns: Sequence[str] | None = None,
) -> "pandas.DataFrame":
    """A data frame.

    **Arguments:**

    - `data`: name -> values of a column; or rows, which are dataclasses, dictionaries, named
      tuples, or tuples for `columns`.
    - `index`: the columns that name the rows. Without them the rows have numbers.
    - `columns`: the names of the columns of tuples.
    """
    import pandas

    whole = data if isinstance(data, Mapping) else list(data)
    frame = pandas.DataFrame(whole, columns=None if columns is None else list(columns))
    return frame.set_index(list(index)) if index else frame


def _text(cell: Any) -> str:
    if cell is None or cell != cell:
        return "-"
    if isinstance(cell, bool | np.bool):
        return "yes" if cell else "no"
    return short_number(cell) if isinstance(cell, float) else str(cell)
