"""Forty ways to go wrong: the cells are off in time, for a reason that fits.

`benchmarks/live_hazards.py` runs each of them 25 times; the table is in docs/reliability.md.
"""

from dataclasses import replace

import pytest
from hazards import HAZARDS, Hazard, run_hazard

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
