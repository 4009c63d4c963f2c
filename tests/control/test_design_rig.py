"""Designed places of cells, beside a search over a grid of places, and the files that they give."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from placed_rig import AT, MOVING, placed_text
from scipy.optimize import brute

import jaxtwin as jt
from jaxtwin import Twin
from jaxtwin.control import design_rig, most_even_point
from jaxtwin.control.tuning._rig_design import PlacedPlate
from jaxtwin.errors import ControlError, RigError

COARSE = 'width = "16 cm"\nheight = "8 cm"\nresolution = "2 cm"'
MEAN, LIMITS = 30.0, (0.0, 1.0)

# Left, right, top and bottom of the part of the plate to which the parameters of the place keep the
# face.
REACH = (0.01, 0.1, 0.009, 0.071)

HEATER = """
[[heaters]]
name = "mat"
power = "4 W"
capacitance = "5 J/K"
at = ["14.5 cm", "4 cm"]
size = "2 cm"
contact_resistance = "1 K/W"
"""


def twin_of(folder: Path, place: str = AT, **parts: str) -> Twin:
    file = folder / "plate.toml"
    file.write_text(placed_text(place, grid=COARSE, **parts))
    return Twin(file)


def plate_range(twin: Twin) -> float:
    return most_even_point(twin, MEAN, limits=LIMITS).range


@pytest.mark.slow
def test_the_plate_at_rest_has_the_slopes_of_the_twin_itself(tmp_path: Path):
    """`linearize` of a twin whose place is a parameter assembles the network by another way; its
    differences are those of the steady state."""
    twin = twin_of(tmp_path, MOVING)
    at, step = np.array([0.0521, 0.0387, 0.4]), 1e-5
    found = PlacedPlate(twin, {"P1": REACH}).at(at)

    def elements(unknowns: np.ndarray) -> np.ndarray:
        x, y, duty = unknowns.tolist()
        moved = twin.with_values({"x_1": 1e3 * x, "y_1": 1e3 * y})
        point = jt.linearize(moved, duty=duty).operating_point
        return np.asarray(point.nodes)[: point.elements]

    np.testing.assert_allclose(found.elements, elements(at), atol=1e-7)
    for column, change in enumerate(step * np.eye(3)):
        slope = (elements(at + change) - elements(at - change)) / (2 * step)
        size = np.abs(slope).max()
        np.testing.assert_allclose(found.elements_by[:, column], slope, atol=1e-4 * size)


@pytest.mark.slow
@pytest.mark.parametrize(
    "objective", ["range", pytest.param("standard deviation", marks=pytest.mark.long)]
)
def test_no_place_of_a_grid_is_more_even(tmp_path: Path, objective: str):
    """SciPy's `brute`, over 0.25 mm, of the twin whose place is a parameter."""
    twin = twin_of(tmp_path, MOVING)

    def unevenness(place: np.ndarray) -> float:
        x, y = place.tolist()
        moved = twin.with_values({"x_1": x, "y_1": y})
        point = jt.linearize(moved, temperatures=MEAN).operating_point
        elements = np.asarray(point.nodes)[: point.elements]
        return float(np.ptp(elements) if objective == "range" else elements.std())

    # The plate is symmetric in y; the optimum lies on the axis, or in equal pairs beside it.
    grid = (slice(30.0, 80.1, 2.5), slice(40.0, 51.0, 2.5))
    place, least, *_ = brute(unevenness, grid, full_output=True, finish=None)
    design = design_rig(
        twin, MEAN, objective=objective, bounds={"P1": REACH}, limits=LIMITS, starts=6
    )
    assert design.after.unevenness < least + 1e-3
    x, y = (1e3 * one for one in design.after.places["P1"])
    assert x == pytest.approx(place[0], abs=2.5)
    assert min(y, 80 - y) == pytest.approx(min(place[1], 80 - place[1]), abs=2.5)
    assert unevenness(np.array([x, y])) == pytest.approx(design.after.unevenness, abs=1e-4)


@pytest.mark.slow
def test_the_file_of_a_design_is_that_of_the_rig_with_other_places(tmp_path: Path):
    twin = twin_of(tmp_path)
    design = design_rig(twin, MEAN, limits=LIMITS, starts=1)
    assert design.after.point.range < design.before.point.range - 0.5
    assert design.before.point.range == pytest.approx(plate_range(twin), abs=1e-3)
    file = design.save(tmp_path / "designed.toml")
    assert plate_range(Twin(file)) == pytest.approx(design.after.point.range, abs=1e-3)
    before, after = twin.rig.text.splitlines(), file.read_text().splitlines()
    changed = [line for line, other in zip(after, before, strict=True) if line != other]
    x, y = design.after.places["P1"]
    assert changed == [f'at = ["{100 * x:.9g} cm", "{100 * y:.9g} cm"]']


def test_the_values_of_the_twin_stay_and_a_place_that_was_a_parameter_goes(tmp_path: Path):
    twin = twin_of(tmp_path, MOVING).with_values({"R_contact": 1.7})
    designed = design_rig(twin, MEAN, limits=LIMITS, starts=1).twin
    assert designed.values["R_contact"] == 1.7
    assert set(twin.values) - set(designed.values) == {"x_1", "y_1"}


@pytest.mark.slow
def test_a_further_cell_and_a_heater_make_it_more_even_and_keep_their_distance(tmp_path: Path):
    twin = twin_of(tmp_path, parts=HEATER)
    kept = {"clearance": 0.006, "limits": LIMITS, "starts": 2}
    two = design_rig(twin, MEAN, **kept)
    three = design_rig(twin, MEAN, further_cells=1, **kept)
    assert list(three.after.places) == ["P1", "mat", "P2"]
    assert three.after.point.range < two.after.point.range < two.before.point.range
    sides = {"P1": 0.04, "P2": 0.04, "mat": 0.02}
    places = three.after.places
    for one, other in (("P1", "P2"), ("P1", "mat"), ("P2", "mat")):
        apart = np.abs(np.subtract(places[one], places[other])).max()
        assert apart > (sides[one] + sides[other]) / 2 + 0.006 - 2e-4
    assert [cell.name for cell in three.rig.cells] == ["P1", "P2"]
    assert plate_range(three.twin) < three.after.point.range + 1e-2
    held = design_rig(twin, MEAN, moving=[], further_cells=1, **kept)
    assert held.after.places.keys() == {"P2"}
    assert three.after.point.range < held.after.point.range < two.before.point.range
    table = held.to_dataframe()
    assert np.isnan(table.loc["P2", "x before"])
    assert table.loc["P2", "x"] == held.after.places["P2"][0]


def test_what_cannot_be_designed_is_refused_in_a_sentence(tmp_path: Path):
    twin = twin_of(tmp_path)
    refused: tuple[tuple[str, Any, str], ...] = (
        ("objective", "even", "objective: expected 'range' or 'standard deviation', got 'even'"),
        ("moving", ("P9",), "moving: .*P1"),
        ("moving", (), "moving: expected a name, or further cells that move"),
        ("further_cells", -1, "further_cells: expected a whole number"),
        ("further_cells", 9, "expected room on the plate for 10 faces that do not overlap"),
        ("bounds", {"P1": (0, 0.03, 0, 0.08)}, "bounds: P1: .*its face of 0.04 m by 0.04 m"),
        ("bounds", {"P1": (0, 0.2, 0, 0.08)}, r"bounds: P1: expected .*0\.16 m by 0\.08 m"),
        ("bounds", {"P1": (0, 0.1)}, "bounds: P1: expected left, right, top and bottom"),
        ("bounds", {"P2": (0, 0.1, 0, 0.08)}, "bounds: .*P2"),
        ("clearance", -0.001, "clearance: expected a number of at least 0, in m"),
        ("starts", 0, "starts: expected a whole number"),
    )
    for argument, value, words in refused:
        given: dict[str, Any] = {argument: value}
        with pytest.raises(ControlError, match=f"design_rig: {words}"):
            design_rig(twin, MEAN, limits=LIMITS, **given)
    with pytest.raises(ControlError, match=r"duty cycles from 0 to 0\.1 reach, got 70"):
        design_rig(twin, 70, limits=(0, 0.1), starts=1)
    with pytest.raises(ControlError, match=r"have a place .* got dual-cell, whose cells list"):
        design_rig(Twin("dual-cell"), MEAN)
    with pytest.raises(ControlError, match=r"ending: expected \.toml, got '\.json'"):
        design_rig(twin, MEAN, limits=LIMITS, starts=1).save(tmp_path / "rig.json")
    unread = Twin(replace(twin.rig, text=""))
    with pytest.raises(RigError, match="expected a rig that was read from a file"):
        design_rig(unread, MEAN)
