"""The bundled synthetic recordings: what was done to make them can be seen in them."""

import numpy as np
import pytest

from jaxtwin.data import _make_synthetic as made
from jaxtwin.data import synthetic_recordings, synthetic_truth
from jaxtwin.io import read_recording
from jaxtwin.physics import Twin
from jaxtwin.rig import load_rig, read_parameters

RECORDINGS = {path.stem: path for path in synthetic_recordings()}


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDINGS)
def test_the_file_is_what_the_script_makes(name):
    """The script's own seed and truth; the last digit may round the other way elsewhere."""
    stored, (again, temperatures) = read_recording(RECORDINGS[name]), made.make_recording(name)
    assert stored.channels == again.channels
    np.testing.assert_array_equal(stored.time, again.time)
    np.testing.assert_array_equal(stored.duty, again.duty)
    assert stored.temperatures is not None
    np.testing.assert_allclose(stored.temperatures, temperatures, rtol=0, atol=0.0101)


@pytest.mark.parametrize("name", RECORDINGS)
def test_the_truth_beside_it_leaves_the_stated_noise(name):
    """0.1 K of noise and rounding to 0.01 K: 0.1 K standard deviation, no mean, 5005 samples."""
    rig = load_rig("paper-2024")
    experiment = read_recording(RECORDINGS[name])
    run = Twin(rig, read_parameters(synthetic_truth(), rig, name)).simulate(experiment)
    assert experiment.temperatures is not None
    residual = experiment.temperatures - run.temperatures
    assert residual.std() == pytest.approx(0.1, abs=0.004)
    assert residual.mean() == pytest.approx(0.0, abs=0.006)


def test_zones_and_drive_are_those_of_the_real_recordings():
    """circuit.md, section 9: five channels a zone, 1001 rows at 1 Hz, 128 then 200 counts."""
    experiments = [read_recording(path) for path in RECORDINGS.values()]
    for experiment, zone in zip(experiments, "ABC", strict=True):
        assert f"T{zone}M" in experiment.channels
        assert experiment.time.shape == (1001,)
        assert experiment.switch_times.tolist() == [500.0]
        np.testing.assert_allclose(experiment.duty[[0, -1]], [[128 / 255] * 2, [200 / 255] * 2])
    assert sorted(name for e in experiments for name in e.channels) == sorted(
        channel.name for channel in load_rig("paper-2024").channels
    )


def test_truth_lies_between_the_bounds_and_away_from_the_published_values():
    rig = load_rig("paper-2024")
    truth = read_parameters(synthetic_truth(), rig)
    for name, published in rig.parameter_sets["published"].items():
        row = rig.parameters[name]
        assert 1.5 * row.lower < truth[name] < row.upper / 1.5
        assert abs(np.log(truth[name] / published)) > 0.05
