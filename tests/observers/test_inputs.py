"""An observer of a rig with a lid, whose state it is told."""

import dataclasses

import numpy as np
import pytest

from jaxtwin import Experiment, Twin, observe, simulate
from jaxtwin.observers import Observed
from jaxtwin.observers._observe import usual_noise
from jaxtwin.simulation import Run

INPUTS = {"lid": "0:closed,200:open,260:closed"}


@pytest.fixture(scope="module")
def run() -> Run:
    box = Twin("heated-box")
    plan = Experiment.schedule(
        "0:0.5,300:0.2", duration=400, step=5, ambient=float(box.values["T_amb"]), inputs=INPUTS
    )
    return simulate(box, plan)


@pytest.fixture(scope="module")
def observed(run: Run) -> Observed:
    assert run.twin is not None
    recording = run.to_recording(noise=0.01, seed=1)
    noise = dataclasses.replace(
        usual_noise(run.twin, [recording]), reading=0.01, heat=1e-4, disturbance=1e-3, common=1e-3
    )
    return observe(run.twin, recording, noise)


@pytest.mark.slow
def test_the_lid_is_no_surprise(observed: Observed):
    at = (observed.time > 190) & (observed.time < 320)
    assert np.abs(observed.innovations[at]).max() < 0.06
    assert observed.ahead(60.0).rmse < 0.04


@pytest.mark.slow
def test_a_forecast_knows_the_lid_of_the_recording(observed: Observed, run: Run):
    forecast = observed.forecast(200.0, at=190.0)
    expected = run.temperatures[np.isin(run.time, forecast.time)]
    np.testing.assert_allclose(forecast.mean, expected, rtol=0, atol=0.05)
    # Without the lid the air would be kelvins warmer.
    assert np.ptp(run.temperatures[run.time >= 190]) > 1
