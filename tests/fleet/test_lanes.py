"""Rigs side by side are followed as each of them is alone."""

from dataclasses import replace

import numpy as np
import pytest
from small_fleet import encoded, messages, run, twin

from jaxtwin.fleet._lanes import LANES, Lanes
from jaxtwin.fleet._sample_queue import SampleQueue
from jaxtwin.live import Finding, Reading, RigState, Sample
from jaxtwin.monitoring import (
    DAY,
    Evidence,
    LiveFindings,
    LiveMonitor,
    Monitor,
    channels_of,
    nominal_calibration,
    response_of,
)
from jaxtwin.observers import live_observer
from jaxtwin.physics import Twin

TIME = 30 * DAY
CALIBRATION = nominal_calibration(twin().channels, 1.0)


def watcher(of: Twin):
    observer = live_observer(of)
    return observer, Monitor(observer, CALIBRATION, response_of(observer), TIME)


def together(cases) -> list[list[Finding]]:
    """What is found in rigs side by side; each has a twin and messages."""
    watchers = [watcher(of) for of, _ in cases]
    lanes = Lanes(watchers[0])
    queues, told = [], []
    logs = []
    for lane, ((_, given), one) in enumerate(zip(cases, watchers, strict=True)):
        lanes.put(3 * lane, one)
        queues.append(SampleQueue(twin().rig, 1.0, one[0].longest_seconds))
        told.append([])
        logs.append(LiveFindings(one[1], CALIBRATION, TIME, told[-1].append))
        for number, (kind, content) in enumerate(given):
            queues[-1].put(kind, encoded(content), number)
    while any(map(len, queues)):
        steps, taken, first = lanes.none(), {}, np.full(LANES, np.nan)
        for place, queue in enumerate(queues):
            if (step := queue.next()) is None:
                continue
            lane = 3 * place
            steps.moves[lane], steps.dt[lane], steps.elapsed[lane] = True, step.dt, step.elapsed
            steps.duty[lane], steps.ambient[lane] = step.duty, step.ambient
            if step.readings is not None:
                steps.readings[lane], steps.reads[lane] = step.readings, True
                taken[place] = queue.time
            if step.begins and step.readings is not None:
                first[lane] = np.nanmean(step.readings)
        if np.isfinite(first).any():
            lanes.begin(first, steps.duty, np.isfinite(first))
        result = lanes.step(steps)
        for place, time in taken.items():
            logs[place].take(time, Evidence(*(part[3 * place] for part in result.evidence)))
    return told


def alone(of: Twin, given) -> list[Finding]:
    """What a monitor of its own finds."""
    told: list[Finding] = []
    watching = LiveMonitor(live_observer(of), told.append)
    state = RigState()
    for number, (kind, content) in enumerate(given):
        at = round(content["time"] * 1e9)
        if kind == "duty":
            counts = tuple(content[name] for name in twin().rig.driven)
            record = Sample("l", "b", at, at // 1000, number, counts, content["ambient_degC"])
        else:
            values = [content[name] for name in channels_of(live_observer(of).model)]
            readings = np.array([np.nan if one is None else one for one in values])
            record = Reading("l", "b", at, at // 1000, number, readings, False, None)
        state = state.after(record)
        watching.on_record(record, state)
    return told


def cases():
    """A healthy rig, and one of other values with an offset, missing readings, and a pause."""
    healthy, counts = run(1)
    faulty = np.array(run(2)[0])
    faulty[250:, 0] += 3.0
    faulty[100:103, 1] = np.nan
    other = twin().with_values({"R_1": 66.0})
    frozen = np.array(run(3)[0])
    frozen[200:, 1] = frozen[200, 1]
    return [
        (twin(), list(messages(healthy, counts))),
        (twin(), list(messages(faulty, counts, leave_out=range(150, 171)))),
        (other, list(messages(frozen, counts))),
    ]


@pytest.mark.slow
def test_rigs_side_by_side_have_the_findings_that_each_has_alone():
    given = cases()
    several = together(given)
    assert several[1]
    for found, (of, messages_of_rig) in zip(several, given, strict=True):
        expected = alone(of, messages_of_rig)
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            same = replace(one, size=None, probability=None, detail="")
            assert same == replace(other, size=None, probability=None, detail="")
            assert one.size == pytest.approx(other.size, rel=1e-6)


def test_a_lane_without_a_sample_and_the_neighbours_of_a_liar_stay_as_they_were():
    lanes, one = Lanes(watcher(twin())), watcher(twin())
    lanes.put(0, one)
    steps = lanes.none()
    first = np.full(LANES, 25.0)
    lanes.begin(first, steps.duty, np.isfinite(first))
    before = [lanes.packed(lane) for lane in range(3)]
    steps.moves[:2] = steps.reads[:2] = True
    steps.dt[:2] = steps.elapsed[:2] = 1.0
    steps.readings[:2] = 25.1
    lanes.step(steps)
    honest = lanes.packed(1)
    assert lanes.packed(2) == before[2]
    for lane, state in enumerate(before):
        assert lanes.unpack(lane, state)
    steps.readings[0] = 1e300
    steps.dt[0] = np.nan
    result = lanes.step(steps)
    assert not result.is_finite[0]
    assert result.is_finite[1:].all()
    assert lanes.packed(1) == honest


def test_the_state_of_another_structure_is_refused():
    lanes = Lanes(watcher(twin()))
    state = lanes.packed(5)
    assert lanes.unpack(7, state)
    assert lanes.packed(7) == state
    assert not lanes.unpack(7, state[:-1])
    assert not lanes.unpack(7, state + b"0")
    assert lanes.packed(7) == state
