"""An experiment as the relays of its rig switch it."""

import numpy as np
import pytest
from heated_box import heated_box
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin import Experiment, Twin
from jaxtwin.errors import RecordingError
from jaxtwin.rig import Rig

TABLE = 'time_proportional = { period = "10 s", minimum_on = "2 s", minimum_off = "1 s" }'


def box(table: str = TABLE) -> Rig:
    return heated_box(('power = "12 W"', f'power = "12 W"\n{table}'))


@given(
    st.lists(st.floats(0, 1), min_size=2, max_size=20),
    st.floats(0.3, 25),
    st.sampled_from(["2 s", "0.7 s", "13 s"]),
)
def test_the_mean_is_that_of_the_duty_and_the_samples_are_kept(levels, step, period):
    rig = box(f'time_proportional = {{ period = "{period}" }}')
    time = 5 + step * np.arange(len(levels))
    asked = Experiment(
        time,
        np.stack([np.full(len(levels), 0.25), levels], axis=1),
        channels=["T_air"],
        temperatures=20 + np.arange(len(levels))[:, None],
    )
    found = asked.switched(rig)
    assert found.cells == rig.driven
    assert set(found.duty[:, 1]) <= {0.0, 1.0}
    assert np.all(found.duty[:, 0] == 0.25)
    kept = found.sampled[:, 0]
    assert found.temperatures is not None
    np.testing.assert_allclose(found.time[kept], time)
    np.testing.assert_array_equal(found.temperatures[kept], asked.temperatures)
    window = float(period.split()[0])
    starts = np.arange(0, found.time[-1] - 5 - window + 1e-9, window)
    held = np.array(levels)[np.searchsorted(time - 5, starts + 1e-9, side="right") - 1]
    length = np.diff(found.time - 5)
    inside = found.time[:-1] - 5 < len(starts) * window - 1e-9
    assert length[inside] @ found.duty[:-1, 1][inside] == pytest.approx(
        window * held.sum(), abs=1e-6 * len(levels)
    )


def test_a_simulation_of_it_shows_the_ripple():
    """A twin has the mean; switched, the air swings about it with the period of the window."""
    twin = Twin(box())
    drive = Experiment.schedule("0:0.2/0.4", duration=600, step=1, cells=2)
    mean = twin.simulate(drive)
    ripple = twin.simulate(drive.switched(twin.rig))
    late = ripple.experiment.time > 300
    at_samples = np.interp(ripple.experiment.time, drive.time, mean.temperatures[:, 0])
    apart = (ripple.temperatures[:, 0] - at_samples)[late]
    assert 0.2 < np.ptp(apart) < 1.0
    assert abs(apart.mean()) < 0.1
    duty = ripple.experiment.duty[late, 1]
    assert np.ptp(duty) == 1
    switches = ripple.experiment.time[1:][np.diff(ripple.experiment.duty[:, 1]) != 0]
    np.testing.assert_allclose(switches[:4], [4, 10, 14, 20])


def test_a_rig_without_relays_leaves_it_as_it_is():
    drive = Experiment.schedule("0:0.2/0.4", duration=60, step=1, cells=2)
    assert drive.switched(heated_box()) == drive


def test_more_switches_than_fit_are_refused():
    drive = Experiment.schedule("0:0.2/0.4", duration=1e6, step=1e4, cells=2)
    with pytest.raises(
        RecordingError, match="switched: expected at most 10000000 switches of bulb"
    ):
        drive.switched(box('time_proportional = { period = "1 ms" }'))
