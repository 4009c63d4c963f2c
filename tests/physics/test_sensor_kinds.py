"""A kind of sensor of a user's own, in a rig file, a simulation and frames of a camera."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from small_rigs import CAMERA, small_rig_file

from jaxtwin import Experiment, Twin, load_rig, simulate
from jaxtwin.errors import RigError
from jaxtwin.physics import channel_weights, frame_to_channels
from jaxtwin.rig import (
    COORDINATE,
    LENGTH,
    AbstractSensor,
    NodesSensor,
    PointSensor,
    ZoneSensor,
    register_sensor,
)


@register_sensor
@dataclass(frozen=True)
class Spot(AbstractSensor):
    """The mean over a disc, as of a pyrometer."""

    kind = "own-spot"
    quantities: ClassVar = {"x": COORDINATE, "y": COORDINATE, "diameter": LENGTH}
    x: float
    y: float
    diameter: float

    def weights(self, plate):
        angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        rings = self.diameter / 2 * np.sqrt((np.arange(8) + 0.5) / 8)  # of equal areas
        points = [(self.x + r * np.cos(a), self.y + r * np.sin(a)) for r in rings for a in angles]
        found = [plate.point_weights(*point) for point in points]
        return {
            name: float(np.mean([row.get(name, 0.0) for row in found]))
            for name in plate.element_names
        }

    def outline(self, plate):
        half = self.diameter / 2
        return [(self.x - half, self.x + half, self.y - half, self.y + half)]


def channel(keys: str, name: str = "T1") -> str:
    return f'[[channels]]\nname = "{name}"\n{keys}\n'


SPOT = channel('sensor = "own-spot"\nx = "4 cm"\ny = "3 cm"\ndiameter = "2 cm"')


def rig_file(folder: Path, channels: str, sensors: str = '[sensors]\nnoise = "0.1 K"') -> Path:
    return small_rig_file(
        folder,
        ["2 cm"] * 4,
        ["2 cm"] * 3,
        [{"V11": "0.5 K/W"}],
        thickness="1 mm",
        density="8960 kg/m^3",
        specific_heat="390 J/(kg K)",
        film_coefficient="15 W/(m^2 K)",
        sink_resistance="0.5 K/W",
        sensors=sensors,
        channels=channels,
        parameters="",
    )


def test_a_spot_between_four_elements_weighs_them_by_symmetry(tmp_path: Path):
    """The point lies on the border of columns 2 and 3, in the middle of row 2."""
    rig = load_rig(rig_file(tmp_path, SPOT))
    weights = channel_weights(rig)[0].reshape(3, 4)
    assert weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(weights, weights[::-1, ::-1], atol=1e-12)
    # The mean distance of a disc of radius 1 cm from its middle line is 4 / (3 pi) cm; a row's
    # centres are 2 cm apart.
    assert weights[0].sum() == pytest.approx(4 / (3 * np.pi) / 2 / 2, rel=0.01)


@pytest.mark.slow
def test_a_spot_reads_what_its_weights_say_also_with_gain_and_lag(tmp_path: Path):
    elements = "".join(
        channel(f'nodes = ["V{row}{column}"]', f"E{row}{column}")
        for row in (1, 2, 3)
        for column in (1, 2, 3, 4)
    )
    keys = 'sensor = "own-spot"\nx = "4 cm"\ny = "3 cm"\ndiameter = "2 cm"'
    more = channel(f'{keys}\ngain = "0.8"', "T2") + channel(f'{keys}\nlag = "1 ms"', "T3")
    rig = load_rig(rig_file(tmp_path, SPOT + more + elements))
    recording = Experiment(np.arange(0.0, 30.0), np.full((30, 1), 0.5), ambient=20.0)
    run = simulate(Twin(rig), recording)
    plain, gained, lagged = np.asarray(run.temperatures).T[:3]
    expected = np.asarray(run.temperatures)[:, 3:] @ channel_weights(rig)[0]
    np.testing.assert_allclose(plain, expected, atol=1e-6)
    np.testing.assert_allclose(gained, 20 + 0.8 * (expected - 20), atol=1e-6)
    np.testing.assert_allclose(lagged[1:], expected[1:], atol=2e-3)
    assert expected[-1] > 21


def test_a_camera_reads_a_spot_by_the_pixels_of_its_outline(tmp_path: Path):
    camera = CAMERA.replace("80", "90").replace("60", "50")
    rig = load_rig(rig_file(tmp_path, SPOT, camera))
    assert rig.camera is not None
    frame = np.full((rig.camera.height, rig.camera.width), 24.0)
    assert frame_to_channels(rig, frame)[0] == pytest.approx(24.0)


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ('sensor = "own-sopt"', "kind of sensor 'own-sopt'.*own-spot"),
        ('sensor = "own-spot"\nx = "4 cm"\ny = "3 cm"', "diameter: missing, .*'own-spot'"),
        (SPOT.split("\n", 2)[2].replace("2 cm", "2 K"), "diameter: expected a length above 0"),
        (SPOT.split("\n", 2)[2].replace('"2 cm"', "2"), "diameter: expected a length above 0"),
        ('sensor = "own-spot"\nnodes = ["V11"]', "unknown key 'nodes'.*diameter"),
        ('nodes = ["V11"]\ndiameter = "2 cm"', "unknown key 'diameter'.*lag"),
        ('sensor = "zone"\nnodes = ["V11"]', r"channels\[T1\].sensor: expected 'nodes'"),
        ('sensor = "zone"', r"channels\[T1\]: expected either nodes or x with y"),
    ],
)
def test_wrong_keys_of_a_sensor_are_named(tmp_path: Path, keys: str, expected: str):
    with pytest.raises(RigError, match=expected):
        load_rig(rig_file(tmp_path, channel(keys)))


def test_the_kinds_that_keys_imply_may_be_named(tmp_path: Path):
    for keys, kind in (
        ('sensor = "nodes"\nnodes = ["V11"]', NodesSensor),
        ('sensor = "zone"\nx = ["0 cm", "4 cm"]\ny = ["0 cm", "2 cm"]', ZoneSensor),
        ('sensor = "point"\nx = "4 cm"\ny = "2 cm"', PointSensor),
    ):
        sensor = load_rig(rig_file(tmp_path, channel(keys))).channels[0].sensor
        assert isinstance(sensor, kind)


def test_a_name_that_is_taken_is_refused():
    @dataclass(frozen=True)
    class Mine(Spot):
        kind = "zone"

    with pytest.raises(RigError, match=r"Mine.kind: expected a name that is not taken, got 'zone'"):
        register_sensor(Mine)


def test_a_sensor_that_weighs_an_unknown_node_is_refused(tmp_path: Path):
    @register_sensor
    @dataclass(frozen=True)
    class Lost(AbstractSensor):
        kind = "own-nowhere"

        def weights(self, plate):
            return {"V99": 1.0}

        def outline(self, plate):
            return []

    rig = load_rig(rig_file(tmp_path, channel('sensor = "own-nowhere"')))
    with pytest.raises(RigError, match=r"channels\[T1\]: expected .* got 'V99' in Lost"):
        Twin(rig).system(lumped=False)
