"""The rest of a recording, as an observer that has followed its first part expects it."""

from dataclasses import replace

import numpy as np

from ..io import Experiment
from ..matching import Band, Fit
from ..matching._band import LEVEL
from ..observers import ProcessNoise
from ..simulation import Run
from ._validation import Prediction


def forecast_rest(
    name: str, fit: Fit, recording: Experiment, start: float, noise: ProcessNoise
) -> Prediction:
    """Predicts a recording from a time on.

    The observer follows a recording whose readings from this time on are missing, so that all that
    it expects of them is a forecast. Its band contains the error of the twin itself beside that of
    its values.

    **Arguments:**

    - `name`: the name of the recording.
    - `recording`: the whole recording, with the name of its group.
    - `start`: the time, s.
    - `noise`: the noise of rig and readings.
    """
    # A validation without an observer does not wait for its import.
    from ..observers import observe

    assert recording.temperatures is not None
    is_given = recording.time < start
    readings = np.where(is_given[:, None], recording.temperatures, np.nan)
    observed = observe(fit, replace(recording, temperatures=readings), noise)
    twin, expected, estimates = observed.observer.model.twin, observed.expected, observed.estimates
    run = Run(
        experiment=recording,
        channels=observed.channels,
        temperatures=expected.mean,
        nodes=estimates.nodes,
        states=np.asarray(estimates.moments.nodes.mean),
        rig=twin.rig.name,
        elements=len(twin.rig.plate.element_names),
    )
    band = Band(run, expected.lower, expected.upper, LEVEL).between(start)
    last = np.flatnonzero(is_given)[-1]
    table = twin.rig.parameters
    values = {
        name: float(parameter.mean[last])
        for name, parameter in estimates.parameters.items()
        if table[name].scope != "shared"
    }
    is_matched = recording.fingerprint in fit.fingerprints
    return Prediction(
        name, band.run, twin, values, (), None, is_matched, make_band=lambda: band
    )  # fmt: skip
