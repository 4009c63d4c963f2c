"""A room that was not recorded, beside an unknown loss to it."""

import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin import Experiment, Twin

ADVICE = "the room was not recorded"


def _fit(ambient: float | None) -> jt.Fit:
    """A match to a board that begins warm."""
    twin = Twin("tclab")
    duty = np.full((400, 2), 0.6)
    duty[100:250, 0], duty[220:330, 1] = 0.7, 0.5
    experiment = Experiment(5.0 * np.arange(400), duty, ambient=ambient)
    run = jt.simulate(twin.with_values({"T_start": 45.0}), experiment)
    recording = run.to_recording(noise=0.1, seed=2)
    return jt.match(twin, recording, free=["C_1", "R_1", "R_2", "T_amb", "T_start"])


@pytest.mark.slow
def test_a_match_says_what_tells_room_and_loss_apart():
    assert ADVICE in _fit(None).summary()
    assert ADVICE not in _fit(23.0).summary()
