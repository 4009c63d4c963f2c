"""A monitor beside a rig raises what it finds in a recording of the same rig."""

from collections.abc import Iterator
from dataclasses import replace

import jax
import numpy as np
import pytest
from faulty_runs import ONSET, bench, recording
from hand_clock import START

from jaxtwin import Experiment, Twin, monitor
from jaxtwin.live import Finding, Reading, Record, RecordConsumer, RigState, Sample, Screen
from jaxtwin.monitoring import LiveMonitor
from jaxtwin.monitoring._finding_log import FindingLog, at_sample
from jaxtwin.monitoring._thresholds import DAY
from jaxtwin.observers import live_observer
from jaxtwin.rig import rig_from_tables

SECOND = 10**9


def records(run: Experiment, closed: slice | None = None) -> Iterator[Record]:
    """The records of a device, a sample and a reading in each second; the shutter of its camera is
    closed in a part of the run."""
    readings = np.asarray(run.temperatures)
    shut = np.zeros(len(run.time), bool)
    if closed is not None:
        shut[closed] = True
    for n, (duty, row) in enumerate(zip(run.duty, readings, strict=True)):
        at, since = START + n * SECOND, n * 10**6
        yield Reading("rig", "b", at, since, n, row, bool(shut[n]), None)
        counts = tuple(round(1000 * float(part)) for part in duty)
        yield Sample("rig", "b", at, since, n, counts, None)


def live(
    run: Experiment, closed: slice | None = None, twin: Twin | None = None
) -> tuple[LiveMonitor, list[Finding]]:
    raised: list[Finding] = []
    watching = LiveMonitor(live_observer(bench() if twin is None else twin), raised.append)
    state = RigState()
    for record in records(run, closed):
        state = state.after(record)
        watching.on_record(record, state)
        watching.on_time(state, record.arrival)
    return watching, raised


@pytest.mark.slow
def test_one_impossible_reading_is_one_notice_beside_a_rig():
    run = recording()
    readings = np.array(run.temperatures)
    readings[300, 1] = -127.0
    _, raised = live(replace(run, temperatures=readings))
    (finding,) = raised
    assert (finding.kind, finding.channel, finding.severity) == ("impossible", "T2", "notice")
    assert finding.since == START + 300 * SECOND


@pytest.mark.slow
def test_a_fault_is_raised_once_with_the_host_time_of_its_onset():
    watching, raised = live(recording("gain", "T1", 0.85))
    assert raised
    sudden = next(one for one in raised if (one.kind, one.channel) == ("sudden", "T1"))
    assert isinstance(sudden.since, int)
    assert sudden.since == pytest.approx(START + ONSET * SECOND, abs=30 * SECOND)
    assert sudden.found is not None
    assert START + ONSET * SECOND < sudden.found < START + (ONSET + 60) * SECOND
    keys = [(one.kind, one.channel, one.since) for one in raised]
    assert len(set(keys)) == len(keys)
    assert len(watching.findings) == len(raised)


@pytest.mark.slow
def test_live_and_from_a_recording_the_same_is_found():
    run = recording("fail", "H1", 1.0)
    _, raised = live(run)
    found = monitor(bench(), run)
    assert {(one.kind, one.channel) for one in raised} == {
        (one.kind, one.channel) for one in found.findings
    }
    first = min(one.found for one in raised if one.found is not None)
    offline = min(one.found for one in found.findings if one.found is not None)
    assert (first - START) / SECOND == pytest.approx(offline, abs=2.0)


@pytest.mark.slow
def test_a_healthy_rig_and_closed_shutters_raise_nothing():
    run = recording()
    readings = np.asarray(run.temperatures).copy()
    readings[300:304] = 60.0  # what a camera shows of its own shutter
    shut = Experiment(run.time, run.duty, channels=run.channels, temperatures=readings)
    watching, raised = live(shut, slice(300, 304))
    assert raised == []
    assert watching.present == watching.findings == ()


@pytest.mark.slow
def test_it_is_a_consumer_and_shares_its_follower_with_a_screen():
    observer = live_observer(bench())
    watching = LiveMonitor(observer, lambda _: None)
    assert isinstance(watching, RecordConsumer)
    screen, state = Screen(bench(), observer, watching.follower), RigState()
    for record in list(records(recording()))[:20]:
        state = state.after(record)
        watching.on_record(record, state)
        screen.on_record(record, state)
    assert watching.follower.predicted is not None
    alone = LiveMonitor(observer, lambda _: None)
    state = RigState()
    for record in list(records(recording()))[:20]:
        state = state.after(record)
        alone.on_record(record, state)
    assert alone.follower.predicted is not None
    np.testing.assert_array_equal(watching.follower.predicted, alone.follower.predicted)


def test_a_finding_clears_after_half_a_minute_of_the_rig_at_any_speed():
    """The same scores at ten times the speed: the times of the host are a tenth."""
    found = monitor(bench(), recording())
    quiet = jax.tree.map(np.zeros_like, at_sample(found.evidences, -1))
    first_two = np.arange(len(quiet.score)) < 2  # the sums of the channels stand first
    loud = quiet._replace(score=2.0 * first_two, age=5.0 * first_two)
    for rate in (1.0, 10.0):
        log = FindingLog(found.monitor, found.calibration, DAY, SECOND)
        first, *_ = log.take(100 * SECOND, loud, rate)
        assert first.since == 100 * SECOND - 5 * SECOND / rate
        log.take(100 * SECOND + round(29 * SECOND / rate), quiet, rate)
        assert log.present
        log.take(100 * SECOND + round(31 * SECOND / rate), quiet, rate)
        assert not log.present


def test_of_findings_that_are_over_only_the_last_are_kept():
    found = monitor(bench(), recording())
    quiet = jax.tree.map(np.zeros_like, at_sample(found.evidences, -1))
    loud = quiet._replace(score=2.0 * (np.arange(len(quiet.score)) == 0))
    log = FindingLog(found.monitor, found.calibration, DAY, kept=3)
    for number in range(5):
        log.take(100.0 * number, loud)
        log.take(100.0 * number + 50, quiet)
    assert [one.found for one in log.findings] == [200.0, 300.0, 400.0]


@pytest.mark.slow
def test_one_cause_in_all_channels_is_told_twice_and_shown_once():
    names = [f"T{number}" for number in range(1, 6)]
    tables = {
        "format": 1,
        "name": "bar",
        "ambient": {"temperature": "20 degC"},
        "sensors": {"noise": "0.1 K"},
        "channels": [{"name": name, "nodes": [f"B{name}"]} for name in names],
        "heaters": [{"name": "H", "power": "20 W", "contacts": ["BT1"]}],
        "bodies": [{"name": f"B{name}", "capacitance": "40 J/K"} for name in names],
        "links": [
            {"resistance": "5 K/W", "between": [f"B{name}-ambient" for name in names]},
            {"resistance": "1 K/W", "between": [f"BT{n}-BT{n + 1}" for n in range(1, 5)]},
        ],
    }
    twin = Twin(rig_from_tables(tables, "bar"))
    plan = Experiment.schedule("0:0.5,100:0.2,200:0.6", duration=400)
    healthy = twin.simulate(plan).to_recording(seed=1)
    readings = np.array(healthy.temperatures)
    readings[250:] += 3.0  # such as a reference that all sensors share
    watching, raised = live(replace(healthy, temperatures=readings), twin=twin)
    told = [finding for finding in raised if finding.kind == "sudden" and finding.channel in names]
    assert 1 <= len(told) <= 2
    shown = [each for each in watching.findings if each.kind == "sudden" and each.channel in names]
    assert len(shown) == 1
    assert "and 4 others" in shown[0].detail
