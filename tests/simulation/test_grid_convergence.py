"""The grid by the accuracy wanted: what the table says, and which rigs have no such table."""

import math

import numpy as np
import pytest
from placed_rig import AT, GRID, placed_text

from jaxtwin import Experiment, Twin, grid_convergence, simulate
from jaxtwin.errors import RigError, SimulationError
from jaxtwin.rig import Rig, load_rig
from jaxtwin.simulation import Grid, GridConvergence

STEP = Experiment.schedule("0:0.5", duration=300.0, cells=1)


def read(folder, *changes: tuple[str, str], place: str = AT) -> Rig:
    text = placed_text(place)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "placed.toml"
    path.write_text(text, encoding="utf-8")
    return load_rig(path)


@pytest.mark.slow
def test_the_resolution_found_keeps_the_tolerance(tmp_path):
    """The readings on the chosen grid, against those on one four times as fine."""
    twin = Twin(read(tmp_path), {"R_contact": 0.9})
    found = grid_convergence(twin, STEP, tolerance=0.4)
    assert found.resolution is not None
    rigs = [
        read(tmp_path, (GRID, GRID.replace("1 cm", f"{size} m")))
        for size in (found.resolution, found.resolution / 4)
    ]
    chosen, finer = (simulate(Twin(rig, twin.values), STEP).temperatures for rig in rigs)
    assert np.abs(chosen - finer).max() < 0.4
    sizes = [grid.resolution for grid in found.grids]
    assert sizes[0] == 0.04  # half of the smaller side
    np.testing.assert_allclose(np.divide(sizes[1:], sizes[:-1]), math.sqrt(0.5))
    assert max(grid.error for grid in found.grids[-3:]) <= 0.2
    assert found.grids[-1].error == 0
    assert list(found.to_dataframe()["elements"]) == [grid.elements for grid in found.grids]
    assert f'resolution = "{100 * found.resolution:.3g} cm" keeps 0.4 K' in str(found)


def grids(*rows: tuple[float, float]) -> tuple[Grid, ...]:
    """Grids of given changes and errors."""
    return tuple(Grid(0.04 / 2**n, 4**n, *row) for n, row in enumerate(rows))


def test_a_grid_that_agrees_by_chance_is_not_chosen():
    """The second agrees with the finest, but the third does not. Three grids must agree."""
    rows = grids(
        (math.nan, 0.4), (0.38, 0.02), (0.1, 0.09), (0.09, 0.03), (0.02, 0.01), (0.01, 0.0)
    )
    assert GridConvergence(rows, 0.1, "rig").resolution == rows[3].resolution
    assert GridConvergence(rows[:5], 0.1, "rig").resolution is None
    assert GridConvergence(rows, 0.2, "rig").resolution == rows[1].resolution
    too_coarse = GridConvergence(rows[:2], 0.1, "rig")
    assert too_coarse.resolution is None
    assert "no grid keeps 0.1 K" in str(too_coarse)


CONTACTS = 'contacts = { V1_1 = "R_contact" }'
ROWS = (GRID, 'columns = ["16 cm"]\nrows = ["8 cm"]')
NODES = ('x = "7.5 cm"\ny = "2.5 cm"', 'nodes = ["V2_2"]')


@pytest.mark.parametrize(
    ("place", "changes", "message"),
    [
        (AT, [ROWS], r"plate.resolution: expected a plate with .* got columns and rows"),
        (CONTACTS, [], r"cells\[P1\].contacts: expected places in cm, .* got the element V1_1"),
        (AT, [NODES], r"channels\[T_near\].nodes: .* got the element V2_2"),
    ],
)
def test_a_grid_that_cannot_be_refined_is_refused(tmp_path, place, changes, message):
    rig = read(tmp_path, *changes, place=place)
    with pytest.raises(RigError, match=message):
        grid_convergence(Twin(rig), STEP)


def test_a_tolerance_is_above_zero(tmp_path):
    with pytest.raises(SimulationError, match="tolerance: expected above 0 K, got 0"):
        grid_convergence(Twin(read(tmp_path)), STEP, tolerance=0)


def test_a_rig_without_a_plate_has_no_grid():
    box = Twin("heated-box")
    step = Experiment.schedule("0:0.5", duration=10.0)
    with pytest.raises(SimulationError, match="expected a rig with a plate"):
        grid_convergence(box, step)
