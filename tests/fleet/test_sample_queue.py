"""The messages of a rig become the steps of its observer, whatever it sends."""

import json
import math

import numpy as np
import pytest
from hand_clock import START
from hypothesis import given
from hypothesis import strategies as st
from small_fleet import encoded, twin

from jaxtwin.fleet._sample_queue import MAX_GAP, MAX_WAITING, SampleQueue

RIG = twin().rig
CHANNELS = twin().channels
BEGIN = START / 1e9


def queue() -> SampleQueue:
    return SampleQueue(RIG, 1.0, 1.0)


def reading(second: float, value: float | None = 25.0) -> bytes:
    return encoded({"time": BEGIN + second, **dict.fromkeys(CHANNELS, value)})


def duty(second: float, count: int = 100) -> bytes:
    return encoded({"time": BEGIN + second, **dict.fromkeys(RIG.driven, count)})


def steps(given: SampleQueue) -> list:
    taken = []
    while (step := given.next()) is not None:
        taken.append(step)
    return taken


@given(st.binary(max_size=200) | st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.sampled_from(["time", *CHANNELS, *RIG.driven, "x"]), inner, max_size=6),
    max_leaves=12,
).map(lambda one: json.dumps(one).encode()), st.sampled_from(["readings", "duty"]))  # fmt: skip
def test_no_payload_is_an_error_and_each_is_a_sample_or_is_counted(payload, kind):
    taking = queue()
    taking.put(kind, payload, 1)
    assert len(taking) + taking.counts["malformed"] == 1
    for step in steps(taking):
        assert step.readings is None or len(step.readings) == len(CHANNELS)
        assert np.isfinite(step.duty).all()
        assert (np.abs(step.duty) <= 1).all()


@given(st.lists(st.floats(0.5, 40.0), min_size=1, max_size=12))
def test_the_steps_between_two_readings_last_as_long_as_the_time_between_them(gaps):
    taking, time = queue(), 0.0
    taking.put("readings", reading(0.0), 1)
    for gap in gaps:
        time += gap
        taking.put("readings", reading(time), 1)
    taken = steps(taking)
    assert taken[0].begins
    assert math.fsum(step.dt for step in taken) == pytest.approx(time, abs=1e-5)
    assert max(step.dt for step in taken) <= 1.0 + 1e-6
    elapsed = [step.elapsed for step in taken if step.readings is not None][1:]
    assert elapsed == pytest.approx(gaps, abs=1e-5)


def test_a_duty_holds_from_its_time_on():
    taking = queue()
    taking.put("readings", reading(0.0), 1)
    taking.put("duty", duty(0.25), 2)
    taking.put("readings", reading(1.0), 3)
    first, second, third = steps(taking)
    assert first.readings is not None
    assert (second.dt, second.readings) == (pytest.approx(0.25), None)
    assert not second.duty.any()
    assert third.dt == pytest.approx(0.75)
    assert third.duty.all()
    assert third.elapsed == pytest.approx(1.0)


@pytest.mark.parametrize("value", [1e308, -300.0, None, True, "25", [25.0]])
def test_what_is_no_temperature_is_a_missing_reading(value):
    taking = queue()
    content = {"time": BEGIN, **dict.fromkeys(CHANNELS, 25.0), CHANNELS[0]: value}
    taking.put("readings", encoded(content), 1)
    (step,) = steps(taking)
    assert np.isnan(step.readings).tolist() == [True] + [False] * (len(CHANNELS) - 1)


@pytest.mark.parametrize("time", [None, True, "now", -1.0, 1e300, float("nan")])
def test_a_message_without_a_time_is_malformed(time):
    taking = queue()
    taking.put("readings", encoded({"time": time, **dict.fromkeys(CHANNELS, 25.0)}), 1)
    assert not len(taking)
    assert taking.counts["malformed"] == 1


def test_twice_the_same_or_sooner_than_needed_is_counted_and_passed_over():
    taking = queue()
    for second in (0.0, 0.0, 1.0, 0.5, 1.2):
        taking.put("readings", reading(second), 1)
    assert len(taking) == 2
    assert taking.counts == {"late": 2, "thinned": 1}


def test_a_duty_that_is_repeated_makes_no_step():
    taking = queue()
    taking.put("readings", reading(0.0), 1)
    for second in (0.1, 0.2, 0.3, 0.4):
        taking.put("duty", duty(second), 2)
    taking.put("readings", reading(1.0), 3)
    assert [round(step.dt, 3) for step in steps(taking)] == [0.0, 0.1, 0.9]
    assert taking.counts["thinned"] == 3


def test_a_flood_leaves_the_newest():
    taking = queue()
    for second in range(MAX_WAITING + 200):
        taking.put("readings", reading(float(second), 20.0 + second / 100), second)
    assert len(taking) == MAX_WAITING
    assert taking.counts["overflow"] == 200
    last = steps(taking)[-1]
    assert last.readings[0] == pytest.approx(20.0 + (MAX_WAITING + 199) / 100)


def test_a_duty_that_is_passed_over_holds_nevertheless():
    taking = queue()
    taking.put("duty", duty(0.0), 1)
    for second in range(MAX_WAITING):
        taking.put("readings", reading(float(second)), 1)
    assert next(iter(steps(taking))).duty.all()


@pytest.mark.parametrize("second", [MAX_GAP + 2.0, 86_400.0 * 400, -3600.0])
def test_after_a_long_pause_or_with_another_clock_the_observer_begins_again(second):
    taking = queue()
    taking.put("readings", reading(0.0), 1)
    taking.put("readings", reading(second), 2)
    first, again = steps(taking)
    assert first.begins
    assert again.begins
    assert again.dt == 0.0
    assert taking.counts["gap"] == 1


def test_it_goes_on_from_what_was_kept():
    whole, part = queue(), queue()
    seconds = [0.0, 1.0, 2.5, 9.0, 10.0]
    for number, second in enumerate(seconds):
        whole.put("readings", reading(second), number)
        if number < 3:
            part.put("readings", reading(second), number)
    before = steps(part)
    resumed = queue()
    resumed.resume(json.loads(json.dumps(part.to_dict())))
    for number, second in enumerate(seconds[3:], 3):
        resumed.put("readings", reading(second), number)
    both = before + steps(resumed)
    assert [step[:2] for step in both] == [step[:2] for step in steps(whole)]
