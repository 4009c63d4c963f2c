"""Channels whose sensors follow the plate with a time constant."""

import numpy as np
import pytest
from hand_rig import (
    AMBIENT,
    CAPACITANCE,
    LINKS,
    SINK,
    TO_AIR,
    after,
    hand_rig,
    heater_power,
    linear_network,
)

import jaxtwin as jt
from jaxtwin import Experiment, Stepper, Twin, simulate, simulate_batch
from jaxtwin.errors import ParameterError, RigError

DUTY, LAG = 0.6, 7.0
EXPERIMENT = Experiment.schedule(f"0:{DUTY}", duration=100)
LAG_PARAMETER = """
[parameters]
tau = { value = 7.0, unit = "s", bounds = [0.5, 60.0], free = true }
"""


def by_hand(weights: list[float], lag: float, time: float) -> float:
    """What the sensor of a channel over V11 and V12 reads, degC: it feels the plate, which does
    not feel it, in a matrix exponential."""
    C, G = linear_network(np.array(CAPACITANCE), LINKS, TO_AIR | {3: SINK})
    matrix = np.zeros((5, 5))
    matrix[:4, :4] = -np.linalg.solve(C, G)
    matrix[4] = np.array([*weights, 0.0, 0.0, -1.0]) / lag
    drive = np.zeros(5)
    drive[2:4] = heater_power(DUTY) / 2 / CAPACITANCE[2]
    return AMBIENT + after(matrix, drive, time)[4]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("read", "weights"), [('["V12"]', [0.0, 1.0]), ('["V11", "V12"]', [0.5, 0.5])]
)
def test_a_sensor_follows_the_mean_of_its_elements_as_by_hand(read, weights):
    """Within 0.1 mK: a millionth of an element's heat capacity flows into it."""
    rig = hand_rig(read=read, channel=f'lag = "{LAG} s"')
    run = simulate(Twin(rig), EXPERIMENT)
    for time in (3, 10, 40, 100):
        assert run.channel("T1")[time] == pytest.approx(by_hand(weights, LAG, time), abs=1e-4)


@pytest.mark.slow
def test_the_plate_does_not_feel_the_sensor():
    without = simulate(Twin(hand_rig()), EXPERIMENT)
    lagging = simulate(Twin(hand_rig(channel='lag = "2 s"')), EXPERIMENT)
    assert lagging.nodes == (*without.nodes, "T1.SENSOR")
    assert np.abs(lagging.states[:, :-1] - without.states).max() < 1e-4


@pytest.mark.slow
def test_steps_of_a_stepper_and_draws_of_a_batch_have_the_lag():
    """Both against the hand calculation, each draw with its own time constant."""
    rig = hand_rig(channel='lag = "tau"', more=LAG_PARAMETER)
    stepper = Stepper(Twin(rig))
    state = stepper.step(stepper.start(), [DUTY], steps=40)
    assert float(stepper.channels(state)[0]) == pytest.approx(by_hand([0, 1], LAG, 40), abs=1e-4)
    lags = np.array([2.0, 20.0])
    drawn = simulate_batch(Twin(rig), EXPERIMENT, {"tau": lags})
    for readings, lag in zip(drawn, lags, strict=True):
        assert readings[40, 0] == pytest.approx(by_hand([0, 1], lag, 40), abs=1e-4)


@pytest.mark.slow
def test_a_match_finds_the_lag():
    """A recording made by hand, with nothing but the time constant unknown."""
    rig = hand_rig(channel='lag = "tau"', more=LAG_PARAMETER)
    readings = [[by_hand([0, 1], 11.0, time)] for time in range(101)]
    recording = Experiment(
        EXPERIMENT.time, EXPERIMENT.duty, channels=["T1"], temperatures=np.array(readings),
        ambient=AMBIENT,
    )  # fmt: skip
    fit = jt.match(Twin(rig), [recording])
    assert fit["tau"].value == pytest.approx(11.0, rel=1e-4)


def test_at_rest_it_reads_the_plate():
    rig = hand_rig(channel='lag = "5 s"')
    point = jt.linearize(Twin(rig), duty=0.5).operating_point
    assert float(point.nodes[-1]) == pytest.approx(float(point.nodes[1]), abs=1e-9)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("5", "a time above 0.* got '5', a number without a unit"),
        ("5 K", "a time above 0.* got '5 K'"),
        ("0 s", "a time above 0.* got '0 s'"),
        ("tau", "unknown parameter 'tau'"),
    ],
)
def test_an_invalid_lag_is_refused_by_its_field(text, words):
    with pytest.raises(RigError, match=rf"^hand\.toml: channels\[T1\]\.lag: .*{words}"):
        hand_rig(channel=f'lag = "{text}"')


def test_a_camera_has_no_lag():
    camera = """
    [camera]
    resolution = [80, 60]
    noise = "0.1 K"
    view = { x = [0, 80], y = [10, 50] }
    """
    with pytest.raises(RigError, match=r"channels\[T1\]\.lag: expected \[sensors\] beside a lag"):
        hand_rig(channel='lag = "5 s"', sensors=camera)


@pytest.mark.slow
def test_a_draw_that_takes_the_lag_below_zero_is_refused():
    rig = hand_rig(channel='lag = "tau"', more=LAG_PARAMETER)
    with pytest.raises(ParameterError, match=r"lag of T1 \(tau\): expected a value above 0"):
        simulate(Twin(rig, {"tau": -1.0}), EXPERIMENT)
