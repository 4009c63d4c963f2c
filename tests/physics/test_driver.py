"""PWM and H-bridge: what the two averagings share, where they part, and both by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin.physics import Bridge, CellHeat, ThermoelectricModule
from jaxtwin.physics._driver import share_of_duty

SUPPLY, SUPPLY_RESISTANCE, ON_RESISTANCE = 12.0, 0.2, 0.1
ALPHA, R_E = 0.05, 2.0
LOOP = R_E + ON_RESISTANCE
MODES = [("voltage", "brake"), ("on-off", "brake"), ("on-off", "open")]

duties = st.floats(-1, 1)
temperatures = st.floats(230, 400)


def heat(averaging, off_phase, duty: float, cold: float, hot: float) -> CellHeat:
    """One cell, in float64, as numbers."""
    with jax.enable_x64(True):
        bridge = Bridge(SUPPLY, SUPPLY_RESISTANCE, ON_RESISTANCE, averaging, off_phase)
        module = ThermoelectricModule(ALPHA, R_E, 1.5)
        flows = bridge.heat(module, *(jnp.array([value]) for value in (duty, cold, hot)))
        return CellHeat(*(np.asarray(flow)[0] for flow in flows))


@pytest.mark.parametrize(("averaging", "off_phase"), MODES)
def test_full_duty_by_hand(averaging, off_phase):
    """Terminal current (-12 V - 0.05 * 10) / 2.3 ohm: there is no rest of the period to average."""
    current = -(12 + 0.05 * 10) / (LOOP + SUPPLY_RESISTANCE)
    flow = heat(averaging, off_phase, 1.0, 290.0, 300.0)
    assert flow.current == pytest.approx(current)
    assert flow.cold == pytest.approx(ALPHA * current * 290 - 0.5 * R_E * current**2)
    assert flow.hot == pytest.approx(ALPHA * current * 300 + 0.5 * R_E * current**2)


@given(st.sampled_from([-1.0, 1.0]), temperatures, temperatures)
def test_all_averagings_agree_at_full_duty(duty, cold, hot):
    flows = [heat(*mode, duty, cold, hot) for mode in MODES]
    for other in flows[1:]:
        assert other == pytest.approx(flows[0], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(("averaging", "share"), [("voltage", 0.25), ("on-off", 0.5)])
def test_joule_heat_falls_with_the_square_of_the_mean_voltage_or_with_the_duty(averaging, share):
    """Without a temperature difference, without supply resistance, all power is Joule heat."""
    with jax.enable_x64(True):
        bridge = Bridge(SUPPLY, 0.0, ON_RESISTANCE, averaging, "brake")
        module = ThermoelectricModule(ALPHA, R_E, 1.5)
        T = jnp.full(2, 300.0)
        half, full = np.asarray(bridge.heat(module, jnp.array([0.5, 1.0]), T, T).power)
    assert full == pytest.approx(R_E * (SUPPLY / LOOP) ** 2)
    assert half / full == pytest.approx(share)


def test_half_duty_on_off_is_half_of_on_and_half_of_brake_by_hand():
    on = -(12 + 0.05 * 20) / 2.3
    off = -0.05 * 20 / 2.1
    flow = heat("on-off", "brake", 0.5, 290.0, 310.0)
    assert flow.current == pytest.approx(0.5 * on + 0.5 * off)
    assert flow.cold == pytest.approx(0.5 * (0.05 * 290 * (on + off) - 1.0 * (on**2 + off**2)))
    assert flow.hot == pytest.approx(0.5 * (0.05 * 310 * (on + off) + 1.0 * (on**2 + off**2)))


def test_half_duty_by_mean_voltage_by_hand():
    """The mean drop at the supply is duty times that of the mean current: 2.1 + 0.5 * 0.2 ohm."""
    current = (0.5 * -12 - 0.05 * 20) / 2.2
    flow = heat("voltage", "brake", 0.5, 290.0, 310.0)
    assert flow.current == pytest.approx(current)
    assert flow.cold == pytest.approx(0.05 * 290 * current - current**2)


@pytest.mark.parametrize("averaging", ["voltage", "on-off"])
def test_braked_cell_at_zero_duty_drives_a_current_by_itself(averaging):
    """10 K make 0.5 V across 2.1 ohm; what it takes in at the hot side comes out at the cold one,
    less what the bridge's 0.1 ohm turn into heat outside."""
    current = -0.5 / 2.1
    flow = heat(averaging, "brake", 0.0, 290.0, 300.0)
    assert flow.current == pytest.approx(current)
    assert flow.cold == pytest.approx(0.05 * 290 * current - current**2)
    assert flow.hot == pytest.approx(0.05 * 300 * current + current**2)
    assert flow.power == pytest.approx(-ON_RESISTANCE * current**2)


def test_open_cell_at_zero_duty_does_nothing():
    assert tuple(heat("on-off", "open", 0.0, 290.0, 310.0)) == (0.0, 0.0, 0.0, 0.0)


def test_open_cell_gets_half_of_the_full_flow_at_half_duty():
    full, half = (heat("on-off", "open", duty, 290.0, 310.0) for duty in (1.0, 0.5))
    assert half == pytest.approx([0.5 * flow for flow in full])


@pytest.mark.parametrize(("averaging", "off_phase"), MODES)
@given(duties, temperatures, temperatures)
def test_reversed_drive_mirrors_the_cell(averaging, off_phase, duty, cold, hot):
    """Both sides are alike: -duty with the temperatures exchanged exchanges the heat flows."""
    flow = heat(averaging, off_phase, duty, cold, hot)
    mirrored = heat(averaging, off_phase, -duty, hot, cold)
    expected = CellHeat(-flow.hot, -flow.cold, -flow.current, flow.power)
    assert mirrored == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("averaging", "off_phase"), MODES)
@given(duties, temperatures, temperatures)
def test_positive_duty_heats_the_plate_side(averaging, off_phase, duty, cold, hot):
    """Against the same cell at rest; sign of circuit.md: the drive makes the current negative."""
    rest = heat(averaging, off_phase, 0.0, 300.0, 300.0)
    flow = heat(averaging, off_phase, abs(duty), 300.0, 300.0)
    assert rest.cold == 0
    assert flow.cold <= 0
    assert flow.current <= 0


@given(duties, temperatures, temperatures)
def test_power_of_on_off_switching_is_that_of_the_supply_less_the_resistances(duty, cold, hot):
    """Energy around the loop: D V I_on = power in the cell + Joule heat outside of it."""
    flow = heat("on-off", "brake", duty, cold, hot)
    emf = ALPHA * (hot - cold)
    on = (-np.sign(duty) * SUPPLY - emf) / (LOOP + SUPPLY_RESISTANCE)
    off = -emf / LOOP
    share = abs(duty)
    supplied = share * -np.sign(duty) * SUPPLY * on
    lost = (
        share * on**2 * (ON_RESISTANCE + SUPPLY_RESISTANCE) + (1 - share) * off**2 * ON_RESISTANCE
    )
    assert flow.power == pytest.approx(supplied - lost, rel=1e-9, abs=1e-9)


def test_seebeck_voltage_of_a_shorted_cell_conducts_heat():
    """alpha^2 T / R, from the slope of the heat flow at small differences."""
    step = 1e-3
    slope = (heat("voltage", "brake", 0.0, 300.0, 300.0 + step).cold) / step
    assert slope == pytest.approx(-(ALPHA**2) * 300 / LOOP, rel=1e-4)


@pytest.mark.parametrize(("averaging", "off_phase"), MODES)
@pytest.mark.parametrize("duty", [1.0, 0.4, 0.0, -0.7])
def test_the_supply_gives_the_power_of_cell_and_resistances(averaging, off_phase, duty: float):
    """12 V times the current, which becomes the cell's power and heat in the resistances."""
    cold, hot = 290.0, 300.0
    emf, share = ALPHA * (hot - cold), abs(duty)
    with jax.enable_x64(True):
        bridge = Bridge(SUPPLY, SUPPLY_RESISTANCE, ON_RESISTANCE, averaging, off_phase)
        module = ThermoelectricModule(ALPHA, R_E, 1.5)
        arrays = (jnp.array([value]) for value in (duty, cold, hot))
        found = float(bridge.supply_power(module, *arrays)[0])
    if averaging == "voltage":
        current = (-duty * SUPPLY - emf) / (LOOP + share * SUPPLY_RESISTANCE)
        cell = current * (emf + R_E * current)
        lost = current**2 * (ON_RESISTANCE + share * SUPPLY_RESISTANCE)
        assert found == pytest.approx(cell + lost)
    else:
        current = (-np.sign(duty) * SUPPLY - emf) / (LOOP + SUPPLY_RESISTANCE)
        cell = current * (emf + R_E * current)
        lost = current**2 * (ON_RESISTANCE + SUPPLY_RESISTANCE)
        assert found == pytest.approx(share * (cell + lost))


def test_the_law_of_the_drive_has_finite_derivatives_at_duty_0(float64):
    for exponent in (0.5, 1.0, 2.0):
        by_both = jax.grad(share_of_duty, argnums=(0, 1))(jnp.array(0.0), jnp.array(exponent))
        assert np.isfinite(by_both).all()
    duty, exponent = jnp.array([0.3, 1.0]), jnp.array([2.0, 0.7])
    np.testing.assert_allclose(share_of_duty(duty, exponent), [0.09, 1.0], atol=1e-8)
