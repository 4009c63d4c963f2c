"""A match all of whose unknowns end at bounds: none is left that the residuals could tell of."""

import numpy as np
import pytest

from jaxtwin import Experiment, Twin, match


@pytest.mark.slow
@pytest.mark.parametrize(("truth", "bound"), [(15.0, 30.0), (60.0, 40.0)])
def test_a_match_of_one_parameter_that_ends_at_its_bound_gives_a_fit(truth: float, bound: float):
    """The load is lighter, or heavier, than its bounds let it be."""
    rig = Twin("single-cell", {"C_load": truth})
    drive = Experiment.schedule("0:0.4", duration=60)
    seen = rig.simulate(drive).temperatures
    noise = 0.05 * np.random.default_rng(0).standard_normal(seen.shape)
    day = Experiment(drive.time, drive.duty, channels=("T",), temperatures=seen + noise)
    start = Twin("single-cell", {"C_load": 35.0})
    fit = match(start, day, free=["C_load"], bounds={"C_load": (30.0, 40.0)})
    row = fit["C_load"]
    assert row.at_bound
    assert row.value == pytest.approx(bound, rel=1e-12)
    assert np.isnan(row.standard_error)
    assert "at bound" in fit.summary()
