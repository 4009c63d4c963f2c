"""The result of a design of a rig."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

from ..._arguments import path_of
from ..._display import html_table, picture
from ..._whole_file import check_ending, write_whole_file
from ...errors import ControlError
from ...physics import Twin
from ...rig import Rig
from ..linear._operating_point import OperatingPoint

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


class PlacedCells(NamedTuple):
    """Cells and heaters at places on the plate, and how even it is with them.

    - `places`: name -> x and y of the middle of its face, from the left and from the top edge, m.
    - `twin`: the twin of this rig.
    - `point`: the most even steady state at the mean. If the cells cannot hold the mean, which may
      be so before the design, the nearest one.
    - `unevenness`: the objective in this state, K.
    """

    places: Mapping[str, tuple[float, float]]
    twin: Twin
    point: OperatingPoint
    unevenness: float


@final
@dataclass(frozen=True, repr=False, eq=False)
class RigDesign:
    """The places of cells and heaters with which the plate of a rig is most even.

    **Arguments:**

    - `temperature`: the mean of all channels, degC.
    - `objective`: what was made small, `"range"` or `"standard deviation"`.
    - `before`, `after`: the cells and heaters that move, and further ones.
    - `optima`: the objective at the end of each search, K, the smallest first. Where several are
      equal, the design is hardly a local optimum.
    """

    temperature: float
    objective: str
    before: PlacedCells
    after: PlacedCells
    optima: tuple[float, ...]

    @property
    def twin(self) -> Twin:
        """The twin of the designed rig."""
        return self.after.twin

    @property
    def rig(self) -> Rig:
        """The designed rig."""
        return self.after.twin.rig

    @property
    def text(self) -> str:
        """The rig file: that of the rig before, with other places and further cells."""
        return self.rig.text

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes the rig file, a .toml file that `jaxtwin.Twin` reads.

        **Returns:** the path.

        **Raises:** `ControlError` for another ending, or if it cannot be written.
        """
        check_ending(path, [".toml"], ControlError)
        write_whole_file(path, self.text.encode(), ControlError)
        return path_of("save: path", path, ControlError)

    def plot(self) -> "Figure":
        """Plots the plate before and after: `jaxtwin.plots.plot_rig_design`."""
        return picture("plot_rig_design", self)

    def to_dataframe(self) -> "pandas.DataFrame":
        """A table with a row for each cell or heater (its name is the index): x and y, m, and duty,
        before and after; NaN before for further cells."""
        import pandas

        columns = ("x before", "y before", "duty before", "x", "y", "duty")
        rows = [(*_row(self.before, name), *_row(self.after, name)) for name in self.after.places]
        index = pandas.Index([*self.after.places], name="cell")
        return pandas.DataFrame(rows, columns=list(columns), index=index)

    def to_xarray(self) -> "xarray.Dataset":
        """A dataset of place (rig, cell, axis) and duty (rig, cell), NaN for cells that are further
        ones, and of the range of the plate (rig); `rig` is before or after."""
        import xarray

        names, both = [*self.after.places], (self.before, self.after)
        table: Any = [[_row(placed, name) for name in names] for placed in both]
        return xarray.Dataset(
            {
                "place": (
                    ("rig", "cell", "axis"),
                    [[row[:2] for row in rows] for rows in table],
                    {"units": "m"},
                ),
                "duty": (("rig", "cell"), [[row[2] for row in rows] for rows in table]),
                "plate_range": ("rig", [one.point.range for one in both], {"units": "K"}),
            },
            coords={"rig": ["before", "after"], "cell": names, "axis": ["x", "y"]},
            attrs={
                "rig_name": self.rig.name,
                "objective": self.objective,
                "mean_degC": self.temperature,
            },
        )

    def __repr__(self) -> str:
        places = ", ".join(
            f"{name} at {100 * x:.2f} cm, {100 * y:.2f} cm"
            for name, (x, y) in self.after.places.items()
        )
        return (
            f"<RigDesign of {self.rig.name}: {self.objective} of the plate "
            f"{self.before.unevenness:.2f} -> {self.after.unevenness:.2f} K at a mean of "
            f"{self.temperature:g} degC; {places}>"
        )

    def _repr_html_(self) -> str:
        rows = [
            (name, *(_text(value, scale) for value, scale in zip(row, _SCALES * 2, strict=True)))
            for name, row in zip(
                self.after.places,
                ((*_row(self.before, n), *_row(self.after, n)) for n in self.after.places),
                strict=True,
            )
        ]
        head = ("", "x before, cm", "y before, cm", "duty before", "x, cm", "y, cm", "duty")
        return html_table(repr(self), head, rows)


_SCALES = (100.0, 100.0, 1.0)


def _text(value: float, scale: float) -> str:
    return "" if value != value else f"{scale * value:.4g}"


def _row(placed: PlacedCells, name: str) -> tuple[float, float, float]:
    """x, y and duty of a cell; NaN if it is not there."""
    if name not in placed.places:
        return nan, nan, nan
    duty = dict(zip(placed.point.cell_names, placed.point.duty, strict=True))
    return (*placed.places[name], float(duty[name]))
