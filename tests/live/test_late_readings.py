"""A reading is as old as its device says, however new it has arrived; and a clock that is wrong is
noticed."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from folded import Watched
from hand_clock import START, HandClock, ScriptedTransport, stepped_bench
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.live import Command, Greeting, Hello, LinkState, Reading, Sample, encode
from jaxtwin.live.protocol._rig_state import CLOCK_DRIFT
from jaxtwin.live.safety._presence import Presence
from jaxtwin.rig import Rig

# What the clocks of both devices show at the start, microseconds.
BEGAN = 3 * 10**6


def at(seconds: float) -> int:
    return START + round(seconds * 1e9)


def frame(made: float, arrived: float, link: str = "camera") -> Reading:
    us = BEGAN + round(made * 1e6)
    return Reading(link, "c", at(arrived), us, 0, np.full(2, 20.0), False, None)


def sample(made: float, arrived: float) -> Sample:
    us = BEGAN + round(made * 1e6)
    return Sample("controller", "b", at(arrived), us, 0, (1,), None)


def commanded() -> Watched:
    """The interlock of a rig of two devices, which has been commanded at 0 s."""
    return Watched(
        Presence(3.0),
        Greeting("controller", at(0), Hello(2, "r", "b", cells=("P1",))),
        Greeting("camera", at(0), Hello(2, "r", "c", camera=(2, 1))),
        sample(0, 0.01),
        frame(0, 0.01),
        Command("controller", at(0.02), 1, (1,), "me"),
    )


@pytest.mark.parametrize(
    ("made", "kind"),
    [
        (lambda t: t, None),
        (lambda t: t - 0.5, None),  # a steady delay
        (lambda t: 0.8 * t, "late"),  # a queue that grows, or a clock that is slow
        (lambda t: 0.2 * t, "late"),
        (lambda t: 0.0 * t, "late"),  # a clock that stands still
        (lambda t: t if t < 5 else t - 20, "late"),
        (lambda t: (1 - CLOCK_DRIFT / 2) * t, None),
        (lambda t: 2.0 * t, "clock"),
        (lambda t: t if t < 5 else t + 50, "clock"),
    ],
)
def test_frames_that_are_late_and_clocks_that_are_wrong_trip(
    made: Callable[[float], float], kind: str | None
) -> None:
    lock, tripped, time = commanded(), None, 0.0
    for tenth in range(1, 400):
        time = tenth / 10
        records = [sample(time, time + 0.01), frame(made(time), time + 0.01)]
        findings = [*map(lock.on_record, records), lock.on_time(at(time + 0.02))]
        tripped = next(filter(None, findings), None)
        if tripped is not None:
            break
    assert (tripped and tripped.kind) == kind
    if tripped is not None:
        assert tripped.channel == "camera"
        assert time < 20


def test_a_reconnection_does_not_make_late_frames_new() -> None:
    """The clock of a device goes on while its link is lost."""
    lock = commanded()
    lock.on_record(Greeting("camera", at(2), Hello(2, "r", "c", camera=(2, 1))))
    lock.on_record(sample(6.0, 6.01))
    lock.on_record(frame(1.0, 6.01))
    trip = lock.on_time(at(6.02))
    assert trip is not None
    assert trip.kind == "late"
    assert "5.0 s old" in trip.detail


@given(
    st.floats(-CLOCK_DRIFT, CLOCK_DRIFT), st.lists(st.floats(0.0, 1.0), min_size=20, max_size=60)
)
def test_a_healthy_device_with_a_cheap_clock_is_neither_late_nor_wrong(
    drift: float, delays: list[float]
) -> None:
    lock, arrived = commanded(), 0.0
    for number, delay in enumerate(delays):
        time = 10.0 * (number + 1)
        arrived = max(arrived, time + delay)
        # Between two slow messages there are many quick ones.
        for made in (time - 9.0, time - 1.0):
            for record in (sample(made, made), frame(made * (1 + 0.9 * drift), made)):
                assert lock.on_record(record) is None
        assert lock.on_record(frame(time * (1 + 0.9 * drift), arrived)) is None


HELLO = Hello(2, "dual-cell", "b1", cells=("P1", "P2"), watchdog=2.0)
CAMERA = Hello(2, "dual-cell", "c1", camera=(80, 60))


@pytest.mark.parametrize(
    ("first", "second", "word"),
    [
        (HELLO, replace(HELLO, boot="b2"), "cells"),
        (HELLO, HELLO, "cells"),  # one device on two links
        (CAMERA, replace(CAMERA, boot="c2"), "temperatures"),
        (replace(HELLO, camera=(80, 60)), CAMERA, "temperatures"),
        (HELLO, CAMERA, None),
    ],
)
def test_a_second_device_for_the_same_part_of_the_rig_is_refused(
    rig: Rig, clock: HandClock, first: Hello, second: Hello, word: str | None
) -> None:
    transports = {
        name: ScriptedTransport(encode(hello), *(encode(hello),) * 40)
        for name, hello in (("a", first), ("b", second))
    }
    bench = stepped_bench(rig, {name: lambda n=name: transports[n] for name in transports}, clock)
    for _ in range(4):
        bench.poll()
    assert bench.states["a"] is LinkState.LIVE
    if word is None:
        assert bench.states["b"] is LinkState.LIVE
        assert bench.refusals == {}
    else:
        assert bench.refusals["b"].startswith(f"{word}: expected one device, got a second one")
        bench.send_duty((10, 10))
        assert not any(b"duty" in data for data in transports["b"].written)
