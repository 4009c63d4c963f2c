"""A stepper with fewer modes, beside the twin in all of them."""

import jax
import numpy as np
import pytest
from boxes import box

from jaxtwin import Experiment, Stepper, Twin, simulate
from jaxtwin.errors import SimulationError
from jaxtwin.simulation import reduce_stepper

EXAMPLE = np.random.default_rng(0).uniform(-0.3, 1.0, (60, 2)).repeat(60, axis=0)


@pytest.fixture(scope="module")
def whole() -> Stepper:
    return Stepper(Twin("dual-cell"), 1.0)


@pytest.fixture(scope="module")
def twelve(whole: Stepper) -> Stepper:
    return reduce_stepper(whole, 12, EXAMPLE)


def channels(stepper: Stepper, duty: np.ndarray) -> np.ndarray:
    """At the start and after each command, degC."""

    def step(state, command):
        state = stepper.step(state, command)
        return state, stepper.channels(state)

    with jax.enable_x64(True):
        start = jax.tree.map(jax.numpy.asarray, stepper.start())
        rows = jax.jit(lambda commands: jax.lax.scan(step, start, commands)[1])(duty)
        return np.vstack([stepper.channels(start), rows])


def simulated(duty: np.ndarray) -> np.ndarray:
    """By `simulate`, in all modes and with steps of its own size, degC."""
    held = np.vstack([duty, duty[-1:]])
    drive = Experiment(np.arange(len(held), dtype=float), held)
    return simulate(Twin("dual-cell"), drive).temperatures


@pytest.mark.slow
def test_twelve_modes_follow_the_drive_of_the_recordings(twelve: Stepper):
    """Half a duty, then 0.78, from rest: not the drive by which the modes were chosen."""
    duty = np.tile(np.where(np.arange(1000) < 500, 0.5, 0.78)[:, None], (1, 2))
    assert np.abs(channels(twelve, duty) - simulated(duty)).max() < 0.03


@pytest.mark.slow
def test_twelve_modes_follow_commands_that_they_were_not_chosen_by(twelve: Stepper):
    """The cells against each other, heating and cooling, in steps of another length."""
    duty = np.random.default_rng(1).uniform(-0.3, 1.0, (20, 2)).repeat(50, axis=0)
    expected = simulated(duty)
    assert np.ptp(expected, axis=0).max() > 20
    assert np.abs(channels(twelve, duty) - expected).max() < 0.1


@pytest.mark.slow
def test_modes_of_equal_duty_do_not_hold_for_unequal_ones(whole: Stepper):
    """The docstring warns of such an example."""
    equal = np.tile(np.where(np.arange(1000) < 500, 0.5, 0.78)[:, None], (1, 2))
    six = reduce_stepper(whole, 6, equal)
    assert np.abs(channels(six, equal) - simulated(equal)).max() < 0.1
    one = equal * [1.0, 0.0]
    assert np.abs(channels(six, one) - simulated(one)).max() > 1


@pytest.mark.slow
def test_all_modes_are_the_stepper_itself(whole: Stepper):
    """The space is all of it; only the coordinates are others."""
    random = np.random.default_rng(2)
    same = reduce_stepper(whole, 30, random.uniform(-1, 1, (3000, 2)))
    duty = random.uniform(-0.3, 1.0, (50, 2))
    np.testing.assert_allclose(channels(same, duty), channels(whole, duty), rtol=0, atol=1e-6)


@pytest.mark.slow
def test_inputs_act_in_all_modes_as_in_the_stepper_itself():
    stepper = Stepper(Twin(box()), 1.0)
    example = np.random.default_rng(0).uniform(-1, 1, (400, 1))
    reduced = reduce_stepper(stepper, 6, example)
    inputs = {"lid": "open", "fan": 0.2, "T_water": 30.0}
    found, expected = (
        one.step(one.start(), [0.5], steps=60, inputs=inputs) for one in (reduced, stepper)
    )
    np.testing.assert_allclose(found.nodes, expected.nodes, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_an_idle_plate_in_another_room_is_as_warm_as_the_room(twelve: Stepper):
    """The first law: where all temperatures are those of the room, no heat flows."""
    still = twelve.step(twelve.start(25.0), [0.0, 0.0], 25.0, steps=1000)
    np.testing.assert_allclose(still.nodes, 25.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("modes", "duty", "message"),
    [
        (0, EXAMPLE, "modes: expected"),
        (31, EXAMPLE, "at most the 30 modes of the stepper, got 31"),
        (12, np.full((100, 3), 0.5), r"shape \(steps, 2\), got an array of shape \(100, 3\)"),
        (12, np.full((100, 2), np.nan), r"finite numbers of shape \(steps, 2\)"),
        (12, np.zeros((0, 2)), r"got an array of shape \(0, 2\)"),
        (12, np.full((5, 2), 0.5), "12 directions, got 4; give a longer example"),
    ],
)
def test_a_space_that_cannot_be_found_is_refused(
    whole: Stepper, modes: int, duty: np.ndarray, message: str
):
    with pytest.raises(SimulationError, match=message):
        reduce_stepper(whole, modes, duty)
