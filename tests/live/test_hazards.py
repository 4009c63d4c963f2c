"""Forty ways to go wrong: the cells are off in time, for a reason that fits.

`benchmarks/live_hazards.py` runs each of them 25 times; the table is in docs/reliability.md.
"""

from dataclasses import replace
from pathlib import Path

import pytest
from hazards import HAZARDS, Hazard, run_hazard, save_pid

from jaxtwin.physics import Twin
from jaxtwin.rig import Rig, Sensors

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def twins(rig: Rig, twin: Twin) -> tuple[Twin, Twin]:
    """Of the rig, and of the same rig with sensors in place of its camera."""
    return twin, Twin(replace(rig, camera=None, sensors=Sensors(0.1)))


@pytest.mark.parametrize("hazard", HAZARDS, ids=lambda hazard: hazard.name)
def test_the_cells_are_off_in_time(twins: tuple[Twin, Twin], hazard: Hazard) -> None:
    ran = run_hazard(hazard, twins, seed=1)
    assert ran.reason in hazard.kinds, ran.detail
    assert ran.off_after <= hazard.bound


CONTROLLED = (
    "sensor: open",
    "controller: NaN",
    "host: killed",
    "camera: all pixels 0",
    "camera: image stands still",
    "cell 19 K above the room inside",
    "sensor: on the bench",
    "bridge: full duty",
    "bridge: stuck at the last duty",
    "commands: lost",
    "controller: raises",
)


@pytest.mark.parametrize(
    "name",
    [*CONTROLLED[:3], *(pytest.param(name, marks=pytest.mark.long) for name in CONTROLLED[3:])],
)
def test_a_controller_of_a_file_is_stopped_as_a_schedule_is(
    twins: tuple[Twin, Twin], name: str, tmp_path: Path
) -> None:
    (hazard,) = [hazard for hazard in HAZARDS if hazard.name == name]
    ran = run_hazard(hazard, twins, 1, save_pid(tmp_path / "pid.toml", twins[0]))
    assert ran.reason in hazard.kinds, ran.detail
    assert ran.off_after <= hazard.bound
