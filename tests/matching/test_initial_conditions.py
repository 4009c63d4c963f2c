"""A recording's own values from its first minute, whatever the camera does in it."""

import numpy as np
import pytest

from jaxtwin import Experiment, Twin, simulate
from jaxtwin.errors import MatchError, SimulationError
from jaxtwin.matching import estimate_initial_conditions

CHANNELS = ("T11", "T12", "TAM")
TRUTH = {"T_amb": 23.0, "T_start": 22.0}


def minute(jump: float) -> Experiment:
    """Cells off on a warm day, noise of 0.05 K, and a correction of the camera at 20 s."""
    drive = Experiment.schedule("0:0", duration=80, cells=2, channels=CHANNELS)
    seen = simulate(Twin("dual-cell", TRUTH), drive).temperatures
    seen = seen + 0.05 * np.random.default_rng(0).standard_normal(seen.shape)
    after = np.maximum(drive.time - 20, 0)
    seen += (np.where(drive.time >= 20, jump, 0.0) * np.exp(-after / 25))[:, None]
    return Experiment(drive.time, drive.duty, channels=CHANNELS, temperatures=seen, name="day")


@pytest.fixture(scope="module")
def calm() -> dict[str, float]:
    return dict(estimate_initial_conditions(Twin("dual-cell"), minute(0.0)).values)


@pytest.mark.slow
def test_room_and_start_are_found_on_a_day_unlike_those_of_the_rigs_table(calm: dict[str, float]):
    """The table expects 16 +- 3 degC for both."""
    assert calm["T_amb"] == pytest.approx(23.0, abs=1.0)
    assert calm["T_start"] == pytest.approx(22.0, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("jump", [2.0, -1.5])
def test_a_correction_of_the_camera_is_not_taken_for_a_plate_that_warms_or_cools(
    jump: float, calm: dict[str, float]
):
    """Taken for the plate, the jump would move the room's temperature by nearly its own size."""
    found = estimate_initial_conditions(Twin("dual-cell"), minute(jump)).values
    assert abs(found["T_amb"] - calm["T_amb"]) < 0.5 * abs(jump)
    assert found["T_start"] == pytest.approx(22.0, abs=0.5)


@pytest.mark.slow
def test_values_that_the_minute_does_not_tell_stay_where_they_were(calm: dict[str, float]):
    assert calm["t_delay"] == pytest.approx(2.0, rel=0.01)
    assert set(calm) == {"t_delay", "T_amb", "T_start"}


def test_a_recording_of_another_rig_or_of_nothing_is_refused():
    drive = Experiment.schedule("0:0", duration=80, channels=("T",))
    cell = Experiment(drive.time, drive.duty, channels=("T",), temperatures=np.zeros((81, 1)))
    with pytest.raises(SimulationError, match="expected the 2 cells of dual-cell, got 1"):
        estimate_initial_conditions(Twin("dual-cell"), cell)
    both = Experiment(drive.time, np.zeros((81, 2)), channels=("T",), temperatures=np.zeros(81))
    with pytest.raises(SimulationError, match=r"channels: expected those of dual-cell, .* got T"):
        estimate_initial_conditions(Twin("dual-cell"), both)
    with pytest.raises(MatchError, match="expected recorded temperatures"):
        estimate_initial_conditions(
            Twin("dual-cell"), Experiment.schedule("0:0", duration=80, cells=2)
        )
