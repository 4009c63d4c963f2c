"""Cells and heaters by place and size: areas by other computations, and mistakes by their message."""
# ruff: noqa: E501  (a table of cases reads best with one case a line)

import itertools
import math
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from placed_rig import AT, GRID, MOVING, PLACES, placed_rig, placed_text

from jaxtwin.errors import RigError
from jaxtwin.rig import load_rig, rig_from_tables
from jaxtwin.rig._placement import corners, overlap_areas

COLUMNS, ROWS = np.array([0.0, 0.5, 2.0, 2.7, 4.0]), np.array([0.0, 1.0, 1.8, 3.0])
PLACES_OF_TURNED = [
    ((1.7, 1.4), (1.6, 0.8), 0.3),
    ((2.0, 1.5), (1.0, 1.0), math.pi / 4),
    ((2.1, 1.3), (2.0, 0.3), -1.2),
    ((1.5, 1.5), (0.2, 0.2), 2.0),
    ((2.0, 1.5), (2.2, 1.1), 1e-5),
]


def clipped_area(outline: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """The area of a convex outline within a box, by cutting it along each side (Sutherland and
    Hodgman), with the shoelace formula."""
    points = [np.array(point) for point in outline]
    for axis, sign in itertools.product((0, 1), (1, -1)):
        bound = low[axis] if sign > 0 else -high[axis]
        cut = []
        for here, there in zip(points, [*points[1:], *points[:1]], strict=True):
            inside = [sign * point[axis] - bound for point in (here, there)]
            if inside[0] >= 0:
                cut.append(here)
            if inside[0] * inside[1] < 0:
                share = inside[0] / (inside[0] - inside[1])
                cut.append(here + share * (there - here))
        points = cut
        if not points:
            return 0.0
    x, y = np.array(points).T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


def test_areas_of_a_parallel_rectangle_by_hand():
    """From 0.3 to 2.3 and from 0.5 to 2.0."""
    areas = overlap_areas(COLUMNS, ROWS, (1.3, 1.25), (2.0, 1.5))
    across, down = [0.2, 1.5, 0.3, 0.0], [0.5, 0.8, 0.2]
    np.testing.assert_allclose(areas, np.outer(down, across), atol=1e-15)


@pytest.mark.parametrize(("place", "size", "angle"), PLACES_OF_TURNED)
def test_areas_of_a_turned_rectangle_are_those_of_a_clipped_outline(place, size, angle):
    areas = overlap_areas(COLUMNS, ROWS, place, size, angle)
    outline = corners(size, angle) + np.array(place)
    expected = [
        [
            clipped_area(outline, np.array([left, top]), np.array([right, bottom]))
            for left, right in itertools.pairwise(COLUMNS)
        ]
        for top, bottom in itertools.pairwise(ROWS)
    ]
    np.testing.assert_allclose(areas, expected, atol=1e-9)
    assert areas.sum() == pytest.approx(size[0] * size[1], abs=1e-9)


@pytest.mark.parametrize("turns", [1, 2, 3, -1])
def test_a_rectangle_turned_by_right_angles_has_its_sides_swapped(turns: int):
    place, (width, height) = (1.9, 1.4), (1.2, 0.5)
    swapped = (height, width) if turns % 2 else (width, height)
    turned = overlap_areas(COLUMNS, ROWS, place, (width, height), turns * math.pi / 2)
    np.testing.assert_allclose(turned, overlap_areas(COLUMNS, ROWS, place, swapped), atol=1e-15)
    # The two formulas meet at a right angle.
    nearly = overlap_areas(COLUMNS, ROWS, place, (width, height), turns * math.pi / 2 + 1e-6)
    np.testing.assert_allclose(nearly, turned, atol=1e-5)


@pytest.mark.slow
@pytest.mark.usefixtures("float64")
@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_areas_are_differentiable_in_x_and_y(angle: float):
    def areas(place):
        return overlap_areas(COLUMNS, ROWS, (place[0], place[1]), (1.3, 0.9), angle).ravel()

    place, step = jnp.array([1.73, 1.52]), 1e-6
    slopes = jax.jacfwd(areas)(place)
    assert np.abs(np.asarray(slopes)).max() > 0.5
    for axis in (0, 1):
        moved = step * jnp.eye(2)[axis]
        expected = (areas(place + moved) - areas(place - moved)) / (2 * step)
        np.testing.assert_allclose(slopes[:, axis], expected, atol=1e-8)


def test_several_places_at_once():
    x, y = np.array([1.5, 2.0]), np.array([1.2, 1.7])
    for angle in (0.0, 0.7):
        together = overlap_areas(COLUMNS, ROWS, (x, y), (1.0, 0.6), angle)
        assert together.shape == (2, 3, 4)
        for number in (0, 1):
            alone = overlap_areas(COLUMNS, ROWS, (x[number], y[number]), (1.0, 0.6), angle)
            np.testing.assert_array_equal(together[number], alone)


def test_the_contacts_of_a_cell_are_its_face_shared_by_area():
    """4 cm x 4 cm about (5 cm, 4 cm) covers 16 elements of 1 cm; moved by half an element to the
    right, 12 of them and half of 8."""
    whole = {"R_contact": 0.6}
    on_lines = placed_rig().cells[0].contacts
    assert [r.evaluate(whole) for _, r in on_lines] == pytest.approx([16 * 0.6] * 16)
    assert [name for name, _ in on_lines][:4] == ["V3_4", "V3_5", "V3_6", "V3_7"]
    moved = placed_rig(AT.replace('"5 cm"', '"5.5 cm"')).cells[0].contacts
    found = sorted(round(r.evaluate(whole) / 0.6, 9) for _, r in moved)
    assert found == [16] * 12 + [32] * 8


def test_a_cell_of_two_sizes_and_an_angle():
    flat = placed_rig(AT.replace('size = "4 cm"', 'size = ["6 cm", "2 cm"]')).cells[0]
    upright = placed_rig(
        AT.replace('size = "4 cm"', 'size = ["2 cm", "6 cm"]\nangle = "90 deg"')
    ).cells[0]
    assert flat.contacts == upright.contacts
    assert len(flat.contacts) == 12
    assert "P1 at 5 cm, 4 cm" in str(placed_rig())
    assert "P1 at x_1, y_1" in str(placed_rig(MOVING))


def test_the_elements_within_the_bounds_of_a_place_may_all_have_a_contact():
    """x of 3 to 8 cm and y of 2.9 to 5.1 cm: columns from 1 to 10 cm, rows from 0.9 to 7.1 cm."""
    contacts = placed_rig(MOVING).cells[0].contacts
    assert len(contacts) == 9 * 8
    assert contacts[0][0] == "V1_2"


def test_a_resolution_divides_the_plate_into_equal_elements_no_larger():
    plate = placed_rig(grid='width = "16 cm"\nheight = "9 cm"\nresolution = "2 cm"').plate
    assert plate.columns == pytest.approx([0.02] * 8)
    assert plate.rows == pytest.approx([0.018] * 5)


def test_coefficients_beside_a_resolution_stand_for_equal_parts():
    """Three parts of 16 cm in elements of at most 2 cm: 3 columns each; two of 8 cm: 2 rows."""
    losses = 'film_coefficient = ["10 W/(m^2 K)", "20 W/(m^2 K)", "30 W/(m^2 K)"]'
    losses += '\nfilm_row_factor = ["1", "0.5"]'
    plate = placed_rig(grid=GRID.replace('"1 cm"', '"2 cm"'), losses=losses).plate
    assert plate.film_coefficient is not None
    assert [value.factor for value in plate.film_coefficient] == [10] * 3 + [20] * 3 + [30] * 3
    assert [value.factor for value in plate.film_row_factor] == [1, 1, 0.5, 0.5]
    assert sum(plate.columns) == pytest.approx(0.16)


HEATER = """
[[heaters]]
name = "mat"
power = "20 W"
capacitance = "10 J/K"
at = ["13 cm", "4 cm"]
size = ["4 cm", "6 cm"]
contact_resistance = "0.2 K/W"
"""

# id: (text, text in its place, field, what else the message says)
MISTAKES = {
    "beside the plate": ('["5 cm",', '["1 cm",', "cells[P1].at", "expected x from 2 cm to 14 cm", "got '1 cm'"),
    "below the plate": ('"4 cm"]', '"7 cm"]', "cells[P1].at", "expected y from 2 cm to 6 cm", "got '7 cm'"),
    "a turned corner beside the plate": (AT, AT.replace('"4 cm"]', '"6 cm"]') + '\nangle = "45 deg"', "cells[P1].at", "expected y from 2.82843 cm to 5.17157 cm"),
    "bounds beside the plate": (AT, MOVING, "cells[P1].at", "expected bounds of 'y_1' within 2 cm to 6 cm", "got 1 cm to 5.1 cm"),
    "no bounds": (AT, MOVING.replace("x_1", "x_2"), "cells[P1].at", "expected bounds of 'x_2' within 2 cm to 14 cm", "got -inf cm to inf cm"),
    "larger than the plate": ('size = "4 cm"', 'size = "9 cm"', "cells[P1].size", "at most the 8 cm of the plate along y", "got 9 cm"),
    "no size": ('size = "4 cm"', 'size = "0 cm"', "cells[P1].size", "a length above 0", "'0 cm'"),
    "a negative size": ('size = "4 cm"', 'size = ["4 cm", "-1 cm"]', "cells[P1].size", "a length above 0", "'-1 cm'"),
    "three sizes": ('size = "4 cm"', 'size = ["4 cm", "4 cm", "1 cm"]', "cells[P1].size", "width and height, got 3 entries"),
    "a parameter for a size": ('size = "4 cm"', 'size = "R_contact"', "cells[P1].size", "a length above 0", "'R_contact'"),
    "a parameter for an angle": (AT, AT + '\nangle = "R_contact"', "cells[P1].angle", "an angle", "'R_contact'"),
    "one coordinate": ('["5 cm", "4 cm"]', '["5 cm"]', "cells[P1].at", "at least 2 entries, got 1"),
    "no list": ('["5 cm", "4 cm"]', '"5 cm"', "cells[P1].at", "a valid list", "'5 cm'"),
    "no size given": ('size = "4 cm"', "", "cells[P1].size", "a value beside at", "got none"),
    "no contact resistance": ('contact_resistance = "R_contact"', "", "cells[P1].contact_resistance", "a value beside at", "got none"),
    "contacts too": (AT, AT + '\ncontacts = { V1_1 = "1 K/W" }', "cells[P1].at", "either contacts or at, got both"),
    "neither": (AT, "", "cells[P1].contacts", "expected contacts such as", "or a place such as", "got neither"),
    "a size without a place": (AT, 'contacts = { V1_1 = "R_contact" }\nsize = "4 cm"', "cells[P1].size", "expected a place beside it", "got none"),
    "an area beside a place": (AT, AT + '\narea = "16 cm^2"', "cells[P1].area", "none beside at"),
    "a heater without a mass": ('capacitance = "10 J/K"', "", "heaters[mat].capacitance", "a value beside at, got none"),
    "a heater beside the plate": ('["13 cm",', '["15 cm",', "heaters[mat].at", "expected x from 2 cm to 14 cm"),
    "a heater with contacts too": ('contact_resistance = "0.2 K/W"', 'contact_resistance = "0.2 K/W"\ncontacts = { V1_1 = "1 K/W" }', "heaters[mat].at", "either contacts or at"),
    "a coarse resolution": ('resolution = "1 cm"', 'resolution = "9 cm"', "plate.resolution", "at most the plate's smaller side, 8 cm", "got '9 cm'"),
    "a fine resolution": ('resolution = "1 cm"', 'resolution = "1 um"', "plate.resolution", "at most 100000 elements", "make it coarser"),
    "no resolution": ('resolution = "1 cm"', "", "plate.resolution", "missing, every plate needs columns and rows, or width, height and resolution"),
    "no width": ('width = "16 cm"', "", "plate.width", "missing"),
    "columns too": (GRID, GRID + '\ncolumns = ["16 cm"]', "plate.width", "either columns and rows, or width, height and resolution, got both"),
    "no grid": (GRID, "", "plate.columns", "missing"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_told_with_file_field_and_what_is_allowed(mistake: tuple[str, ...], tmp_path):
    old, new, field, *fragments = mistake
    parameters = PLACES.replace("29.0", "10.0") if "x_" in new else ""
    if "x_2" in new:
        parameters += 'x_2 = { value = 50.0, unit = "mm" }\n'
    text = placed_text(parts=HEATER, parameters=parameters)
    assert old in text
    path = tmp_path / "placed.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(RigError) as caught:
        load_rig(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: {field}: ")
    for fragment in fragments:
        assert fragment in message
    assert "\n" not in message
    assert len(message.removeprefix(str(path))) < 300


def test_a_place_needs_a_plate():
    document = tomllib.loads(placed_text())
    del document["plate"]
    document["channels"] = [{"name": "T", "nodes": ["block"]}]
    document["bodies"] = [{"name": "block", "capacitance": "10 J/K"}]
    with pytest.raises(RigError, match=r"cells\[P1\].at: expected a \[plate\], on which it lies"):
        rig_from_tables(document, "placed.toml")
