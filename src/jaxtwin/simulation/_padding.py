"""Pads time grids to a few sizes, so that different recordings use the same compiled programs.

A program is compiled for given numbers of steps, samples and step sizes. Added steps have no length
and do not change temperatures. Added samples repeat the last sample, or are marked as missing if
samples are summed.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from .._padded_rows import padded
from ..io import Experiment
from ..physics import System, Twin
from ._interpolation import CONSTANT_POLYNOMIALS
from ._time_grid import GridOptions, TimeGrid, build_time_grid, twin_steps

# The smallest number of steps. The first minute of a recording has 40 to 91 steps, which take some
# milliseconds.
MIN_STEPS = 96

# The number of step sizes is padded to a multiple of this. A drive that changes at every sample has
# one step size, a drive that is held for long has 11 to 16; padding adds the size 0.
SIZES = 20


def padded_time_grid(
    twin: Twin | System,
    experiment: Experiment,
    refinement: int = 0,
    *,
    steady_start: bool = False,
) -> TimeGrid:
    """The padded time grid of the default solver for a twin.

    **Arguments:**

    - `twin`, `experiment`, `refinement`: as in `time_grid`.
    - `steady_start`: whether the first duty cycle has always been held before the start.
    """
    grid = _padded_time_grid(experiment, twin_steps(twin, refinement))
    return replace(grid, steady_start=True) if steady_start else grid


@lru_cache(maxsize=64)
def _padded_time_grid(experiment: Experiment, options: GridOptions) -> TimeGrid:
    grid = build_time_grid(experiment, *options)
    sizes = np.append(grid.sizes, np.zeros(SIZES - len(grid.sizes) % SIZES))
    return with_padding(replace(grid, sizes=sizes), MIN_STEPS)


def with_padding(grid: TimeGrid, least: int) -> TimeGrid:
    """Pads the steps of a grid, to at least `least`, and its samples. The size that follows the
    step sizes in use must be 0."""
    ambient, ambient_at = grid.ambient, grid.ambient_at
    levels, levels_at = grid.levels, grid.levels_at
    return TimeGrid(
        times=padded(np.asarray(grid.times)),
        sizes=grid.sizes,
        size=padded(np.asarray(grid.size), int(np.max(grid.size)) + 1, least),
        duty=padded(np.asarray(grid.duty), least=least),
        ambient=None if ambient is None else _standing(np.asarray(ambient), least),
        polynomials=padded(np.asarray(grid.polynomials), CONSTANT_POLYNOMIALS, least),
        step_of=padded(np.asarray(grid.step_of)),
        weights=padded(np.asarray(grid.weights)),
        ambient_at=None if ambient_at is None else padded(np.asarray(ambient_at)),
        levels=None if levels is None else padded(np.asarray(levels), least=least),
        levels_at=None if levels_at is None else padded(np.asarray(levels_at)),
        regimes=grid.regimes,
    )


def _standing(ambient: Float[np.ndarray, "steps 3"], least: int) -> Float[np.ndarray, "filled 3"]:
    """Pads the ambient with its last value, at the end of the last step."""
    filled = padded(ambient, least=least)
    filled[len(ambient) :] = ambient[-1, 2]
    return filled
