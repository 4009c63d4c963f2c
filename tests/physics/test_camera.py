"""Frames and node temperatures -> channels: weights, uniform and linear fields."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_rigs import MakeRig

from jaxtwin import load_rig
from jaxtwin.errors import RigError
from jaxtwin.physics import channel_weights, frame_to_channels, pixel_weights, plate_map
from jaxtwin.rig import Rig, bundled_rigs

RIGS = [name for name in bundled_rigs() if load_rig(name).has_plate]
WITH_CAMERA = [name for name in RIGS if load_rig(name).camera is not None]


@pytest.fixture(scope="module")
def dual_cell() -> Rig:
    return load_rig("dual-cell")


@pytest.mark.parametrize("name", RIGS)
def test_weights_of_every_channel_sum_to_one(name):
    rig = load_rig(name)
    elements = channel_weights(rig)
    assert elements.shape == (len(rig.channels), len(rig.plate.element_names))
    np.testing.assert_allclose(elements.sum(axis=1), 1, rtol=1e-12)
    assert elements.min() >= 0


@pytest.mark.parametrize("name", WITH_CAMERA)
def test_pixel_weights_of_every_channel_sum_to_one(name):
    rig = load_rig(name)
    pixels = pixel_weights(rig)
    assert rig.camera is not None
    assert pixels.shape == (len(rig.channels), rig.camera.height, rig.camera.width)
    np.testing.assert_allclose(pixels.sum(axis=(1, 2)), 1, rtol=1e-12)
    assert pixels.min() >= 0


@pytest.mark.parametrize("name", WITH_CAMERA)
def test_uniform_frame_gives_the_uniform_value(name):
    rig = load_rig(name)
    assert rig.camera is not None
    frame = np.full((rig.camera.height, rig.camera.width), 37.25)
    np.testing.assert_allclose(frame_to_channels(rig, frame), 37.25, rtol=1e-12)


@given(st.floats(-50, 50), st.floats(-300, 300), st.floats(-300, 300))
def test_linear_field_gives_its_value_at_the_centre_of_each_zone(
    dual_cell, level, along_x, along_y
):
    """The mean of a linear field is its value in the middle.

    Exact but for the pixels that a zone's edge cuts: these count with their own middle, which can
    move the mean by p^2 / (4 w), p the pixel's and w the zone's size.
    """
    camera, plate = dual_cell.camera, dual_cell.plate
    assert camera is not None
    pixel_x = plate.width / (camera.view_x[1] - camera.view_x[0])
    pixel_y = plate.height / (camera.view_y[1] - camera.view_y[0])
    x = (np.arange(camera.width) + 0.5 - camera.view_x[0]) * pixel_x
    y = (np.arange(camera.height) + 0.5 - camera.view_y[0]) * pixel_y
    frame = level + along_x * x[None, :] + along_y * y[:, None]
    for channel, reading in zip(
        dual_cell.channels, frame_to_channels(dual_cell, frame), strict=True
    ):
        [(x0, x1, y0, y1)] = channel.sensor.outline(plate)
        centre = level + along_x * (x0 + x1) / 2 + along_y * (y0 + y1) / 2
        cut = abs(along_x) * pixel_x**2 / (4 * (x1 - x0))
        cut += abs(along_y) * pixel_y**2 / (4 * (y1 - y0))
        assert reading == pytest.approx(centre, abs=cut + 1e-9)


def zone_and_pair(make_rig: MakeRig, lowest: str) -> Rig:
    """A plate of 8 cm x 6 cm with a zone that begins at a height, and two elements as a channel."""
    return make_rig(
        ["3 cm", "5 cm"],
        ["2 cm", "4 cm"],
        [{"V11": "1 K/W"}],
        channels=f"""
            [[channels]]
            name = "zone"
            x = ["1 cm", "4 cm"]
            y = ["{lowest}", "6 cm"]
            [[channels]]
            name = "pair"
            nodes = ["V11", "V22"]
        """,
    )


def test_whole_pixels_give_zone_means_exactly(make_rig):
    """8 cm x 6 cm on 80 x 60 pixels: a millimetre a pixel."""
    rig = zone_and_pair(make_rig, "0 cm")
    frame = np.arange(60 * 80.0).reshape(60, 80)
    zone, pair = frame_to_channels(rig, frame)
    assert zone == pytest.approx(frame[:, 10:40].mean())
    assert pair == pytest.approx((frame[:20, :30].mean() + frame[20:, 30:].mean()) / 2)


def test_a_frame_of_the_plate_map_reads_as_the_elements_do(make_rig):
    """The two ways to a zone's mean agree: the plate's picture is interpolated too, and its pixels
    are small."""
    rig = zone_and_pair(make_rig, "0.5 cm")
    temperatures = np.array([20.0, 30.0, 50.0, 90.0])
    frame = plate_map(rig, temperatures, points=80).temperatures
    expected = (channel_weights(rig) @ temperatures)[0]
    assert frame_to_channels(rig, frame)[0] == pytest.approx(expected, abs=2e-3)
    # By hand: centres at 15 and 55 mm, 10 and 40 mm. The zone reaches from 10 to 40 mm: 5 mm at the
    # first centre and 25 mm with a share of the second from 0 to 25/40. Down, from 5 to 60 mm: 5
    # and 20 mm at the centres, 30 mm halfway between them.
    across, down = 25 * (25 / 40) / 2 / 30, (30 / 2 + 20) / 55
    shares = np.outer([1 - down, down], [1 - across, across]).ravel()
    assert expected == pytest.approx(shares @ temperatures)


def test_named_nodes_are_plain_means_as_in_the_model_file():
    """TBM is the mean of V24 and V25 there, although V25 is smaller."""
    rig = load_rig("paper-2024")
    row = channel_weights(rig)[[channel.name for channel in rig.channels].index("TBM")]
    weights = dict(zip(rig.plate.element_names, row, strict=True))
    assert {name: weight for name, weight in weights.items() if weight} == {"V24": 0.5, "V25": 0.5}


def test_zone_weights_by_hand(dual_cell):
    """T11 covers 0 ... 4.25 cm, where columns 1 to 3 have their centres at 0.5, 3 and 7 cm, and
    0 ... 5.75 cm, where rows 1 and 2 have theirs at 2 and 6 cm."""
    weights = dict(zip(dual_cell.plate.element_names, channel_weights(dual_cell)[0], strict=True))
    third = 1.25 * (1.25 / 4) / 2
    across = np.array([0.5 + 2.5 / 2, 2.5 / 2 + 1.25 - third, third]) / 4.25
    second = 3.75 * (3.75 / 4) / 2
    down = np.array([2 + 3.75 - second, second]) / 5.75
    expected = {
        f"V{row + 1}{column + 1}": down[row] * across[column]
        for row in range(2)
        for column in range(3)
    }
    assert {name: weight for name, weight in weights.items() if weight} == pytest.approx(expected)


def test_many_frames_at_once_and_whole_numbers(dual_cell):
    frames = np.arange(2 * 3 * 60 * 80).reshape(2, 3, 60, 80)
    readings = frame_to_channels(dual_cell, frames)
    assert readings.shape == (2, 3, 15)
    np.testing.assert_allclose(readings[1, 2], frame_to_channels(dual_cell, frames[1, 2]))


def test_pixels_beside_the_plate_have_no_weight(dual_cell):
    """The plate is seen in rows 12 ... 48."""
    frame = np.full((60, 80), 1e6)
    frame[12:48] = 20.0
    np.testing.assert_allclose(frame_to_channels(dual_cell, frame), 20.0, rtol=1e-12)


@pytest.mark.parametrize("shape", [(80, 60), (60, 81), (120, 160)])
def test_frame_of_another_resolution_is_refused(dual_cell, shape):
    message = rf"camera.resolution: expected frames of 80 x 60 pixels, got {shape[1]} x {shape[0]}"
    with pytest.raises(RigError, match=message):
        frame_to_channels(dual_cell, np.zeros(shape))
