"""What an observer refuses, and what it names and allows instead."""

from typing import Any

import numpy as np
import pytest

from jaxtwin import Experiment, Twin, simulate
from jaxtwin.errors import ObserverError, SimulationError
from jaxtwin.observers import Observed, ProcessNoise, observe


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("tclab")


@pytest.fixture(scope="module")
def recording(twin: Twin) -> Experiment:
    drive = Experiment.schedule("0:0.5/0", duration=60, cells=2)
    return simulate(twin, drive).to_recording(noise=0.1, name="bench")


@pytest.fixture(scope="module")
def observed(twin: Twin, recording: Experiment) -> Observed:
    return observe(twin, recording)


@pytest.mark.parametrize("level", [-0.1, 0.0, np.nan])
def test_a_level_that_is_not_above_zero(twin: Twin, recording: Experiment, level: float):
    with pytest.raises(ObserverError, match="noise: heat: expected a number above 0"):
        observe(twin, recording, ProcessNoise(heat=level))


def test_a_recording_without_readings(twin: Twin):
    drive = Experiment.schedule("0:0.5/0", duration=60, cells=2, name="drive")
    with pytest.raises(ObserverError, match="drive: expected readings, got none"):
        observe(twin, drive)


def test_a_recording_without_one_of_the_inputs():
    box = Twin("heated-box")
    temperatures = np.full((5, len(box.channels)), 20.0)
    duty = np.zeros((5, len(box.rig.driven)))
    recording = Experiment(
        np.arange(5.0), duty, channels=box.channels, temperatures=temperatures, name="no lid"
    )
    with pytest.raises(SimulationError, match="no lid: expected a column for the input 'lid'"):
        observe(box, recording)


def test_a_recording_of_another_rig(recording: Experiment):
    with pytest.raises(
        ObserverError, match="bench: duty: expected columns of P1, P2, as dual-cell"
    ):
        observe(Twin("dual-cell"), recording)


def test_a_recording_with_another_number_of_heaters(twin: Twin):
    one = np.ones((5, 1))
    recording = Experiment(np.arange(5.0), 0.1 * one, channels=["T1"], temperatures=one, name="one")
    with pytest.raises(SimulationError, match="one: duty: expected the 2 heaters of tclab, got 1"):
        observe(twin, recording)


@pytest.mark.parametrize("seconds", [-1.0, 61.0])
def test_forecasts_ahead_by_more_than_the_recording(observed: Observed, seconds: float):
    with pytest.raises(ObserverError, match=rf"ahead: seconds: expected 0 to 60.*got {seconds:g}"):
        observed.ahead(seconds)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"horizon": 0.2}, "horizon: expected at least the sample time of 1 s, got 0.2"),
        ({"horizon": np.nan}, "horizon: expected a finite number"),
        ({"horizon": 10.0, "at": 61.0}, "at: expected a time of the recording, 0 to 60 s, got 61"),
        ({"horizon": 10.0, "at": -1.0}, "at: expected a time of the recording"),
        ({"horizon": 10.0, "duty": 1.2}, "duty: expected numbers from 0 to 1.*got 1.2"),
        ({"horizon": 10.0, "duty": -0.2}, "duty: expected numbers from 0 to 1"),
        ({"horizon": 10.0, "duty": np.nan}, "duty: expected numbers from 0 to 1"),
        ({"horizon": 10.0, "duty": "full"}, "duty: expected numbers from 0 to 1.*got 'full'"),
        ({"horizon": 10.0, "duty": [0.1] * 3}, r"duty: expected .*2 \(one for each cell\)"),
    ],
)
def test_forecasts_of_nothing(observed: Observed, arguments: dict[str, Any], message: str):
    with pytest.raises(ObserverError, match=f"forecast: {message}"):
        observed.forecast(**arguments)


@pytest.mark.parametrize(
    ("kind", "name", "meant"), [("node", "H11", "H1"), ("channel", "t1", "T1"), ("heat", "H", "H1")]
)
def test_a_name_that_the_rig_does_not_have(observed: Observed, kind: str, name: str, meant: str):
    with pytest.raises(ObserverError, match=rf"{kind}: expected one of .*{meant}.*got '{name}'"):
        getattr(observed.estimates, kind)(name)
