"""Fans: a thermal resistance to air that falls with a power of their speed."""

import numpy as np
import pytest
from hand_rig import AMBIENT, hand_rig, heater_power

from jaxtwin import Experiment, Twin, linearize, simulate, simulate_batch
from jaxtwin.errors import ParameterError, RigError

SPEED = '[parameters]\nn_fan = { value = 1.0, unit = "", bounds = [0.2, 2.0], free = true }'
SINK = 'sink_capacitance = "50 J/K"\nsink_air_resistance = "0.4 K/W"\n'
FAN = SINK + 'fan = { speed = "n_fan" }'


def sink_at_rest(air_resistance: float) -> float:
    """The sink's temperature under full duty, degC, by the two heat balances of the heater's sides.

    What leaves the far side through 0.8 K/W and the sink comes from half of the power and from the
    plate side through 1.5 K/W; the plate side loses the rest through 0.5 K/W to V11, which has
    5 K/W to air, and 2 K/W with 5 K/W behind V12.
    """
    plate = 0.5 + 1 / (1 / 5 + 1 / (2 + 5))
    sink, half = 0.8 + air_resistance, heater_power(1.0) / 2
    # (1/plate + 1/1.5) TC - TH/1.5 = half; (1/sink + 1/1.5) TH - TC/1.5 = half
    matrix = [[1 / plate + 1 / 1.5, -1 / 1.5], [-1 / 1.5, 1 / sink + 1 / 1.5]]
    far = np.linalg.solve(matrix, [half, half])[1]
    return AMBIENT + far * air_resistance / sink


@pytest.mark.parametrize(
    ("cell", "speed", "resistance"),
    [
        (SINK, 1.0, 0.4),
        (FAN, 1.0, 0.4),
        (FAN, 0.25, 0.8),
        (FAN.replace("}", ", exponent = 0.8 }"), 0.5, 0.4 * 2**0.8),
    ],
)
def test_the_sink_at_rest_is_as_by_hand(cell, speed, resistance):
    """At a quarter of the speed the resistance doubles; with an exponent of 0.8 half the speed
    makes it 1.741 of what it was."""
    has_fan = "n_fan" in cell
    rig = hand_rig(cell=cell, more=SPEED if has_fan else "")
    twin = Twin(rig, {"n_fan": speed} if has_fan else None)
    point = linearize(twin, duty=1.0).operating_point
    assert float(point.nodes[-1]) == pytest.approx(sink_at_rest(resistance), abs=1e-9)


@pytest.mark.slow
def test_a_link_has_a_fan_too_and_draws_a_speed_each():
    """A body in place of the sink, by draws of the speed: the same temperatures as the cell's own
    sink with the resistances that the power law gives."""
    body = """
    [[bodies]]
    name = "fins"
    capacitance = "50 J/K"
    [[links]]
    resistance = "0.4 K/W"
    between = ["fins-ambient"]
    fan = { speed = "n_fan" }
    """
    experiment = Experiment.schedule("0:0.7", duration=200)
    speeds = np.array([0.25, 1.0, 1.44])
    drawn = simulate_batch(
        Twin(hand_rig(cell='sink = "fins"', more=body + SPEED)), experiment, {"n_fan": speeds}
    )
    for readings, resistance in zip(drawn, (0.8, 0.4, 0.4 / 1.2), strict=True):
        fixed = hand_rig(cell=SINK.replace("0.4", repr(resistance)))
        expected = simulate(Twin(fixed), experiment).temperatures
        np.testing.assert_allclose(readings, expected, rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("fan", "field", "words"),
    [
        ('{ speed = "0" }', "fan.speed", "a number without unit above 0.* got '0'"),
        ('{ speed = "-1" }', "fan.speed", "above 0.* got '-1'"),
        ('{ speed = "2400 s" }', "fan.speed", "got '2400 s'"),
        ('{ speed = "n" }', "fan.speed", "unknown parameter 'n'"),
        ('{ speed = "1", exponent = 0 }', "fan.exponent", "greater than 0, got 0"),
        ("{ exponent = 0.5 }", "fan.speed", "missing"),
        ('{ sped = "1" }', "fan", "unknown key 'sped', did you mean 'speed'"),
    ],
)
def test_a_wrong_fan_is_refused_by_its_field(fan, field, words):
    with pytest.raises(RigError, match=rf"hand\.toml: cells\[P1\]\.{field}: .*{words}"):
        hand_rig(cell=f"{SINK}fan = {fan}")


def test_a_speed_that_a_draw_may_take_to_zero_is_refused():
    bounds = SPEED.replace("0.2,", "0.0,")
    with pytest.raises(RigError, match=r"fan\.speed: .* got 0 as the lower bound of 'n_fan'"):
        hand_rig(cell=FAN, more=bounds)


def test_a_speed_not_above_zero_is_refused_where_the_twin_runs():
    rig = hand_rig(cell=FAN, more=SPEED)
    words = r"resistance P1\.SINK - ambient \(0\.4 n_fan\^-0\.5\): expected a value above 0"
    for speed, found in ((-1.0, "got nan"), (0.0, "got inf")):
        with pytest.raises(ParameterError, match=f"{words}, {found}"):
            simulate(Twin(rig, {"n_fan": speed}), Experiment.schedule("0:1", duration=10))


@pytest.mark.parametrize(
    ("cell", "words"),
    [
        ('fan = { speed = "1" }', "expected a sink_air_resistance beside a fan"),
        ('sink = "block"\nfan = { speed = "1" }', "give it to the body or its link"),
    ],
)
def test_a_fan_has_a_resistance_to_lower(cell, words):
    block = '[[bodies]]\nname = "block"\ntemperature = "12 degC"' if "block" in cell else ""
    with pytest.raises(RigError, match=rf"cells\[P1\]\.fan: {words}|cells\[P1\]\.fan: .*{words}"):
        hand_rig(cell=cell, more=block)
