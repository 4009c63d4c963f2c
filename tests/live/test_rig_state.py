"""What is known of a rig: the last valid reading of each channel, with the time of the device."""

from dataclasses import replace

import numpy as np
import pytest
from hand_clock import START
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.live import (
    Event,
    Gap,
    Greeting,
    Hello,
    LinkChange,
    LinkState,
    Reading,
    RigState,
    Sample,
)

CONTROLLER = Greeting("l", START, Hello(2, "r", "b", cells=("P1",)))

# What the device's clock shows at START, microseconds.
BEGAN = 5 * 10**6


def at(seconds: float) -> int:
    return START + round(seconds * 1e9)


def reading(measured: float, arrived: float, *values: float, boot: str = "b") -> Reading:
    us = BEGAN + round(measured * 1e6)
    return Reading("l", boot, at(arrived), us, 0, np.array(values), False, None)


def sample(measured: float, arrived: float, pwm: tuple[int, ...] = (1,)) -> Sample:
    return Sample("l", "b", at(arrived), BEGAN + round(measured * 1e6), 0, pwm, 21.0)


def after(*records: object) -> RigState:
    state = RigState()
    for record in records:
        state = state.after(record)  # pyright: ignore[reportArgumentType]
    return state


def test_a_reading_that_waited_in_a_buffer_is_as_old_as_it_is() -> None:
    state = after(CONTROLLER, sample(0.0, 0.01), reading(1.0, 1.01, 20.0), reading(2.0, 4.5, 21.0))
    assert state.temperatures.tolist() == [21.0]
    # In the 3.5 s since, the clocks may have drifted by 1 %.
    assert at(2.01) <= state.measured[0] <= at(2.01 + 0.01 * 3.5)


def test_a_channel_keeps_its_last_valid_value_and_its_time() -> None:
    nan = float("nan")
    failed = replace(reading(2.0, 2.0, 30.0, nan), faults={1: "open"})
    state = after(CONTROLLER, reading(1.0, 1.0, 20.0, 25.0), failed)
    assert state.temperatures.tolist() == [30.0, 25.0]
    assert state.measured.tolist() == [at(2), at(1)]
    assert state.faults == {1: "open"}
    works = state.after(reading(3.0, 3.0, 31.0, 26.0))
    assert works.faults == {}
    assert state.temperatures.tolist() == [30.0, 25.0], "a state never changes"


def test_a_frame_of_a_recalibration_is_no_reading() -> None:
    closed = replace(reading(2.0, 2.0, 99.0), recalibrating=True)
    state = after(CONTROLLER, reading(1.0, 1.0, 20.0), closed)
    assert state.recalibrating
    assert state.temperatures.tolist() == [20.0]
    assert state.reading is not None
    assert state.reading.arrival == at(1)


def test_a_device_clock_that_stands_still_does_not_stop_time() -> None:
    """A twin that followed it would stand still as well."""
    state = after(CONTROLLER, *(reading(0.0, float(second), 20.0) for second in range(60)))
    assert state.measured.tolist() == [at(49)]


def test_a_device_twice_as_fast_is_read_in_the_time_of_the_host() -> None:
    fast = Greeting("l", START, Hello(2, "r", "b", cells=("P1",), rate=2.0))
    state = after(fast, sample(0.0, 0.0), reading(2.0, 1.0, 20.0), reading(4.0, 3.0, 20.0))
    assert state.rate == 2.0
    assert at(2) <= state.measured[0] <= at(2 + 0.01 * 3)


@given(
    st.lists(st.tuples(st.floats(0.05, 30.0), st.floats(0.0, 5.0)), min_size=1, max_size=40),
    st.floats(-1e-4, 1e-4),
)
def test_times_are_those_of_the_device_but_for_its_drift_and_the_smallest_delay(
    steps: list[tuple[float, float]], drift: float
) -> None:
    """Messages arrive in order, each after a delay; the clock of the device is off by 100 ppm."""
    state, true, arrived = after(CONTROLLER), 0.0, 0.0
    for step, delay in steps:
        true += step
        arrived = max(arrived, true + delay)
        record = reading(true * (1 + drift), arrived, 20.0)
        state = state.after(record)
        found = (state.time_of(record) - START) * 1e-9
        assert found <= arrived + 1e-6
        assert found >= true - 0.001


def test_a_restart_begins_with_a_new_clock() -> None:
    again = Greeting("l", at(100), Hello(2, "r", "c", cells=("P1",)))
    state = after(CONTROLLER, reading(1.0, 1.0, 20.0), again)
    state = state.after(reading(-4.0, 101.0, 22.0, boot="c"))
    assert state.measured.tolist() == [at(101)]
    assert state.boots == {"l": "c"}
    assert state.sample is None


def test_losses_links_and_trips_are_known() -> None:
    tripped = replace(sample(1.0, 1.0, (0,)), trip="watchdog", owner="me")
    state = after(
        CONTROLLER,
        LinkChange("l", START, LinkState.LIVE, ""),
        Gap("l", START, "data", 3, 7),
        Event("l", START, "garbage", "12 bytes"),
        Event("l", START, "recalibration-start"),
        tripped,
    )
    assert state.counts == {"lost": 7, "garbage": 1}
    assert state.links == {"l": LinkState.LIVE}
    assert (state.trip, state.ambient) == ("watchdog", 21.0)
    relay = Sample("r", "b2", at(2), 0, 0, (), None, relay="off")
    assert after(CONTROLLER, sample(1.0, 1.0), relay).trip == "relay"


@pytest.mark.parametrize("pwm", [(1,), ()])
def test_a_sample_of_another_device_is_none_of_the_controller(pwm: tuple[int, ...]) -> None:
    state = after(CONTROLLER, sample(1.0, 1.0), sample(2.0, 2.0, pwm))
    assert state.sample is not None
    assert state.sample.arrival == at(2.0 if pwm else 1.0)
