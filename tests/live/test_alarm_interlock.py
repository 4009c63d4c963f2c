"""An alarm of a monitor switches the cells off where the rig file says so, and nowhere else."""

from dataclasses import replace
from pathlib import Path

import pytest
from faulty_runs import bench
from findings import ALARM, NOTICE
from hand_clock import HandClock, virtual_bench

from jaxtwin import Experiment, JaxtwinError, load_rig
from jaxtwin.data import data_folder
from jaxtwin.errors import SafetyStop
from jaxtwin.live import (
    AlarmInterlock,
    Finding,
    Guard,
    RigState,
    VirtualRig,
    drive,
    interlocks_of,
)
from jaxtwin.monitoring import LiveMonitor
from jaxtwin.observers import live_observer
from jaxtwin.physics import Faults


def test_it_trips_on_the_first_alarm_and_on_no_notice():
    interlock, state = AlarmInterlock(), RigState()
    interlock.ring(NOTICE)
    assert interlock.on_time(state, 0) is None
    interlock.ring(ALARM)
    interlock.ring(replace(ALARM, kind="drift"))
    found = interlock.on_time(state, 0)
    assert found is not None
    assert (found.kind, found.channel) == ("alarm", "T1")
    assert found.detail == "alarm, sudden: T1 is 3 K above what is expected"
    assert interlock.settings == {"stop_on_alarm": True}


@pytest.mark.slow
def test_a_sensor_that_comes_loose_stops_a_run_if_it_is_wanted(clock: HandClock):
    """Its readings are 5 % nearer to the room from 150 s on, which no other interlock minds."""
    plan = Experiment.schedule("0:0.5/0.4", duration=200, cells=2)
    ends = {}
    for is_stopped in (False, True):
        faults = Faults.parse("gain=T1@150/0.95")
        device = VirtualRig(bench(), speed=10, controller_rate=1.0, faults=faults)
        raised: list[Finding] = []
        interlock = AlarmInterlock()

        def found(finding: Finding, to: AlarmInterlock = interlock, kept=raised) -> None:
            kept.append(finding)
            to.ring(finding)

        monitor = LiveMonitor(live_observer(bench()), found)
        guard = Guard([*interlocks_of(bench()), *([interlock] if is_stopped else [])])
        connection, begin = virtual_bench(bench().rig, device, clock), clock.now()
        try:
            ends[is_stopped] = drive(connection, guard, plan, consumers=[monitor])
        except SafetyStop as stop:
            ends[is_stopped] = stop.kind
        assert raised
        assert raised[0].kind == "sudden"
        assert raised[0].since is not None
        since = 10 * (raised[0].since - begin) / 1e9  # s of the rig
        assert since == pytest.approx(150, abs=15)
        assert not any(device.pwm)
        assert device.stage.trip_reason == ("stop" if is_stopped else "")
    assert ends == {False: "completed", True: "alarm"}


@pytest.mark.slow
def test_no_other_interlock_waits_for_it(clock: HandClock):
    """A rig that is too hot is stopped, whatever a monitor says."""
    rig = bench().rig
    assert rig.limits is not None
    cautious = replace(rig, limits=replace(rig.limits, temperature=273.15 + 30))
    twin = type(bench())(cautious)
    guard = Guard([*interlocks_of(twin), AlarmInterlock()])
    connection = virtual_bench(rig, VirtualRig(bench(), speed=10), clock)
    plan = Experiment.schedule("0:0.5/0.4", duration=400, cells=2)
    with pytest.raises(SafetyStop, match="the rig's limit is 30"):
        drive(connection, guard, plan, accept=True)


def test_a_rig_file_says_whether_an_alarm_stops_it(tmp_path: Path):
    text = (data_folder() / "rigs" / "tclab.toml").read_text()
    file = tmp_path / "rig.toml"
    file.write_text(text.replace("limits = {", "limits = { stop_on_alarm = true,"))
    limits = load_rig(file).limits
    assert limits is not None
    assert limits.stop_on_alarm
    usual = bench().rig.limits
    assert usual is not None
    assert not usual.stop_on_alarm
    file.write_text(text.replace("limits = {", 'limits = { stop_on_alarm = "yes",'))
    with pytest.raises(JaxtwinError, match=r"limits\.stop_on_alarm"):
        load_rig(file)
