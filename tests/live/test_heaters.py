"""A rig of heaters on a wire: what heats only never gets negative counts."""

from dataclasses import replace

import pytest
from hand_clock import HandClock, virtual_bench
from heated_box import heated_box

from jaxtwin import JaxtwinError, Twin
from jaxtwin.errors import SafetyStop
from jaxtwin.io import Experiment
from jaxtwin.live import Duty, Guard, Hello, InProcess, Screen, VirtualRig, conform, drive, operate
from jaxtwin.live.protocol._codec import encode, parse
from jaxtwin.live.protocol._identity import Identity
from jaxtwin.live.safety._operating_limits import OperatingLimits
from jaxtwin.rig import Rig


@pytest.fixture(scope="module", name="box")
def make_box() -> Rig:
    return heated_box()


@pytest.fixture(scope="module", name="box_twin")
def make_box_twin(box: Rig) -> Twin:
    return Twin(box)


def test_a_greeting_names_the_cells_that_only_heat_and_no_camera(box: Rig, box_twin: Twin):
    hello = VirtualRig(box_twin).hello
    assert hello.cells == hello.heaters == ("heater", "bulb")
    line = encode(hello).rsplit(b"*", 1)[0].decode()
    assert " heaters=heater,bulb" in line
    assert parse(line) == hello
    identity = Identity.of(box)
    assert identity.refusal(hello) is None
    cools = identity.refusal(replace(hello, heaters=()))
    assert cools is not None
    assert cools.startswith("heaters: expected ('heater', 'bulb') as in the rig file, got ()")
    sees = identity.refusal(replace(hello, camera=(80, 60)))
    assert sees == "camera: expected None as in the rig file, got (80, 60)"


def test_a_device_refuses_negative_counts_of_a_heater(box_twin: Twin):
    stage = VirtualRig(box_twin).stage
    assert stage.obey(Duty(1, (10, 20), "me"), 0.0) is None
    assert stage.obey(Duty(2, (10, -1), "me"), 0.0) == ("refused", "range")
    assert stage.pwm == (10, 20)


def test_the_virtual_rig_conforms_and_a_device_that_cools_does_not(
    box: Rig, box_twin: Twin, clock: HandClock
):
    def wrong(device: VirtualRig) -> set[str]:
        findings = conform(box, _Passing(InProcess(device, clock), clock), clock)
        return {finding.step for finding in findings if finding.wrong}

    assert wrong(VirtualRig(box_twin)) == set()
    device = VirtualRig(box_twin)
    device.stage._lowest = (-255, -255)
    assert "refuses what it cannot apply" in wrong(device)


class _Passing:
    """A transport on which time passes: 20 ms with each read."""

    def __init__(self, inner: InProcess, clock: HandClock):
        self._inner, self._clock = inner, clock
        self.write, self.close = inner.write, inner.close

    def read(self) -> bytes:
        self._clock.turn(0.02)
        return self._inner.read()


def test_a_sample_with_negative_counts_of_a_heater_is_refused():
    hello = Hello(2, "box", "b", cells=("P1", "H"), heaters=("H",))
    assert [hello.lowest(cell) for cell in (0, 1)] == [-255, 0]


@pytest.mark.slow
def test_a_schedule_is_driven_and_heats_as_the_twin(box: Rig, box_twin: Twin, clock: HandClock):
    device = VirtualRig(box_twin, speed=10)
    bench = virtual_bench(box, device, clock)
    plan = Experiment.schedule("0:0.5/1", duration=60, cells=2)
    assert drive(bench, Guard.of(box_twin), plan) == "completed"
    assert device.pwm == (0, 0)
    expected = box_twin.simulate("0:0.5/1", duration=60.0).states[-1, 0]
    assert device.twin.nodes[0] == pytest.approx(expected, abs=1.5)


@pytest.mark.slow
def test_a_heater_that_is_too_hot_inside_is_switched_off(clock: HandClock):
    """If the file states a limit; the heater is 24 K above the air at full power."""
    box = heated_box(
        ('temperature = "90 degC" }', 'temperature = "90 degC", cell_temperature = "40 degC" }')
    )
    twin = Twin(box)
    bench = virtual_bench(box, VirtualRig(twin, speed=10), clock)
    plan = Experiment.schedule("0:1/0", duration=200, cells=2)
    with pytest.raises(SafetyStop, match=r"cell heater is at .* inside"):
        drive(bench, Guard.of(twin), plan)


def test_no_negative_duty_is_sent(box: Rig, box_twin: Twin, clock: HandClock):
    bench = virtual_bench(box, VirtualRig(box_twin), clock)
    with pytest.raises(
        JaxtwinError, match=r"duty: expected 2 numbers from 0 to 1, got \[0.1, -0.1\]"
    ):
        operate(bench, Guard.of(box_twin), lambda moment: [0.1, -0.1])
    plan = Experiment.schedule("0:0.5/-0.5", duration=60, cells=2)
    with pytest.raises(JaxtwinError, match="duty_bulb: expected 0 to 1, because the heater 'bulb'"):
        drive(bench, Guard.of(box_twin), plan)


def test_limits_of_a_box(box_twin: Twin):
    """It never gets colder than a cold room, and there is no solder in it."""
    limits = OperatingLimits.of(box_twin)
    assert limits.lowest == pytest.approx(-10.0)
    assert 0 < limits.rate < 20
    assert limits.cell == float("inf")


def test_the_screen_shows_a_table_where_there_is_no_plate(box_twin: Twin):
    from rich.console import Console

    console = Console(width=80, record=True, file=None, force_terminal=False)
    with console.capture() as captured:
        console.print(Screen(box_twin).render())
    assert "heated box" in captured.get()
