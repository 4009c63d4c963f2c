"""The relay in the supply: a second path by which a stop takes the heat away."""

from dataclasses import replace
from pathlib import Path

import pytest
from hand_clock import HandClock, stepped_bench, virtual_bench

import jaxtwin as jt
from jaxtwin.data import data_folder
from jaxtwin.errors import SafetyStop
from jaxtwin.io import Experiment, Session
from jaxtwin.live import (
    Data,
    Duty,
    Guard,
    Hello,
    InProcess,
    Order,
    OutputStage,
    Recorder,
    VirtualRig,
    deframe,
    drive,
    encode,
    parse,
)
from jaxtwin.live.conformance._conform import conform
from jaxtwin.live.protocol._identity import Identity
from jaxtwin.live.protocol._output_stage import Answer
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig

OFF = (0, 0)
NAME = "power off"
PLAN = Experiment.schedule("0:0.5", duration=60, cells=2)


@pytest.fixture(scope="module")
def relayed(rig: Rig) -> Rig:
    assert rig.limits is not None
    return replace(rig, limits=replace(rig.limits, relay=NAME))


@pytest.fixture(scope="module")
def relayed_twin(relayed: Rig) -> Twin:
    return Twin(relayed)


def test_the_command_and_the_state_of_a_relay_are_lines_of_the_protocol() -> None:
    messages = (
        Order("relay", 3, "me", NAME),
        Hello(2, "dual-cell", "b", relay=NAME),
        Data(1, 2, (0, 0), relay="off"),
    )
    lines = [encode(message) for message in messages]
    assert lines[0].startswith(b"relay n=3 owner=me name=power%20off*")
    assert [parse(frame) for frame in deframe(b"", b"".join(lines)).frames] == list(messages)


def test_a_device_must_have_the_relay_of_the_rig_file(rig: Rig, relayed: Rig) -> None:
    hello = Hello(2, "dual-cell", "b", relay="another")
    for host in (rig, relayed):
        refusal = Identity.of(host).refusal(hello)
        assert refusal is not None
        assert refusal.startswith("limits.relay: expected")
    assert Identity.of(relayed).refusal(replace(hello, relay=NAME)) is None


def test_every_trip_opens_the_relay_and_a_reset_closes_it() -> None:
    stage = OutputStage(2, 255, 2.0, NAME)
    stage.obey(Duty(1, (9, 9), "me"), 0.0)
    assert stage.obey(Order("relay", 1, "other", "another"), 0.1) == ("refused", "relay")
    assert (stage.pwm, stage.supplied) == ((9, 9), True)
    for trip in (Order("relay", 2, "other", NAME), Order("stop", 2, "other")):
        assert stage.obey(trip, 0.2) == ("trip", trip.kind)
        assert (stage.pwm, stage.supplied) == (OFF, False)
        assert stage.obey(Order("reset", 3, "me"), 0.3) == ("reset", "")
        assert stage.supplied


def test_a_virtual_rig_with_a_relay_conforms(
    relayed: Rig, relayed_twin: Twin, clock: HandClock
) -> None:
    link = InProcess(VirtualRig(relayed_twin), clock)
    read = link.read

    def slow() -> bytes:
        clock.turn(0.02)
        return read()

    link.read = slow  # pyright: ignore[reportAttributeAccessIssue]
    findings = list(conform(relayed, link, clock))
    assert [found for found in findings if found.wrong] == []
    assert "anyone may open the relay" in [found.step for found in findings]


@pytest.mark.slow
def test_a_trip_opens_the_relay_and_a_completed_run_does_not(
    relayed: Rig, relayed_twin: Twin, clock: HandClock, tmp_path: Path
) -> None:
    device = VirtualRig(relayed_twin)
    with Recorder(tmp_path / "session.db", relayed, clock=clock) as recorder:
        bench = virtual_bench(relayed, device, clock, journal=recorder)
        short = Experiment.schedule("0:0.5", duration=2, cells=2)
        assert drive(bench, Guard.of(Twin(relayed)), short) == "completed"
        assert device.stage.supplied

        def fails(time: float, pwm: tuple[int, ...]) -> None:
            if time > 2:
                raise SafetyStop("stopped: a test", "test")

        with pytest.raises(SafetyStop, match="a test; the cells are off, and the device has trip"):
            drive(bench, Guard.of(Twin(relayed)), PLAN, on_progress=fails)
        assert (device.pwm, device.stage.supplied) == (OFF, False)
        with pytest.raises(SafetyStop, match="switched off by itself"):
            drive(bench, Guard.of(Twin(relayed)), short)
        assert drive(bench, Guard.of(Twin(relayed)), short, reset=True) == "completed"
        assert device.stage.supplied
    with Session(tmp_path / "session.db") as session:
        states = session.database.execute("SELECT detail FROM events WHERE kind = 'relay'")
        assert [state for (state,) in states] == ["on", "off", "on"]


@pytest.mark.slow
def test_a_bridge_that_obeys_no_stop_is_cut_off_by_the_relay(
    relayed: Rig, relayed_twin: Twin, clock: HandClock
) -> None:
    """What heats is off, though the counts are still those of the last duty."""
    device = VirtualRig(relayed_twin)
    device.stage = OutputStage(2, 255, 1e9, NAME)
    obey = device.stage.obey

    def stuck(command: Duty | Order, now: float) -> Answer | None:
        if isinstance(command, Duty):
            return obey(command, now) if any(command.pwm) else None
        if command.kind == "relay":
            device.stage.supplied, device.stage.trip_reason = False, "relay"
        return None

    device.stage.obey = stuck  # pyright: ignore[reportAttributeAccessIssue]

    def fails(time: float, pwm: tuple[int, ...]) -> None:
        if time > 2:
            raise SafetyStop("stopped: a test", "test")

    with pytest.raises(SafetyStop, match="off by the relay alone: look for the fault") as no:
        drive(
            virtual_bench(relayed, device, clock), Guard.of(Twin(relayed)), PLAN, on_progress=fails
        )
    assert no.value.kind == "test"
    assert (device.pwm, device.supplied) == ((128, 128), OFF)
    before = float(device.twin.temperatures.max())
    for _ in range(100):
        clock.turn(1.0)
        device.due(clock.now())
    assert float(device.twin.temperatures.max()) < before + 1.0


class RelayOnly:
    """A second small controller, which has the relay and nothing else."""

    def __init__(self, rig: Rig, clock: HandClock):
        self.stage = OutputStage(0, 255, 2.0, NAME)
        self._clock, self._sent, self._seq = clock, 0, 0
        self._waiting = encode(Hello(2, rig.name, "relay-1", relay=NAME))

    def read(self) -> bytes:
        data, self._waiting = self._waiting, b""
        if self._clock.now() - self._sent >= 10**8:
            self._sent, self._seq = self._clock.now(), self._seq + 1
            state = "on" if self.stage.supplied else "off"
            trip = self.stage.trip_reason
            data += encode(Data(self._seq, self._seq * 100_000, trip=trip, relay=state))
        return data

    def write(self, data: bytes) -> None:
        for frame in deframe(b"", data).frames:
            message = parse(frame)
            if isinstance(message, Duty | Order):
                self.stage.obey(message, 0.0)

    def close(self) -> None:
        pass


def test_a_relay_on_a_link_of_its_own_is_opened_with_the_stop(
    relayed: Rig, twin: Twin, clock: HandClock
) -> None:
    device, relay = VirtualRig(twin), RelayOnly(relayed, clock)
    openers = {"rig": lambda: InProcess(device, clock), "relay": lambda: relay}

    def fails(time: float, pwm: tuple[int, ...]) -> None:
        if time > 2:
            raise SafetyStop("stopped: a test", "test")

    with pytest.raises(SafetyStop, match="a test; the cells are off, and the device has tripped"):
        drive(
            stepped_bench(relayed, openers, clock), Guard.of(Twin(relayed)), PLAN, on_progress=fails
        )
    assert (device.stage.trip_reason, relay.stage.supplied) == ("stop", False)


def test_a_relay_that_is_opened_during_a_run_ends_it(
    relayed: Rig, twin: Twin, clock: HandClock
) -> None:
    device, relay = VirtualRig(twin), RelayOnly(relayed, clock)
    openers = {"rig": lambda: InProcess(device, clock), "relay": lambda: relay}

    def opens(time: float, pwm: tuple[int, ...]) -> None:
        if time > 2:
            relay.stage.trip("button")

    with pytest.raises(SafetyStop, match="the relay in the supply has been opened") as no:
        drive(
            stepped_bench(relayed, openers, clock), Guard.of(Twin(relayed)), PLAN, on_progress=opens
        )
    assert no.value.kind == "device-trip"
    assert device.stage.trip_reason == "stop"


@pytest.mark.slow
def test_a_rig_whose_relay_nobody_has_is_not_driven(
    relayed: Rig, twin: Twin, clock: HandClock
) -> None:
    device = VirtualRig(twin)
    with pytest.raises(SafetyStop, match=r"not started: after 30 s: .*no relay 'power off'"):
        drive(virtual_bench(relayed, device, clock), Guard.of(Twin(relayed)), PLAN)
    assert device.pwm == OFF


def test_the_relay_of_a_rig_file_has_a_name(tmp_path: Path) -> None:
    text = (data_folder() / "rigs" / "dual-cell.toml").read_text()
    file = tmp_path / "rig.toml"
    limit = 'temperature = "90 degC"'
    file.write_text(text.replace(limit, f'{limit}\nrelay = "power off"'))
    limits = jt.load_rig(file).limits
    assert limits is not None
    assert limits.relay == NAME
    file.write_text(text.replace(limit, f'{limit}\nrelay = "{"x" * 33}"'))
    with pytest.raises(jt.errors.RigError, match=r"limits\.relay: expected 1 to 32 printable char"):
        jt.load_rig(file)
