"""Schedules filled up to a few sizes, so that another recording runs through the same programs.

Compiled code is made for the numbers of steps, of samples and of step sizes. Steps and samples are
filled up to the next of eight sizes an octave, by an eighth at most. Steps that are added have no
length and leave temperatures as they are; samples that are added repeat the last one, or are
missing where samples are summed.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Shaped

from ..io import Experiment
from ..physics import System, Twin
from ._interpolation import POWERS
from ._time_grid import TimeGrid, build_time_grid, twin_steps

PARTS = 8
"""Sizes an octave, and the smallest one."""

STEPS = 96
"""At least so many: the first minute of a recording has 40 to 91, and is solved in milliseconds."""

SIZES = 20
"""Step sizes are filled up to a multiple of this. A drive that changes at every sample has one, one
that is held for long has 11 to 16; one more is 0."""


def padded_count(count: int) -> int:
    """To how many rows so many are filled up."""
    part = max(PARTS, 2 ** (count.bit_length() - 1) // PARTS)
    return -(-count // part) * part


def padded(
    rows: Shaped[np.ndarray, "rows *columns"], fill: Any = None, least: int = 0
) -> Shaped[np.ndarray, "filled *columns"]:
    """Rows filled up with a value, or with the last one, to `least` of them at least."""
    missing = padded_count(max(len(rows), least)) - len(rows)
    last = rows[-1:] if fill is None else np.full_like(rows[:1], fill)
    return np.concatenate([rows, np.repeat(last, missing, axis=0)])


def padded_time_grid(
    twin: Twin | System,
    experiment: Experiment,
    refinement: int = 0,
    *,
    steady_start: bool = False,
) -> TimeGrid:
    """The default solver's grid for a twin, filled up.

    **Arguments:**

    - `twin`, `experiment`, `refinement`: those of `time_grid`.
    - `steady_start`: whether the first duty cycle has been held for ever.
    """
    grid = _padded_time_grid(experiment, twin_steps(twin, refinement))
    return replace(grid, steady_start=True) if steady_start else grid


@lru_cache(maxsize=64)
def _padded_time_grid(
    experiment: Experiment, steps: tuple[float, float, float, float, int]
) -> TimeGrid:
    grid = build_time_grid(experiment, *steps)
    # A temperature within a step of no length is the one at its start.
    standing = np.zeros((POWERS, POWERS))
    standing[0, 0] = 1.0
    ambient, ambient_at = grid.ambient, grid.ambient_at
    return TimeGrid(
        times=padded(np.asarray(grid.times)),
        sizes=np.append(grid.sizes, np.zeros(SIZES - len(grid.sizes) % SIZES)),
        size=padded(np.asarray(grid.size), len(grid.sizes), STEPS),
        duty=padded(np.asarray(grid.duty), least=STEPS),
        ambient=None if ambient is None else padded(np.asarray(ambient), least=STEPS),
        polynomials=padded(np.asarray(grid.polynomials), standing, STEPS),
        step_of=padded(np.asarray(grid.step_of)),
        weights=padded(np.asarray(grid.weights)),
        ambient_at=None if ambient_at is None else padded(np.asarray(ambient_at)),
    )
