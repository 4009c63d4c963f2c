"""Temperatures between the nodes, on fields that are known everywhere."""

import numpy as np
import pytest

from jaxtwin import load_rig
from jaxtwin.errors import ParameterError
from jaxtwin.physics import frame_to_channels, plate_map

RIG = load_rig("dual-cell")
PLATE = RIG.plate


def centres() -> np.ndarray:
    extents = np.array([PLATE.extent(name) for name in PLATE.element_names])
    return np.stack([extents[:, :2].mean(axis=1), extents[:, 2:].mean(axis=1)], axis=1)


def test_a_field_that_rises_evenly_is_kept_between_the_outermost_centres():
    x, y = centres().T
    shown = plate_map(RIG, 20 + 100 * x - 30 * y)
    grid_x = np.clip(shown.x, x.min(), x.max())
    grid_y = np.clip(shown.y, y.min(), y.max())
    expected = 20 + 100 * grid_x[None, :] - 30 * grid_y[:, None]
    np.testing.assert_allclose(shown.temperatures, expected, atol=1e-9)


def test_the_map_stays_between_coldest_and_hottest_node_and_meets_the_nodes():
    values = np.random.default_rng(0).uniform(20, 60, len(PLATE.element_names))
    shown = plate_map(RIG, values, points=1020)
    assert values.min() <= shown.temperatures.min() <= shown.temperatures.max() <= values.max()
    for (x, y), value in zip(centres(), values, strict=True):
        column, row = np.argmin(np.abs(shown.x - x)), np.argmin(np.abs(shown.y - y))
        assert shown.temperatures[row, column] == pytest.approx(value, abs=0.5)


def test_points_are_squares_that_fill_the_plate():
    shown = plate_map(RIG, np.zeros((2, 24)), points=51)
    assert shown.temperatures.shape == (2, 23, 51)
    assert shown.x[1] - shown.x[0] == pytest.approx(PLATE.width / 51)
    assert shown.y[1] - shown.y[0] == pytest.approx(PLATE.height / 23)


def test_a_map_of_one_temperature_reads_as_that_in_all_channels():
    camera = RIG.camera
    assert camera is not None
    shown = plate_map(RIG, np.full(24, 33.0), points=camera.width)
    frame = np.full((camera.height, camera.width), np.nan)
    first, last = (round(edge) for edge in camera.view_y)
    rows = np.linspace(0, len(shown.y) - 1, last - first).round().astype(int)
    frame[first:last] = shown.temperatures[rows]
    np.testing.assert_allclose(frame_to_channels(RIG, np.nan_to_num(frame)), 33.0)


def test_a_plate_of_one_element_has_one_temperature():
    shown = plate_map(load_rig("single-cell"), np.array([41.0]), points=7)
    np.testing.assert_array_equal(shown.temperatures, np.full((7, 7), 41.0))


@pytest.mark.parametrize(
    ("values", "points", "words"),
    [
        (np.zeros(23), 10, r"expected shape \(..., 24\).* got \(23,\)"),
        (np.zeros(24), 0, "points: expected .* got 0"),
    ],
)
def test_wrong_shapes_are_refused(values, points, words):
    with pytest.raises(ParameterError, match=words):
        plate_map(RIG, values, points)
