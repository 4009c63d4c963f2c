"""Interpolates temperatures between the nodes of the plate, for pictures."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._arguments import of_kind, whole_number
from ..errors import ParameterError
from ..rig import Rig
from ..rig._rig import check_has_plate


class PlateMap(NamedTuple):
    """Interpolated temperatures over the plate.

    - `x`, `y`: the positions of the columns and rows of points, from the top left corner, m.
    - `temperatures`: `(..., y, x)`, in the unit that was given.
    """

    x: Float[np.ndarray, " x"]
    y: Float[np.ndarray, " y"]
    temperatures: Float[np.ndarray, "*times y x"]


def plate_map(
    rig: Rig, temperatures: Float[np.ndarray, "*times elements"], points: int = 120
) -> PlateMap:
    """Interpolates temperatures between the plate's nodes.

    Temperatures are linear between the centres of neighbouring elements, as in the network: where
    heat flows through one material, its temperature falls evenly. Beyond the outermost centres they
    are constant, because almost no heat leaves through the edge of a thin plate.

    **Arguments:**

    - `rig`: the rig, whose plate is used.
    - `temperatures`: those of the elements, in the order of `rig.plate.element_names`; in a run,
      `run.states[:, :elements]`.
    - `points`: the number of points along the length of the plate. Along its height the points have
      the same distance.

    **Raises:** `ParameterError` if there is not one temperature for each element, or points is
    below 1.
    """
    of_kind("plate_map: rig", rig, Rig, "a Rig, as load_rig reads it", ParameterError)
    check_has_plate("plate_map", rig, ParameterError)
    plate = rig.plate
    elements = len(plate.element_names)
    values = np.asarray(temperatures)
    if values.dtype.kind not in "iuf":
        raise ParameterError(f"temperatures: expected numbers, got {values.dtype} values")
    if values.ndim < 1 or values.shape[-1] != elements:
        raise ParameterError(
            f"temperatures: expected shape (..., {elements}) for {rig.name}, got {values.shape}"
        )
    whole_number("points", points, 1, ParameterError)
    size = plate.width / points
    x = (np.arange(points) + 0.5) * size
    rows = max(1, round(plate.height / size))
    y = (np.arange(rows) + 0.5) * plate.height / rows
    grid = values.reshape(*values.shape[:-1], len(plate.rows), len(plate.columns))
    down, across = _shares(y, plate.rows), _shares(x, plate.columns)
    return PlateMap(x, y, np.einsum("yr,...rc,xc->...yx", down, grid, across))


def _shares(
    at: Float[np.ndarray, " points"], sizes: tuple[float, ...]
) -> Float[np.ndarray, "points elements"]:
    """The weight of each element of a row at each point; rows sum to 1."""
    centres = np.cumsum(sizes) - np.array(sizes) / 2
    return np.stack([np.interp(at, centres, unit) for unit in np.eye(len(sizes))], axis=1)
