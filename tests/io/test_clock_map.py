"""Clock maps against clocks of known drift, with waits as links have them."""

import numpy as np
import pytest
from hand_clock import START

from jaxtwin.io import ClockMap


def stamps(
    duration: float, drift_ppm: float, *, rate: float = 1.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Device stamps (us), arrivals (ns) and true host times (s) of a device at 10 Hz.

    Waits are 1 ms and an exponential tail of 10 ms, with a stall of 0.5 s now and then.
    """
    random = np.random.default_rng(seed)
    true = np.arange(0, duration, 0.1)
    device = true * rate * (1 + drift_ppm * 1e-6) + 7.0
    wait = 0.001 + random.exponential(0.01, true.size) + 0.5 * (random.random(true.size) < 0.01)
    arrival = np.maximum.accumulate(START + np.rint((true + wait) * 1e9).astype(np.int64))
    return np.rint(device * 1e6).astype(np.int64), arrival, START * 1e-9 + true


@pytest.mark.parametrize("drift", [-100.0, 0.0, 40.0])
def test_drift_is_found_to_a_part_in_a_million_within_an_hour(drift: float) -> None:
    device, arrival, _ = stamps(3600, drift)
    assert ClockMap.fit(device, arrival, 1.0).drift == pytest.approx(drift, abs=1.0)


@pytest.mark.parametrize(("duration", "rate"), [(30, 1.0), (3600, 1.0), (600, 60.0)])
def test_mapped_time_is_the_true_time_within_two_milliseconds(duration: float, rate: float) -> None:
    device, arrival, true = stamps(duration, 50.0, rate=rate)
    error = ClockMap.fit(device, arrival, rate).host_seconds(device) - true
    assert np.abs(error - 0.001).max() < 0.002  # 1 ms is the shortest wait, which nobody can see


def test_the_wait_is_that_of_the_link() -> None:
    device, arrival, _ = stamps(3600, 50.0)
    median, most, greatest = ClockMap.fit(device, arrival, 1.0).wait
    # Of an exponential distribution with mean 10 ms: ln 2, and the stalls above its 99 %.
    assert median == pytest.approx(0.00693, abs=0.001)
    assert 0.04 < most < 0.56
    assert greatest == pytest.approx(0.52, abs=0.06)


def test_a_drift_that_changes_is_followed() -> None:
    # A crystal warms up: 0 ppm at first, 20 ppm after two hours.
    random = np.random.default_rng(1)
    true = np.arange(0, 7200, 0.1)
    device = true + 20e-6 * true**2 / 2 / 7200
    arrival = START + np.rint((true + random.exponential(0.005, true.size)) * 1e9).astype(np.int64)
    arrival = np.maximum.accumulate(arrival)
    stamps_us = np.rint(device * 1e6).astype(np.int64)
    error = ClockMap.fit(stamps_us, arrival, 1.0).host_seconds(stamps_us) - (START * 1e-9 + true)
    assert np.abs(error).max() < 0.003


def test_a_map_of_one_stamp_has_its_arrival_and_the_nominal_rate() -> None:
    clock = ClockMap.fit(np.array([5_000_000]), np.array([START]), 1.0)
    assert clock.host_seconds(np.array([6_000_000])) == pytest.approx([START * 1e-9 + 1.0])
