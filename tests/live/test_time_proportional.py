"""A virtual rig whose heater has a relay with a window."""

import numpy as np
import pytest
from hand_clock import START
from heated_box import heated_box

from jaxtwin import Twin
from jaxtwin.live import Duty, Order, VirtualRig, encode
from jaxtwin.live.virtual_rig._virtual_rig import Relays

TABLE = 'time_proportional = { period = "4 s", minimum_on = "1 s", minimum_off = "1 s" }'


@pytest.fixture(scope="module", name="twin")
def make_twin() -> Twin:
    return Twin(heated_box(('power = "12 W"', f'power = "12 W"\n{TABLE}')))


def applied(device: VirtualRig, counts: tuple[int, int], seconds: float) -> np.ndarray:
    """The duty that the plant has every 0.1 s, while a host commands."""
    rows = []
    first = int(10 * device.twin.time)
    for step in range(first + 1, first + 1 + int(10 * seconds)):
        device.receive(encode(Duty(step + 1, counts, "me")))
        device.due(START + step * 100_000_000)
        rows.append(device._applied.copy())
    return np.array(rows)


def test_the_device_switches_the_heater(twin: Twin):
    device = VirtualRig(twin)
    device.due(START)
    rows = applied(device, (51, 102), 40)
    assert set(rows[:, 1]) == {0, 1}
    np.testing.assert_array_equal(rows[:, 0], 51 / 255)
    assert rows[40:, 1].mean() == pytest.approx(0.4, abs=0.01)
    assert device.pwm == (51, 102)  # what is reported is the command
    switches = np.flatnonzero(np.diff(rows[:, 1]))
    assert np.all(np.diff(switches) >= 10)


def test_off_is_off_at_once(twin: Twin):
    device = VirtualRig(twin)
    device.due(START)
    applied(device, (0, 255), 6)
    assert device._applied[1] == 1
    device.receive(encode(Order("stop", 999, "me")))
    assert device._applied[1] == 0
    device.due(START + 7_000_000_000)
    assert device._applied[1] == 0


def test_a_switch_between_two_samples_is_exact(twin: Twin, monkeypatch: pytest.MonkeyPatch):
    """The plant gets the heat of 0.3 x 4 s in each window, whatever the samples' times."""
    device = VirtualRig(twin, controller_rate=0.7)
    driven = []
    device.due(START)
    device.receive(encode(Duty(1, (0, 0), "me")))
    drive = device.twin.drive

    def noted(duty: np.ndarray) -> None:
        driven.append((device.twin.time, duty[1]))
        drive(duty)

    monkeypatch.setattr(device.twin, "drive", noted)
    for step in range(1, 41):
        device.receive(encode(Duty(step + 1, (0, 77), "me")))
        device.due(START + step * 1_000_000_000)
    times = np.array([time for time, _ in driven])
    on = np.array([level for _, level in driven])
    lengths = np.diff(times)[on[:-1] == 1]
    np.testing.assert_allclose(lengths, 4 * 77 / 255, atol=1e-6)


def test_relays_answer_for_any_time(twin: Twin):
    relays = Relays(twin.rig)
    assert relays.next_switch(0.0) == 4.0
    assert relays.applied(np.array([0.5, 0.5]), 0.0, is_off=False).tolist() == [0.5, 1.0]
    assert relays.next_switch(0.0) == 2.0
    assert relays.applied(np.array([0.5, 0.5]), 2.0, is_off=False).tolist() == [0.5, 0.0]
    assert relays.next_switch(2.0) == 4.0
