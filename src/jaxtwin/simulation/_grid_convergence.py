"""The grid of a plate by the accuracy wanted: the readings on finer and finer grids.

The error of the readings falls about with the square of the size of an element, but not evenly,
because the lines of each grid cut cells and zones at other places. Two grids may therefore agree by
chance. The grid is fine enough where three do, and all are compared with the finest.
"""

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from .._arguments import finite_number
from .._result import AbstractResult, dataset, table
from ..errors import SimulationError
from ..io import Experiment
from ..physics import MAX_ELEMENTS, Twin, check_twin
from ..rig import check_has_plate, with_resolution
from ._simulate import simulate

if TYPE_CHECKING:
    import pandas
    import xarray

# The resolution of the first grid, as a fraction of the smaller side of the plate.
FIRST_RESOLUTION = 0.5

# The resolution of each grid as a fraction of that of the one before.
REFINEMENT_RATIO = math.sqrt(0.5)


@final
@dataclass(frozen=True)
class Grid:
    """A grid of the plate, and its error.

    - `resolution`: m. `elements`: their number.
    - `change`: the largest change of a reading from the grid before to this one, K; NaN for the
      first.
    - `error`: the largest difference of a reading from that on the finest grid, K.
    """

    resolution: float
    elements: int
    change: float
    error: float


@final
@dataclass(frozen=True, repr=False)
class GridConvergence(AbstractResult):
    """Readings on finer and finer grids, the result of `grid_convergence`.

    - `grids`: from the coarsest to the finest.
    - `tolerance`: the largest error of a reading that is accepted, K.
    - `name`: the name of the rig.
    """

    grids: tuple[Grid, ...]
    tolerance: float
    name: str

    @property
    def resolution(self) -> float | None:
        """The coarsest resolution which keeps the tolerance, as all finer ones do, m. None if the
        readings still change by more than half of the tolerance on the finest grids."""
        if not _agree([grid.error for grid in self.grids], self.tolerance):
            return None
        kept = self.grids[-1].resolution
        for grid in reversed(self.grids):
            if grid.error > self.tolerance / 2:
                break
            kept = grid.resolution
        return kept

    def to_dataframe(self) -> "pandas.DataFrame":
        """The grids as a table of pandas, a row for each, with resolutions in m and changes and
        errors in K."""
        return table(self.grids)

    def to_xarray(self) -> "xarray.Dataset":
        """The grids as a labelled dataset along their resolution, with units in the attributes."""
        units = {"resolution": "m", "elements": "1", "change": "K", "error": "K"}
        grids, along = self.to_dataframe(), "resolution"
        return dataset({name: (along, grids[name], unit) for name, unit in units.items()}, {})

    def __repr__(self) -> str:
        return f"<GridConvergence of {self.name}: {self._end}>"

    def _overview(self) -> "pandas.DataFrame":
        rows = self.to_dataframe()
        rows["resolution"] *= 100  # cm, as rig files state it
        headings = {"resolution": "resolution, cm", "change": "change, K", "error": "error, K"}
        return rows.rename(columns=headings)

    @property
    def _end(self) -> str:
        if self.resolution is None:
            return f"no grid keeps {self.tolerance:g} K; the cells may be too small for the plate"
        return f'resolution = "{100 * self.resolution:.3g} cm" keeps {self.tolerance:g} K'


def grid_convergence(
    twin: Twin, experiment: Experiment, *, tolerance: float | int = 0.1
) -> GridConvergence:
    """Refines the grid of the plate until the readings of three grids differ by less than half of a
    tolerance.

    Each grid has elements that are smaller by a factor of 1.4. The coarsest grid whose readings,
    and those of all finer ones, differ from those of the finest by less than half of the tolerance
    is the one to take (`resolution`): the other half is for the error of the finest.

    **Arguments:**

    - `twin`: a twin whose rig file gives its plate a `resolution`, and all cells and channels by
      their places. Its own resolution plays no part.
    - `experiment`: the drive. Errors grow with the rise of the plate.
    - `tolerance`: the largest error of a reading, K.

    **Raises:** `RigError` if the plate has no resolution, or the file names elements;
    `SimulationError` for a tolerance that is not above 0, and the errors of `simulate`.
    """
    check_twin("grid_convergence: twin", twin, SimulationError)
    check_has_plate("grid_convergence", twin.rig, SimulationError)
    if finite_number("grid_convergence: tolerance", tolerance, SimulationError) <= 0:
        raise SimulationError(f"grid_convergence: tolerance: expected above 0 K, got {tolerance}")
    plate = twin.rig.plate
    resolution = FIRST_RESOLUTION * min(plate.width, plate.height)
    sizes, elements, readings = [], [], []
    while True:
        rig = with_resolution(twin.rig, resolution)
        if len(rig.plate.element_names) > MAX_ELEMENTS:
            break
        sizes.append(resolution)
        elements.append(len(rig.plate.element_names))
        readings.append(simulate(Twin(rig, twin.values), experiment).temperatures)
        if _agree([_largest(reading - readings[-1]) for reading in readings], tolerance):
            break
        resolution *= REFINEMENT_RATIO
    changes = [math.nan, *(_largest(b - a) for a, b in itertools.pairwise(readings))]
    errors = [_largest(reading - readings[-1]) for reading in readings]
    grids = tuple(Grid(*row) for row in zip(sizes, elements, changes, errors, strict=True))
    return GridConvergence(grids, float(tolerance), twin.rig.name)


def _agree(errors: list[float], tolerance: float | int) -> bool:
    """Whether the two grids before the finest agree with it."""
    return len(errors) > 2 and max(errors[-3:]) <= tolerance / 2


def _largest(difference: np.ndarray) -> float:
    return float(np.abs(difference).max())
