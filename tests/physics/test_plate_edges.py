"""The camera's registration from frames of a known one: a warm plate seen pixel by pixel."""

from dataclasses import replace

import numpy as np
import pytest

from jaxtwin import load_rig
from jaxtwin.errors import RigError
from jaxtwin.physics import measure_registration
from jaxtwin.rig import Rig

# Points in each direction of a pixel.
FINE = 10


@pytest.fixture(scope="module")
def rig() -> Rig:
    """The two-cell rig from further away: ten pixels beside the plate on each side."""
    rig = load_rig("dual-cell")
    assert rig.camera is not None
    camera = replace(rig.camera, view_x=(10.0, 70.0), view_y=(16.0, 43.0))
    return replace(rig, camera=camera)


def frame(
    rig: Rig, shift_x: float, shift_y: float, scale: float, rotation: float, noise: float = 0.0
) -> np.ndarray:
    """What a camera with a registration sees of a plate that is warmer in its middle, each pixel
    the mean over many points."""
    camera, plate = rig.camera, rig.plate
    assert camera is not None
    size = np.array([plate.width, plate.height])
    view = np.array([camera.view_x, camera.view_y])
    y, x = np.indices((FINE * camera.height, FINE * camera.width)) + 0.5
    pixels = np.stack([x, y], axis=-1) / FINE
    points = ((pixels - view[:, 0]) / (view[:, 1] - view[:, 0]) - 0.5) * size
    turn = np.array([[np.cos(rotation), -np.sin(rotation)], [np.sin(rotation), np.cos(rotation)]])
    seen = scale * points @ turn.T + [shift_x, shift_y]
    on_plate = np.all(np.abs(seen) < size / 2, axis=-1)
    warm = 20 + 15 * np.exp(-((seen[..., 0] / 0.1) ** 2))
    fine = np.where(on_plate, warm, 18.0)
    means = fine.reshape(camera.height, FINE, camera.width, FINE).mean(axis=(1, 3))
    return means + noise * np.random.default_rng(0).standard_normal(means.shape)


@pytest.mark.parametrize(
    "truth",
    [
        (0.0, 0.0, 1.0, 0.0),
        (0.008, -0.007, 1.0, 0.0),
        (-0.004, 0.003, 1.03, 0.02),
        (0.003, 0.006, 0.97, -0.05),
    ],
)
def test_the_registration_of_a_frame_is_found_again(rig: Rig, truth):
    """To a tenth of a pixel, which is 0.4 mm."""
    found = measure_registration(rig, frame(rig, *truth, noise=0.1))
    np.testing.assert_allclose(found[:2], truth[:2], atol=4e-4)
    np.testing.assert_allclose(found[2:], truth[2:], atol=4e-3)


def test_edges_that_lie_outside_the_frame_tell_nothing():
    """The bundled rig fills the width of its frames."""
    rig = load_rig("dual-cell")
    found = measure_registration(rig, frame(rig, 0.0, 0.004, 1.0, 0.01))
    assert np.isnan(found.shift_x)
    np.testing.assert_allclose(found[1:], (0.004, 1.0, 0.01), atol=2e-3)


def test_a_plate_as_cold_as_its_surroundings_shows_no_edge(rig: Rig):
    cold = np.full((60, 80), 18.0)
    assert np.isnan(measure_registration(rig, cold)).all()


def test_several_frames_are_refused(rig: Rig):
    with pytest.raises(RigError, match=r"a single frame .* got an array of shape \(2, 60, 80\)"):
        measure_registration(rig, np.zeros((2, 60, 80)))
