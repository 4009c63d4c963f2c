"""Glitches: readings that leave for a sample or two and are back."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin import Experiment, find_recordings, read_recording
from jaxtwin.data import synthetic_recordings


def heating(noise: float = 0.1, samples: int = 300, seed: int = 0) -> Experiment:
    """Two channels that are heated with a time constant of a minute."""
    time = np.arange(float(samples))
    rise = 30.0 * (1 - np.exp(-time / 60.0))
    readings = 20.0 + np.stack([rise, 0.5 * rise], axis=1)
    readings += np.random.default_rng(seed).normal(0.0, noise, readings.shape)
    return Experiment(time, np.full((samples, 1), 0.5), channels=("A", "B"), temperatures=readings)


def glitched(experiment: Experiment, row: int, column: int, value: float) -> Experiment:
    readings = np.array(experiment.temperatures)
    readings[row, column] = value
    return replace(experiment, temperatures=readings)


@given(
    row=st.integers(0, 299),
    column=st.integers(0, 1),
    offset=st.floats(5.0, 9000.0) | st.floats(-250.0, -5.0),
    noise=st.sampled_from([0.0, 0.05, 0.2]),
    seed=st.integers(0, 9),
)
def test_a_single_reading_is_named_wherever_it_is_and_nothing_else(
    row: int, column: int, offset: float, noise: float, seed: int
) -> None:
    healthy = heating(noise, seed=seed)
    assert healthy.temperatures is not None
    value = float(healthy.temperatures[row, column]) + offset
    experiment = glitched(healthy, row, column, value)
    (glitch,) = experiment.glitches
    assert (glitch.channel, glitch.time, glitch.reading) == ("AB"[column], row, value)
    assert glitch.offset == pytest.approx(offset, rel=1e-6, abs=1.5)
    expected = np.array(healthy.temperatures)
    expected[row, column] = np.nan
    np.testing.assert_array_equal(experiment.without_glitches().temperatures, expected)


def test_what_lasts_or_is_usual_is_no_glitch() -> None:
    healthy = heating()
    assert healthy.glitches == ()
    assert healthy.without_glitches() is healthy
    readings = np.array(healthy.temperatures)
    readings[100:104, 0] += 20.0  # a hand for four seconds
    readings[200:, 1] = 20.0  # a sensor that has fallen off
    assert replace(healthy, temperatures=readings).glitches == ()
    pulsing = np.array(healthy.temperatures)
    pulsing[::10] += 8.0  # a relay that disturbs every tenth reading
    assert replace(healthy, temperatures=pulsing).glitches == ()


def test_few_or_missing_readings_have_none() -> None:
    few = heating(samples=4)
    assert glitched(few, 2, 0, 85.0).glitches == ()
    readings = np.array(heating().temperatures)
    readings[:, 1] = np.nan
    assert replace(heating(), temperatures=readings).glitches == ()
    assert Experiment([0.0, 1.0], [[0.5], [0.5]]).glitches == ()


def test_the_bundled_recordings_have_none() -> None:
    for path in [*find_recordings(), *synthetic_recordings()]:
        assert read_recording(path).glitches == (), path


def test_it_is_named_with_what_is_beside_it() -> None:
    (glitch,) = glitched(heating(0.0), 200, 0, 85.0).glitches
    assert str(glitch) == "A at 200 s reads 85 degC, +36.1 K from the readings beside it"
