"""The proof test: all is proven on a rig that obeys, and each cheat is found."""

import contextlib
import threading
from dataclasses import replace
from typing import Any

import pytest
from hand_clock import HandClock, virtual_bench

from jaxtwin.cli import run
from jaxtwin.live import Data, Duty, Finding, Order, Proof, VirtualRig, prove
from jaxtwin.live import _prove as module
from jaxtwin.live._prove import provocations
from jaxtwin.live.protocol._output_stage import Answer, OutputStage
from jaxtwin.physics import Twin
from jaxtwin.rig import Rig


@pytest.fixture(scope="module")
def relayed(rig: Rig) -> Rig:
    assert rig.limits is not None
    return replace(rig, limits=replace(rig.limits, relay="power off"))


def proven(rig: Rig, device: VirtualRig, clock: HandClock) -> list[Proof]:
    return list(prove(virtual_bench(rig, device, clock), Twin(rig)))


@pytest.mark.slow
@pytest.mark.parametrize("speed", [1.0, pytest.param(5.0, marks=pytest.mark.long)])
def test_every_step_is_proven_on_a_rig_that_obeys(
    relayed: Rig, clock: HandClock, speed: float
) -> None:
    device = VirtualRig(Twin(relayed), speed=speed)
    steps = proven(relayed, device, clock)
    assert [step for step in steps if step.wrong] == []
    assert {
        "over-temperature", "implausible", "channel-fault", "rate", "deviation", "frozen",
        "cell-temperature", "silence", "disobedience", "unacknowledged", "commander", "restart",
        "refused", "link-down", "device-trip",
    } <= {step.kind for step in steps}  # fmt: skip
    assert all(0 <= step.off_after < 60 for step in steps)
    assert (device.pwm, device.stage.supplied) == ((0, 0), False)


FEW = ("a reading above the limit", "somebody opens the relay")


@pytest.mark.slow
def test_the_warmth_of_earlier_steps_is_no_strange_room(
    rig: Rig, clock: HandClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody measures the room, and each step heats the rig: its readings are more than 10 K from
    the room of the rig file in the end."""
    monkeypatch.setattr(
        "jaxtwin.live.virtual_rig._virtual_rig.Data",
        lambda seq, us, pwm, ambient, *rest, **more: Data(seq, us, pwm, None, *rest, **more),
    )
    device = VirtualRig(Twin(rig))
    steps = list(prove(virtual_bench(rig, device, clock), Twin(rig), duty=0.9))
    assert device.twin.temperatures.mean() > 16 + 10
    assert [step for step in steps if step.kind == "ambient-unknown"] == []
    assert [step for step in steps if step.wrong] == []


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two provocations, and the watchdog."""
    monkeypatch.setattr(
        module,
        "provocations",
        lambda *given: [step for step in provocations(*given) if step.name in FEW],
    )


@pytest.mark.slow
@pytest.mark.usefixtures("few")
def test_what_is_proven_is_read_back(relayed: Rig, clock: HandClock) -> None:
    over, relay, watchdog = proven(relayed, VirtualRig(Twin(relayed)), clock)
    assert over[:2] == ("a reading above the limit", "over-temperature")
    assert relay[:2] == ("somebody opens the relay", "device-trip")
    assert watchdog[:2] == ("a host that falls silent", "device-trip")
    assert [step.wrong for step in (over, relay, watchdog)] == ["", "", ""]
    assert over.off_after < 0.5
    assert 1.5 < watchdog.off_after < 2.5


def revives(stage: OutputStage) -> None:
    """A duty ends a trip."""
    obey = stage.obey

    def obeys(command: Duty | Order, now: float) -> Answer | None:
        if isinstance(command, Duty) and any(command.pwm):
            stage.trip_reason, stage.supplied = "", True
        return obey(command, now)

    stage.obey = obeys  # pyright: ignore[reportAttributeAccessIssue]


def is_silent_about_trips(stage: OutputStage) -> None:
    trip = stage.trip

    def trips(reason: str) -> Answer | None:
        answer = trip(reason)
        stage.trip_reason = ""
        return answer

    stage.trip = trips  # pyright: ignore[reportAttributeAccessIssue]


def keeps_the_relay_closed(stage: OutputStage) -> None:
    trip = stage.trip

    def trips(reason: str) -> Answer | None:
        answer = trip(reason)
        stage.supplied = True
        return answer

    stage.trip = trips  # pyright: ignore[reportAttributeAccessIssue]


def has_no_watchdog(stage: OutputStage) -> None:
    stage.on_time = lambda now: None  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.slow
@pytest.mark.usefixtures("few")
@pytest.mark.parametrize(
    ("cheat", "step", "wrong"),
    [
        (revives, 0, "heats after the stop, without a reset"),
        (is_silent_about_trips, 0, "reports trip=nothing"),
        (keeps_the_relay_closed, 0, "the relay is not reported as open, but as on"),
        (has_no_watchdog, 2, "nothing has tripped"),
    ],
)
def test_a_device_that_cheats_is_found(
    relayed: Rig, clock: HandClock, cheat: Any, step: int, wrong: str
) -> None:
    device = VirtualRig(Twin(relayed))
    cheat(device.stage)
    steps = proven(relayed, device, clock)
    assert wrong in steps[step].wrong
    assert not any(device.pwm)


@pytest.mark.usefixtures("few")
def test_a_device_that_does_not_switch_off_ends_the_proof(rig: Rig, clock: HandClock) -> None:
    """Not before a user ends it: it is told to stop until then."""
    device, alarms, stop = VirtualRig(Twin(rig)), [], threading.Event()
    has_no_watchdog(device.stage)
    obey = device.stage.obey

    def obeys(command: Duty | Order, now: float) -> Answer | None:
        return obey(command, now) if isinstance(command, Duty) and any(command.pwm) else None

    device.stage.obey = obeys  # pyright: ignore[reportAttributeAccessIssue]

    def alarm(trip: Finding) -> None:
        alarms.append(trip.kind)
        stop.set()

    steps = list(prove(virtual_bench(rig, device, clock), Twin(rig), stop=stop, on_alarm=alarm))
    assert [step.kind for step in steps] == ["still-on"]
    assert "CUT THE POWER" in steps[0].wrong
    assert alarms == ["still-on"]


@pytest.mark.slow
@pytest.mark.usefixtures("few")
@pytest.mark.parametrize(("cheats", "code"), [(False, 0), (True, 1)])
def test_the_command_prints_a_row_for_each_step_and_exits_with_0_if_all_were_proven(
    rig: Rig,
    clock: HandClock,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    cheats: bool,
    code: int,
) -> None:
    device = VirtualRig(Twin(rig))
    if cheats:
        revives(device.stage)
    bench = virtual_bench(rig, device, clock)
    monkeypatch.setattr("jaxtwin.live.connect", lambda *_, **__: contextlib.nullcontext(bench))
    assert run(["prove", "dual-cell", "--link", "loop://"]) == code
    rows = capsys.readouterr().out.splitlines()
    assert sum(row.startswith("the cells are off") for row in rows) == 1
    assert sum("a reading above the limit" in row for row in rows) == 1
    assert sum(row.startswith("ok ") for row in rows) == (0 if cheats else 2)
    assert sum(row.startswith("WRONG") for row in rows) == (2 if cheats else 0)
