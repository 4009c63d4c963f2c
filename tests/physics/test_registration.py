"""Zones that the camera sees elsewhere: overlaps by hand, by counting points, in every solver."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from small_rigs import CAMERA, small_rig_file, zone

from jaxtwin import Experiment, Twin, load_rig, response, simulate, simulate_batch
from jaxtwin.errors import RigError
from jaxtwin.physics import channel_weights
from jaxtwin.rig import Rig, ZoneSensor

REGISTRATION = """
[camera.registration]
shift_x = "d_x"
shift_y = "d_y"
scale = "s"
rotation = "phi"
"""
PARAMETERS = """
[parameters]
d_x = { value = 0.0, unit = "mm" }
d_y = { value = 0.0, unit = "mm" }
s = { value = 1.0, unit = "", bounds = [0.5, 2.0] }
phi = { value = 0.0, unit = "deg" }
"""
SECOND = zone("T2", (6.0, 9.0), (0.0, 3.0))

# The part of T2 that counts as plate if one of its edges lies at the outline: half a pixel of 1 mm
# is beside the plate, with a mean weight of a quarter, and T2 is 30 mm wide.
AT_EDGE = 1 - 0.125 / 30


def rig_file(folder: Path, second: str = SECOND) -> Path:
    return small_rig_file(
        folder,
        ["2 cm", "4 cm", "3 cm"],
        ["3 cm", "2 cm"],
        [{"V11": "0.5 K/W"}],
        thickness="1 mm",
        density="8960 kg/m^3",
        specific_heat="390 J/(kg K)",
        film_coefficient="15 W/(m^2 K)",
        sink_resistance="0.5 K/W",
        sensors=CAMERA.replace("80", "90").replace("60", "50") + REGISTRATION,
        channels=zone("T1", (1.0, 4.0), (1.0, 4.0), 'gain = "0.8"') + second,
        parameters=PARAMETERS,
    )


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    return load_rig(rig_file(tmp_path_factory.mktemp("rig")))


def weights(rig: Rig, **values: float) -> np.ndarray:
    """Of the elements in the channels."""
    with jax.enable_x64(True):
        system = Twin(rig, values).system()
        return np.asarray(system.channel_weights)[:, : len(rig.plate.element_names)]


@pytest.mark.slow
def test_a_picture_where_the_rig_file_says_has_the_weights_of_a_rig_without_registration(rig: Rig):
    """T1 lies inside the plate. T2 ends at two edges of it, where the blur takes its part."""
    found, expected = weights(rig), channel_weights(rig)
    np.testing.assert_allclose(found[0], expected[0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(found[1].sum(), AT_EDGE**2 * expected[1].sum(), rtol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("shift", [-0.7, -0.2, 0.0, 0.3, 1.2])
def test_an_edge_of_a_zone_at_the_outline_is_spread_over_a_pixel(rig: Rig, shift: float):
    """T2 ends at the right edge of the plate. What of it lies on the plate is averaged over all
    places within half a pixel, by SciPy's quadrature."""
    mean, _ = quad(lambda place: 1 - max(place, 0.0) / 30, shift - 0.5, shift + 0.5, points=[0.0])
    np.testing.assert_allclose(weights(rig, d_x=shift)[1].sum(), mean * AT_EDGE, rtol=1e-9)


@pytest.mark.slow
def test_the_mean_over_a_shifted_zone_by_hand(rig: Rig):
    """T1 moved by 5 mm and -7 mm: x from 1.5 to 4.5 cm, y from 0.3 to 3.3 cm. The centres are at 1,
    4 and 7.5 cm, and at 1.5 and 4 cm."""
    found = weights(rig, d_x=5.0, d_y=-7.0)[0]
    second = 2.5 * (0.5 + 3) / 3 / 2  # the share of the second column rises from 0.5/3 to 1
    third = 0.5 * (0.5 / 3.5) / 2
    x = np.array([2.5 - second, second + 0.5 - third, third])
    below = 1.8 * (1.8 / 2.5) / 2
    y = np.array([3.0 - below, below])
    np.testing.assert_allclose(found, np.outer(y, x).ravel() / 9, rtol=0, atol=1e-15)


@pytest.mark.slow
def test_a_zone_beside_the_plate_sees_the_surroundings_there(rig: Rig):
    """T2 moved by 1 cm to the right: a third of it is beyond the edge at 9 cm. The plate is warm
    all over, so the reading's rise is two thirds of that of a zone that ends at the edge at 0 cm
    alone."""
    part = 2 / 3 * AT_EDGE
    np.testing.assert_allclose(weights(rig, d_x=10.0).sum(axis=1), [1, part], rtol=1e-14)
    with jax.enable_x64(True):
        warm = jnp.full(len(Twin(rig).netlist.nodes), 12.0)
        rises = [
            Twin(rig, {"d_x": shift}).system().channel_temperatures(warm, 2.0)
            for shift in (0.0, 10.0)
        ]
    np.testing.assert_allclose(rises[0], [2 + 0.8 * 10, 2 + 10 * AT_EDGE**2])
    np.testing.assert_allclose(rises[1], [2 + 0.8 * 10, 2 + 10 * part])


@pytest.mark.parametrize(("scale", "degrees"), [(1.2, 0.0), (1.0, 5.0), (0.9, -8.0)])
def test_scale_and_rotation_by_counting_points(rig: Rig, scale: float, degrees: float):
    """Exact without rotation but for the counting; with it the tiles' staircase adds less than a
    percent of a zone."""
    found = weights(rig, d_x=2.0, d_y=1.0, s=scale, phi=degrees)
    middle, angle = np.array([4.5, 2.5]), np.radians(degrees)
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    ratios = (np.arange(400) + 0.5) / 400
    for row, channel in zip(found, rig.channels, strict=True):
        assert isinstance(channel.sensor, ZoneSensor)
        (x0, x1), (y0, y1) = (100 * np.array(channel.sensor.x), 100 * np.array(channel.sensor.y))
        points = np.stack(np.meshgrid(x0 + (x1 - x0) * ratios, y0 + (y1 - y0) * ratios), axis=-1)
        x, y = np.moveaxis((points - middle) @ turn.T + middle + [0.2, 0.1], -1, 0)
        interpolated = [
            np.interp(at, centres, unit)
            for at, centres, sizes in ((y, [1.5, 4], 2), (x, [1, 4, 7.5], 3))
            for unit in np.eye(sizes)
        ]
        down, across = np.stack(interpolated[:2]), np.stack(interpolated[2:])
        inside = (x > 0) & (x < 9) & (y > 0) & (y < 5)
        counted = np.einsum("rij,cij->rc", down * inside, across).ravel() / x.size
        np.testing.assert_allclose(row, counted, atol=0.006)


@pytest.mark.slow
def test_readings_have_derivatives_in_the_registration(rig: Rig):
    """Against central differences, away from where an edge of a tile meets one of an element."""
    drive = Experiment.schedule("0:0.8", duration=60, step=20.0, channels=("T1", "T2"))
    at = {"d_x": 3.3, "d_y": -2.1, "s": 1.03, "phi": 1.7}
    with jax.enable_x64(True):
        twin = Twin(rig)

        def read(values: dict[str, float]) -> jax.Array:
            return response(twin.with_values(values), drive)

        slopes = jax.jacfwd(read)(at)
        for name, step in (("d_x", 1e-3), ("d_y", 1e-3), ("s", 1e-5), ("phi", 1e-3)):
            above, below = (read(at | {name: at[name] + way * step}) for way in (1, -1))
            np.testing.assert_allclose(slopes[name], (above - below) / (2 * step), atol=1e-6)
            assert np.abs(slopes[name]).max() > 1e-3


@pytest.mark.slow
def test_draws_of_the_registration_are_the_single_runs(rig: Rig):
    drive = Experiment.schedule("0:0.8", duration=60, step=5.0, channels=("T2", "T1"), ambient=18.0)
    shifts = np.array([-9.0, 0.0, 12.0])
    many = simulate_batch(Twin(rig), drive, {"d_x": shifts})
    for shift, temperatures in zip(shifts, many, strict=True):
        single = simulate(Twin(rig, {"d_x": shift}), drive)
        np.testing.assert_allclose(temperatures, single.temperatures, atol=2e-4)


def test_named_elements_cannot_be_moved(tmp_path):
    path = rig_file(tmp_path, second='[[channels]]\nname = "T2"\nnodes = ["V13"]')
    with pytest.raises(RigError, match=r"channels\[T2\]: expected ranges .* of kind 'nodes'"):
        load_rig(path)
