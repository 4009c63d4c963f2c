"""Chooses the size of the picture of a network such that everything in it can be read."""

from dataclasses import dataclass
from typing import final

import numpy as np

from ..rig import Plate

WIDEST, HIGHEST = 11.0, 5.2
"""The largest size of a plate whose elements are readable at this size, inches."""

SMALLEST_SIDE, LARGEST_SIDE = 1.15, 2.2
"""Limits of the size of a typical element, with room for its name and its links, inches."""

# The largest side of a plate with any number of elements, inches.
MAX_PLATE = 18.0

BOX, BOX_HEIGHT, GAP = 1.5, 0.47, 0.34
"""The width and height of a node behind the plate, and the gap between two of them, inches."""

# The distance between two cells, whose values stand beside them, inches.
PITCH = 2.85

IN_A_ROW = 4
# The width of a legend of three columns, inches.
LEGEND = 6.0


# The width of the picture of a rig without a plate, inches.
WITHOUT_PLATE = 8.0


@final
@dataclass(frozen=True)
class NetlistLayout:
    """The positions on axes whose unit is 1 cm of the plate.

    **Arguments:**

    - `inch`: the length on the axes that is an inch of the picture, cm.
    - `plate`: the left and right edge, and the top and bottom edge, of the plate, cm.
    - `width`: the width of the whole drawing, which is centred on the plate, cm.
    - `columns`: the number of cells in a row.
    """

    inch: float
    plate: tuple[float, float, float, float]
    width: float
    columns: int

    @property
    def left(self) -> float:
        """Left edge of the drawing, cm."""
        left, right, _, _ = self.plate
        return (left + right - self.width) / 2

    def cell_centre(self, number: int, count: int) -> float:
        """The centre of one of several cells, cm from the plate's left edge."""
        row = number // self.columns
        in_row = min(self.columns, count - row * self.columns)
        return self.left + self.width * (number % self.columns + 0.5) / in_row


def netlist_layout(plate: Plate, cells: int) -> NetlistLayout:
    """The layout for a plate, or a rig without one, with this many cells."""
    rows = -(-cells // IN_A_ROW)
    columns = -(-cells // rows) if rows else 1
    if not plate.columns:
        return NetlistLayout(
            1.0, (0.0, 0.0, 0.0, 0.0), max(PITCH * columns, WITHOUT_PLATE), columns
        )
    width, height = 100 * plate.width, 100 * plate.height
    extents = 100 * np.array([plate.extent(element) for element in plate.element_names])
    side = float(np.median(np.minimum(*(np.diff(extents)[:, ::2].T))))
    scale = min(WIDEST / width, HIGHEST / height)  # inches per cm
    scale = float(np.clip(scale, SMALLEST_SIDE / side, LARGEST_SIDE / side))
    inch = 1 / min(scale, MAX_PLATE / max(width, height))
    widest = max(width, inch * PITCH * columns, inch * LEGEND)
    return NetlistLayout(inch, (0.0, width, 0.0, height), widest, columns)
