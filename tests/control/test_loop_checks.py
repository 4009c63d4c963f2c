"""Which references the duty can hold at rest."""

from contextlib import nullcontext
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import Twin, simulate_closed_loop
from jaxtwin.control import PID, DecoupledPI, FunctionController, HeatInput
from jaxtwin.control.loops._control import checked_loop
from jaxtwin.control.loops._loop_checks import check_reach
from jaxtwin.errors import ControlError


@pytest.mark.slow
def test_a_heater_holds_the_temperature_of_the_room_and_nothing_below():
    twin = Twin("printer-bed")
    system = twin.system()
    weights = np.eye(len(twin.channels))[:1]
    room = np.full((1, 1), float(system.ambient_temperature) - 273.15)
    check_reach(system, weights, room, np.zeros(1), room, (0.0, 1.0))
    with pytest.raises(ControlError, match="which a duty of 0 to 1 can hold, got"):
        check_reach(system, weights, room - 1.0, np.zeros(1), room, (0.0, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("aim", "limits", "is_held"),
    [
        ((60.0, 29.0), (-1.0, 1.0), True),  # by a duty of 0.94 and -0.48
        ((60.0, 29.0), (0.0, 1.0), False),  # which a heater does not have
        ((60.0, 20.0), (-1.0, 1.0), False),
        ((45.0, 45.0), (0.0, 0.5), True),  # 0.43 and 0.44
        ((45.0, 45.0), (0.0, 0.4), False),
    ],
)
def test_outputs_are_held_at_the_same_time(
    twin: Twin, aim: tuple[float, float], limits: tuple[float, float], is_held: bool
):
    """Each of 60 and 20 degC alone can be held. The duty is what `linearize` finds."""
    with jax.enable_x64(True):
        system = twin.system()
        weights = np.array([[name == own for name in twin.channels] for own in ("T12", "T15")])
        room = np.full((1, 1), float(system.ambient_temperature) - 273.15)
        expected = nullcontext() if is_held else pytest.raises(ControlError, match="can hold")
        with expected:
            check_reach(system, weights.astype(float), np.array([aim]), np.zeros(1), room, limits)


@pytest.mark.slow
def test_several_outputs_out_of_reach_are_refused_with_the_nearest(twin: Twin):
    controller = DecoupledPI(0.1, 0.001, 0.1, 0.001, measured=["T12", "T15"], limits=(0, 1))
    words = r"at the same time, got 60/20 degC at 60 s; the nearest are 5\d\.\d+/2\d\.\d+ degC"
    with pytest.raises(ControlError, match=words):
        simulate_closed_loop(twin, controller, "0:30,60:60/20", duration=120)


def test_a_simulated_loop_and_one_on_a_rig_have_the_limits_of_their_controller(twin: Twin):
    """70 degC can be held by full duty, not by a third of it."""
    weak = PID(0.1, limits=(0, 0.3))
    words = (
        r"references: expected 16\.0 to 3\d\.\d degC, which a duty of 0 to 0\.3 can hold, got 50"
    )
    with pytest.raises(ControlError, match=words):
        simulate_closed_loop(twin, weak, 50, duration=60)
    with pytest.raises(ControlError, match=words):
        checked_loop(twin, weak, 50, 60)


def on_off(time, reference, measurement):
    if measurement[0] > reference[0]:
        return 0.0
    return 0.5


def without_return(time, reference, measurement):
    jnp.clip(reference - measurement, -1, 1)


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (on_off, r"got Python's if, .* use jnp\.where\(condition, duty, other\)"),
        (lambda t, r, y: float(y[0]), "float.* on temperatures"),
        (lambda t, r, y: np.maximum(np.asarray(y)[:2], 0), "NumPy on temperatures"),
        (without_return, "expected a function that returns a duty, .* got None"),
    ],
)
def test_a_function_that_jax_cannot_trace_is_answered_in_a_sentence(twin: Twin, function, words):
    with pytest.raises(ControlError, match=words) as caught:
        simulate_closed_loop(twin, function, 35, duration=60)
    assert "\n" not in str(caught.value)
    with pytest.raises(ControlError, match=words):
        checked_loop(twin, FunctionController(function), 35, 60)


def test_a_loop_on_a_rig_needs_a_duty_for_each_of_its_cells(twin: Twin):
    """Before anything is sent to the rig, as in a simulated loop."""
    three = PID([0.1, 0.1, 0.1])
    with pytest.raises(ControlError, match="control: controller: expected the duty of 2 cells"):
        checked_loop(twin, three, 35, 60)


def test_a_start_in_kelvin_is_refused_with_its_value_in_celsius(twin: Twin):
    with pytest.raises(ControlError, match=r"initial: expected degC, got 313 degC .* 39\.9 degC\?"):
        simulate_closed_loop(twin, PID(0.1), 35.0, duration=100, initial=313.0)


@pytest.mark.parametrize(("start", "end"), [(200.0, 300.0), (-20.0, -10.0), (10.2, 10.4)])
def test_a_disturbance_that_never_acts_is_refused(twin: Twin, start: float, end: float):
    never = HeatInput((twin.rig.plate.element_names[0],), start, end, 5.0)
    with pytest.raises(ControlError, match=r"disturbances\[0\]: expected a time within the run"):
        simulate_closed_loop(twin, PID(0.1), 35.0, duration=100, disturbances=[never])


@pytest.mark.parametrize("time", [0, 0.0, np.array([1.0, 0.0])])
def test_a_tracking_time_of_zero_is_refused(time: Any):
    with pytest.raises(ControlError, match="tracking_time_s: expected a time above 0 s, or None"):
        PID(0.1, 0.01, tracking_time_s=time)
