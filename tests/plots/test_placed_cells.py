"""Pictures of cells and heaters that lie on the plate by their place."""

import math

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.patches import Polygon
from placed_rig import AT, MOVING, placed_rig

from jaxtwin import Twin
from jaxtwin.plots import plot_netlist, plot_plate_map
from jaxtwin.rig import Rig

HEATER = """
[[heaters]]
name = "mat"
power = "20 W"
capacitance = "10 J/K"
at = ["13 cm", "4 cm"]
size = ["4 cm", "6 cm"]
contact_resistance = "0.2 K/W"
"""


def outlines(axes) -> list[np.ndarray]:
    """The corners of the polygons, without the first, which is repeated as the last."""
    return [patch.get_xy()[:-1] for patch in axes.patches if isinstance(patch, Polygon)]


def map_of(rig: Rig):
    temperatures = np.full((1, len(rig.plate.element_names)), 30.0)
    return plot_plate_map(rig, temperatures, ["at rest"])


@pytest.mark.parametrize("place", [AT, MOVING])
def test_a_map_shows_the_cell_as_it_is(place: str):
    """4 cm x 4 cm about (5 cm, 4 cm), whatever elements it touches; and the heater."""
    figure = map_of(placed_rig(place, parts=HEATER))
    for axes in figure.axes[:2]:
        cell, mat = outlines(axes)
        assert sorted(map(tuple, cell.round(9).tolist())) == [(3, 2), (3, 6), (7, 2), (7, 6)]
        assert sorted(map(tuple, mat.round(9).tolist())) == [(11, 1), (11, 7), (15, 1), (15, 7)]
        texts = [text.get_text() for text in axes.texts]
        assert {"P1", "mat"} <= set(texts)
    pyplot.close(figure)


def test_a_map_shows_a_turned_cell():
    """A square of 4 cm at 45 degrees has its corners 2.83 cm above, below and beside its middle."""
    figure = map_of(placed_rig(AT + '\nangle = "45 deg"'))
    (corners,) = outlines(figure.axes[0])
    half = 2 * math.sqrt(2)
    expected = [(5 - half, 4), (5, 4 - half), (5, 4 + half), (5 + half, 4)]
    np.testing.assert_allclose(sorted(map(tuple, corners.round(9))), expected, atol=1e-8)
    pyplot.close(figure)


@pytest.mark.slow
def test_the_network_shows_the_cell_as_it_lies_on_the_plate():
    twin = Twin(placed_rig(MOVING, parts=HEATER), {"x_1": 62.0})
    axes = plot_netlist(twin)
    cell, _ = outlines(axes)
    assert cell.mean(axis=0) == pytest.approx([6.2, 4.0])
    texts = " ".join(text.get_text() for text in axes.texts)
    assert "on 4 cm × 4 cm of the plate" in texts
    assert texts.count("K/W to the plate") == 1  # of the mat, in place of 24 contacts
    assert "0.2 K/W to the plate" in texts
    pyplot.close("all")
