"""What a single bad reading does to a match, and to a start that is estimated."""

from dataclasses import replace

import numpy as np
import pytest

import jaxtwin as jt
from jaxtwin import Experiment, Twin
from jaxtwin.matching import estimate_initial_conditions

FREE = ["C_1", "R_1", "T_start"]


@pytest.fixture(scope="module")
def healthy() -> Experiment:
    plan = Experiment.schedule("0:0.3,300:0.6", duration=600, cells=2, ambient=23.0)
    run = Twin("tclab").with_values({"T_start": 25.0}).simulate(plan)
    return replace(run.to_recording(noise=0.1, seed=2), name="board")


def glitched(recording: Experiment, row: int, value: float) -> Experiment:
    readings = np.array(recording.temperatures)
    readings[row, 0] = value
    return replace(recording, temperatures=readings)


def test_a_match_names_the_reading_that_holds_the_misfit(healthy: Experiment) -> None:
    bad = glitched(healthy, 400, -127.0)
    summary = jt.match(Twin("tclab"), bad, free=FREE).summary()
    assert "board: one reading of T1, -127 degC at 400 s, holds " in summary
    assert "% of the misfit of all readings" in summary
    assert "Experiment.without_glitches()" in summary
    left_out = jt.match(Twin("tclab"), bad.without_glitches(), free=FREE)
    assert "of the misfit" not in left_out.summary()
    clean = jt.match(Twin("tclab"), healthy, free=FREE)
    for name in FREE[:2]:
        apart = left_out[name].value - clean[name].value
        assert abs(apart) < clean[name].standard_error


@pytest.mark.parametrize("row", [0, 1, 30])
def test_a_start_is_not_estimated_from_a_glitch(healthy: Experiment, row: int) -> None:
    twin = Twin("tclab")
    bad = estimate_initial_conditions(twin, glitched(healthy, row, 83.0))
    clean = estimate_initial_conditions(twin, healthy)
    assert bad.values["T_start"] == pytest.approx(clean.values["T_start"], abs=0.1)
