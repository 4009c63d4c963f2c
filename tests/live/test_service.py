"""The loop around a rig: journal first, then each consumer, each record with the state after it."""

import json
from typing import final

import numpy as np
import pytest
from hand_clock import HandClock, virtual_bench

from jaxtwin.live import (
    Command,
    Document,
    Event,
    Follower,
    Reading,
    Record,
    RecordConsumer,
    RigState,
    Sample,
    Service,
    VirtualRig,
    record_as_json,
    state_as_json,
)
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig


@final
class Listening:
    """Notes what it gets."""

    def __init__(self) -> None:
        self.heard: list[tuple[Record, RigState]] = []
        self.turns: list[int] = []

    def on_record(self, record: Record, state: RigState) -> None:
        self.heard.append((record, state))

    def on_time(self, state: RigState, now: int) -> None:
        self.turns.append(now)


def test_consumers_get_each_record_with_what_is_known_after_it(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    first, second = Listening(), Listening()
    assert isinstance(first, RecordConsumer)
    service = Service(virtual_bench(rig, VirtualRig(twin), clock), [first, second])
    returned = [record for _ in range(40) for record in service.turn()]
    assert [record for record, _ in first.heard] == returned
    assert first.heard == second.heard
    assert len(first.turns) == 40
    for record, state in first.heard:
        if isinstance(record, Reading):
            assert state.reading is record
        elif isinstance(record, Sample):
            assert state.sample is record
    assert first.heard[-1][1] is service.state


def test_a_service_runs_until_it_is_told_or_its_source_ends(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    listening = Listening()
    bench = virtual_bench(rig, VirtualRig(twin), clock)
    Service(bench, [listening]).run(until=lambda: len(listening.turns) == 3)
    assert len(listening.turns) == 3
    bench.close()
    Service(bench, [listening]).run(until=lambda: False)
    assert len(listening.turns) == 3


@pytest.mark.slow
def test_a_follower_in_a_service_predicts_what_is_measured(
    rig: Rig, twin: Twin, clock: HandClock
) -> None:
    follower = Follower(twin)
    bench = virtual_bench(rig, VirtualRig(twin, speed=10), clock)
    service = Service(bench, [follower])
    service.run(until=lambda: follower.measured is not None)
    for _ in range(100):
        bench.send_duty((128, 64))
        service.turn()
    assert follower.predicted is not None
    assert follower.measured is not None
    assert follower.measured.max() > 17
    # By the time of the device, the twin is in step within its own step of 0.1 s and the noise.
    assert np.abs(follower.predicted - follower.measured).max() < 0.2


@pytest.mark.parametrize("what", ["reading", "duty", "event", "command", "document"])
def test_every_record_and_the_state_are_json(
    rig: Rig, twin: Twin, clock: HandClock, what: str
) -> None:
    listening = Listening()
    bench = virtual_bench(rig, VirtualRig(twin), clock)
    service = Service(bench, [listening])
    for _ in range(20):
        service.turn()
    bench.send_duty((10, 0))
    bench.note(Document(clock.now(), "start", "u", {"rig": rig.name}))
    bench.note(Event("", clock.now(), "alarm", "hot"))
    service.turn()
    known = json.loads(json.dumps(state_as_json(service.state, rig), allow_nan=False))
    assert set(known["temperatures_degC"]) == {channel.name for channel in rig.channels}
    assert known["duty"].keys() == {"P1", "P2"}
    found = [record_as_json(record, rig) for record, _ in listening.heard]
    json.dumps(found, allow_nan=False)
    assert what in {content["kind"] for content in found}


def test_a_channel_that_has_failed_is_null_in_json(rig: Rig) -> None:
    values = np.full(15, 20.0)
    values[2] = np.nan
    content = record_as_json(Reading("l", "b", 0, 0, 0, values, False, None), rig)
    names = [channel.name for channel in rig.channels]
    assert content[names[2]] is None
    assert content[names[0]] == 20.0


def test_a_command_in_json_says_what_was_commanded(rig: Rig) -> None:
    content = record_as_json(Command("l", 10**9, 3, (5, 6), "me"), rig)
    assert content == {
        "kind": "command",
        "time": 1.0,
        "link": "l",
        "command": "duty",
        "pwm": [5, 6],
    }
