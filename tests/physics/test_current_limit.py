"""A controller that limits the current of the cells."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hand_rig import AMBIENT, CAPACITANCE, LINKS, SINK, TO_AIR, after, hand_rig, linear_network
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtwin import Experiment, Twin, simulate, simulate_batch
from jaxtwin.errors import ParameterError, RigError
from jaxtwin.physics import Bridge, ThermoelectricModule

LIMIT = 3.0
MODES = [("voltage", "brake"), ("on-off", "brake"), ("on-off", "open")]
LIMIT_PARAMETER = '[parameters]\nI_max = { value = 3.0, unit = "A" }'


def bridge(averaging: Any, off_phase: Any, limit: float | None = LIMIT) -> Bridge:
    return Bridge(12.0, 0.2, 0.1, averaging, off_phase, limit)


MODULE = ThermoelectricModule(0.05, 2.0, 1.5)


def cells(duty: float, cold: float, hot: float) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Duty, cold and hot temperature of one cell."""
    return jnp.array([duty]), jnp.array([cold]), jnp.array([hot])


@pytest.mark.usefixtures("float64")
@pytest.mark.parametrize(("averaging", "off_phase"), MODES)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_full_duty_is_the_limit_by_hand(averaging, off_phase, sign):
    """12 V would drive 5 A through 2.3 ohm. At 3 A the heat is 0.05 V/K * 3 A * T and 9 W, and the
    supply gives 3 A times what the 2.3 ohm and the cell's 1 V against or with it take."""
    flow = bridge(averaging, off_phase).heat(MODULE, *cells(sign, 290.0, 310.0))
    current = -sign * LIMIT
    assert float(flow.current[0]) == pytest.approx(current)
    assert float(flow.cold[0]) == pytest.approx(0.05 * current * 290 - 9)
    assert float(flow.hot[0]) == pytest.approx(0.05 * current * 310 + 9)
    drawn = bridge(averaging, off_phase).supply_power(MODULE, *cells(sign, 290.0, 310.0))
    assert float(drawn[0]) == pytest.approx(current * 1.0 + 9 * 2.3)


@pytest.mark.usefixtures("float64")
def test_half_duty_on_off_is_half_of_the_limit_and_half_of_brake_by_hand():
    """-1 V in the shorted cell drives 1 V / 2.1 ohm, whatever the limit."""
    on, off = -LIMIT, -1.0 / 2.1
    flow = bridge("on-off", "brake").heat(MODULE, *cells(0.5, 290.0, 310.0))
    assert float(flow.current[0]) == pytest.approx(0.5 * (on + off))
    assert float(flow.power[0]) == pytest.approx(0.5 * (on + off) + 2 * 0.5 * (on**2 + off**2))


@settings(max_examples=40)
@given(
    st.sampled_from(MODES), st.floats(-1, 1), st.floats(230, 400), st.floats(230, 400),
    st.floats(0.01, 20),
)  # fmt: skip
def test_a_limit_that_is_not_reached_changes_nothing_and_none_is_passed(
    mode, duty, cold, hot, limit
):
    """Also: the supply gives what cell, leads and switches turn into heat, limited or not."""
    with jax.enable_x64(True):
        at = cells(duty, cold, hot)
        free, limited = (
            bridge(mode[0], mode[1], I_max).heat(MODULE, *at) for I_max in (None, limit)
        )
        if mode == ("on-off", "open"):
            assert abs(float(limited.current[0])) <= abs(duty) * limit * (1 + 1e-12)
        on = abs(-np.sign(duty) * 12 - 0.05 * (hot - cold)) / 2.3
        is_reached = abs(float(free.current[0])) > limit if mode[0] == "voltage" else on > limit
        if not is_reached:
            assert np.asarray(limited) == pytest.approx(np.asarray(free), rel=1e-12)
        if mode == ("on-off", "open"):
            drawn = float(bridge(mode[0], mode[1], limit).supply_power(MODULE, *at)[0])
            lost = abs(duty) * min(on, limit) ** 2 * 0.3
            assert drawn == pytest.approx(float(limited.power[0]) + lost, rel=1e-9, abs=1e-9)


def by_hand(limit: float, time: float) -> float:
    """The reading of V12 of the heater under full duty: 2 ohm at the limiting current."""
    C, G = linear_network(np.array(CAPACITANCE), LINKS, TO_AIR | {3: SINK})
    drive = np.zeros(4)
    drive[2:4] = 2.0 * limit**2 / 2 / CAPACITANCE[2]
    return AMBIENT + after(-np.linalg.solve(C, G), drive, time)[1]


@pytest.mark.slow
def test_a_limited_heater_warms_up_as_by_hand():
    """A run, and draws of a batch with a limit each."""
    rig = hand_rig(driver='current_limit = "I_max"', more=LIMIT_PARAMETER)
    experiment = Experiment.schedule("0:1", duration=60)
    assert simulate(Twin(rig), experiment).channel("T1")[60] == pytest.approx(
        by_hand(3.0, 60), abs=1e-6
    )
    drawn = simulate_batch(Twin(rig), experiment, {"I_max": np.array([1.0, 4.0])})
    for readings, limit in zip(drawn, (1.0, 4.0), strict=True):
        assert readings[60, 0] == pytest.approx(by_hand(limit, 60), abs=1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("4", "a current above 0.* got '4', a number without a unit"),
        ("4 V", "a current above 0.* got '4 V'"),
        ("0 A", "a current above 0.* got '0 A'"),
        ("-4 A", "a current above 0.* got '-4 A'"),
        ("", "a current above 0.* got ''"),
        ("I_max", "unknown parameter 'I_max'"),
    ],
)
def test_an_invalid_current_limit_is_refused_by_its_field(text, words):
    with pytest.raises(RigError, match=rf"^hand\.toml: driver\.current_limit: .*{words}"):
        hand_rig(driver=f'current_limit = "{text}"')


def test_a_limit_below_zero_is_refused_where_the_twin_runs():
    rig = hand_rig(driver='current_limit = "I_max"', more=LIMIT_PARAMETER)
    with pytest.raises(ParameterError, match=r"current limit of the driver \(I_max\): expected"):
        simulate(Twin(rig, {"I_max": -1.0}), Experiment.schedule("0:1", duration=10))
