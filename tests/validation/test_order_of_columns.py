"""Recordings meet a rig by the names of their columns: another order of columns gives the same
numbers."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from heated_box import heated_box

import jaxtwin as jt
from jaxtwin import Experiment, Fit, Twin
from jaxtwin.matching import match_many
from jaxtwin.monitoring import calibrate_monitor
from jaxtwin.observers import estimate_noise
from jaxtwin.simulation import response
from jaxtwin.validation import leave_one_out, validate_split

DUTY = "0:0.8/0,60:0.1/0.6,180:0/0.2,260:0.5/0.9"


@pytest.fixture(scope="module", name="recordings")
def make_recordings() -> list[Experiment]:
    twin, random = Twin(heated_box()), np.random.default_rng(3)
    recorded = []
    for number in range(3):
        drive = Experiment.schedule(DUTY, duration=400 + 40 * number, step=2, cells=2)
        run = twin.simulate(drive)
        noisy = run.temperatures + random.normal(0, 0.05, run.temperatures.shape)
        recorded.append(
            replace(
                drive.for_rig(twin.rig),
                temperatures=noisy,
                channels=twin.channels,
                name=f"run {number}",
            )
        )
    return recorded


@pytest.fixture(scope="module", name="fit")
def make_fit(recordings: list[Experiment]) -> Fit:
    return jt.match(Twin(heated_box()), recordings[:1], free=["P", "R_film"])


def turned(experiment: Experiment) -> Experiment:
    return replace(experiment, duty=experiment.duty[:, ::-1], cells=experiment.cells[::-1])


def box() -> Twin:
    return Twin(heated_box())


FUNCTIONS: dict[str, Callable[[Fit, list[Experiment]], Any]] = {
    "match_many": lambda _, several: [
        fit.twin.values["P"] for fit in match_many(box(), [several[:1]], free=["P"]) if fit
    ],
    "estimate_noise": lambda fit, several: estimate_noise(fit, several[1], horizons=60.0).heat,
    "calibrate_monitor": lambda fit, several: list(
        calibrate_monitor(fit, several[1], hours=0).scales.values()
    ),
    "validate_split": lambda _, several: (
        validate_split(box(), several[:1], 200, free=["P"]).predictions[0].run.temperatures
    ),
    "leave_one_out": lambda _, several: (
        leave_one_out(box(), several, free=["P"], warm_up=60).predictions[0].run.temperatures
    ),
    "validate": lambda fit, several: (
        jt.validate(fit, several[1], given=several[2]).predictions[0].run.temperatures
    ),
    "prediction_band": lambda fit, several: (
        jt.prediction_band(fit, experiment=several[1], given=several[2:]).upper
    ),
    "simulate_batch": lambda _, several: jt.simulate_batch(
        box(), several[0], {"P": np.array([20.0])}
    ),
    "response": lambda _, several: response(box(), several[0]),
    "sensitivity": lambda fit, several: jt.sensitivity(fit.twin, several[0], draws=20).values,
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_another_order_gives_the_same_numbers(name: str, fit: Fit, recordings: list[Experiment]):
    function = FUNCTIONS[name]
    expected = function(fit, recordings)
    found = function(fit, [turned(one) for one in recordings])
    np.testing.assert_allclose(found, expected, rtol=1e-9)
