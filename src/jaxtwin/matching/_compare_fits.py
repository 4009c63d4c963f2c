"""The difference between two fits, in standard errors."""

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from .._arguments import of_kind
from .._display import aligned, picture
from .._number_text import short_number
from .._result import AbstractResult, dataset, table
from ..errors import MatchError
from ._fit import Fit
from ._fitted_parameters import FittedParameter

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes

TABLE_HEAD = ("parameter", "old", "new", "unit", "standard errors", "")


@final
@dataclass(frozen=True)
class ParameterDifference:
    """The difference of one parameter between two fits.

    - `name`, `unit`. `old`, `new`: the values; the mean for a parameter with a value for each
      recording.
    - `error`: the standard error of the difference, the root of the sum of both squared errors, as
      if the fits shared no recording. It is that of the logarithm if both fits matched the
      parameter by its logarithm. NaN if neither fit has a standard error.
    - `standard_errors`: the difference divided by `error`, positive if the new value is larger. It
      is 0 for an unchanged value, and NaN for a changed value without an error.
    - `notes`: differences in the treatment: held in one fit, other scope, bounds or prior.
    """

    name: str
    unit: str
    old: float
    new: float
    error: float
    standard_errors: float
    notes: tuple[str, ...]


@final
@dataclass(frozen=True, repr=False)
class FitDifference(AbstractResult):
    """The differences between two fits of one rig.

    **Arguments:**

    - `rows`: the parameters of both fits, in the order of the rig's table.
    - `only_old`, `only_new`: names of parameters that only one of the fits has.
    """

    rows: tuple[ParameterDifference, ...]
    only_old: tuple[str, ...]
    only_new: tuple[str, ...]

    @property
    def largest(self) -> float:
        """The largest absolute difference in standard errors; NaN if no parameter has an error."""
        sizes = [abs(row.standard_errors) for row in self.rows]
        return max((size for size in sizes if not math.isnan(size)), default=math.nan)

    def summary(self) -> str:
        """A text table of the parameters that differ, largest difference first."""
        lines = [aligned([TABLE_HEAD, *rows]) for rows in [self._rows()] if rows]
        for label, names in (("old", self.only_old), ("new", self.only_new)):
            lines += [f"only in the {label} fit: {', '.join(names)}"] * bool(names)
        return "\n".join(lines) or "no difference"

    def _for_json(self) -> dict[str, Any]:
        rows = {row.name: asdict(row) for row in self.rows}
        fields = ("unit", "old", "new", "standard_errors", "notes")
        parameters = {name: {field: row[field] for field in fields} for name, row in rows.items()}
        return {"parameters": parameters, "only_old": self.only_old, "only_new": self.only_new}

    def to_dataframe(self) -> "pandas.DataFrame":
        """A table with a row for every parameter, its name as index and the fields of
        `ParameterDifference` as columns; `notes` is a single text."""
        return table([asdict(row) | {"notes": ", ".join(row.notes)} for row in self.rows], "name")

    def to_xarray(self) -> "xarray.Dataset":
        """Returns the numbers of `to_dataframe` as a dataset: old, new, error and standard_errors
        (parameter), with the units as a coordinate."""
        rows = self.to_dataframe()
        numbers = ("old", "new", "error", "standard_errors", "unit")
        columns = {name: ("parameter", rows[name]) for name in numbers}
        return dataset(columns, {}, parameter=rows.index).set_coords("unit")

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Plots the differences in standard errors, the largest on top
        (`jaxtwin.plots.plot_fit_difference`)."""
        return picture("plot_fit_difference", self, ax=ax)

    def _rows(self) -> list[tuple[str, ...]]:
        changed = [row for row in self.rows if row.old != row.new or row.notes]
        changed.sort(key=lambda row: -np.nan_to_num(abs(row.standard_errors), nan=-1.0))
        return [
            (
                row.name,
                short_number(row.old),
                short_number(row.new),
                row.unit or "1",
                "-" if math.isnan(row.standard_errors) else f"{row.standard_errors:+.2f}",
                ", ".join(row.notes),
            )
            for row in changed
        ]

    def __repr__(self) -> str:
        return (
            f"<FitDifference of {len(self.rows)} parameters: at most {self.largest:.2f} "
            "standard errors>"
        )

    def _overview(self) -> "pandas.DataFrame":
        return table(self._rows(), columns=TABLE_HEAD)


def compare_fits(old: Fit, new: Fit) -> FitDifference:
    """Compares the parameters of two fits.

    **Arguments:**

    - `old`, `new`: fits of one rig, or of two versions of it.

    **Returns:** the differences. A parameter with a value for each recording is compared by its
    mean.

    **Raises:** `MatchError` if one of the arguments is not a fit.
    """
    for name, fit in (("old", old), ("new", new)):
        of_kind(f"compare_fits: {name}", fit, Fit, "a Fit, as match gives it", MatchError)
    pairs = [(old[name], new[name]) for name in old.parameters if name in new.parameters]
    return FitDifference(
        rows=tuple(_difference(before, after) for before, after in pairs),
        only_old=tuple(name for name in old.parameters if name not in new.parameters),
        only_new=tuple(name for name in new.parameters if name not in old.parameters),
    )


def _difference(old: FittedParameter, new: FittedParameter) -> ParameterDifference:
    rows = (old, new)
    if all(row.is_logarithmic and row.value > 0 for row in rows):
        change = math.log(new.value / old.value)
        errors = [row.relative_standard_error for row in rows]
    else:
        change = new.value - old.value
        errors = [row.standard_error for row in rows]
    known = [error for error in errors if not math.isnan(error)]
    error = math.hypot(*known) if known else math.nan
    apart = 0.0 if change == 0 else change / error if error > 0 else math.nan
    notes = tuple(_notes(old, new))
    return ParameterDifference(old.name, new.unit, old.value, new.value, error, apart, notes)


def _notes(old: FittedParameter, new: FittedParameter) -> list[str]:
    if old.free != new.free:
        return [f"held in the {'old' if new.free else 'new'} fit"]
    notes = [f"scope {old.scope}, now {new.scope}"] * (old.scope != new.scope)
    if (old.lower, old.upper) != (new.lower, new.upper):
        notes.append(f"bounds {old.lower:g} to {old.upper:g}, now {new.lower:g} to {new.upper:g}")
    if (old.prior_value, old.prior_spread) != (new.prior_value, new.prior_spread):
        notes.append("another prior")
    return notes
