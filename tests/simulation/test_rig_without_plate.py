"""Heaters, and rigs without a plate, against limits that are solved by hand."""

import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from heated_box import AMBIENT, NODES, by_hand, heated_box
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxtwin as jt
from jaxtwin import Experiment, Twin, simulate, simulate_batch
from jaxtwin.errors import SimulationError
from jaxtwin.rig import rig_from_tables

LONE = """
format = 1
name = "lone"
ambient = { temperature = "20 degC" }
sensors = { noise = "0 K" }
channels = [{ name = "T", nodes = ["block"] }]
heaters = [{ name = "H", power = "P", contacts = ["block"] }]
bodies = [{ name = "block", capacitance = "C" }]
links = [{ resistance = "R", between = ["block-ambient"] }]

[parameters]
P = { value = 40.0, unit = "W" }
R = { value = 2.0, unit = "K/W" }
C = { value = 50.0, unit = "J/K" }
"""
TIME = np.arange(0.0, 601.0, 5.0)


@settings(max_examples=30, deadline=None)
@given(
    power=st.floats(0.1, 500),
    resistance=st.floats(0.05, 20),
    capacitance=st.floats(5, 500),
    duty=st.floats(0, 1),
)
def test_a_lone_body_rises_exponentially(power, resistance, capacitance, duty):
    """P R above the room in the end, with the time constant R C."""
    twin = Twin(rig_from_tables(tomllib.loads(LONE), "lone"))
    twin = twin.with_values({"P": power, "R": resistance, "C": capacitance})
    run = simulate(twin, Experiment(TIME, np.full((len(TIME), 1), duty)))
    rise = duty * power * resistance
    expected = 20 + rise * (1 - np.exp(-TIME / (resistance * capacitance)))
    assert run.temperatures[:, 0] == pytest.approx(expected, abs=1e-9 + 1e-5 * rise)


@pytest.mark.parametrize("duty", [(0.0, 0.0), (0.7, 0.0), (0.3, 1.0)])
def test_a_box_of_three_nodes_is_as_by_hand(duty):
    twin = Twin(heated_box())
    run = simulate(twin, Experiment(np.arange(601.0), np.tile(duty, (601, 1))))
    assert run.nodes == NODES
    for time in (0, 3, 60, 600):
        assert run.states[time] == pytest.approx(by_hand(duty, time), abs=1e-6)


@pytest.mark.slow
def test_energy_is_conserved():
    """The heat stored, and that lost to the room, is the energy that the heaters drew."""
    time = np.arange(0, 1200.5, 0.5)
    duty = np.stack([time % 200 < 130, 0.4 * (time > 300)], axis=1).astype(float)
    run = simulate(Twin(heated_box()), Experiment(time, duty))
    rise = run.states - AMBIENT
    _, wall, heater = rise.T
    lost = np.trapezoid(wall / 1.5 + heater / 20, time)
    stored = rise[-1] @ np.array([60.0, 400.0, 25.0])
    drawn = run.energy[-1]
    assert drawn == pytest.approx(0.5 * (duty[:-1] @ [30.0, 12.0]).sum())
    assert stored + lost == pytest.approx(drawn, rel=2e-4)  # the trapezoids' error
    assert run.power == pytest.approx(duty * [30.0, 12.0])


@pytest.mark.slow
@pytest.mark.parametrize("averaging", ["on-off", "voltage"])
@pytest.mark.parametrize("limit", [None, "0.1 A"])
def test_a_given_power_is_linear_in_the_duty_whatever_the_driver(averaging, limit):
    driver = f'[driver]\nsupply_voltage = "24 V"\naveraging = "{averaging}"\n'
    driver += 'supply_resistance = "3 ohm"\n'
    driver += "" if limit is None else f'current_limit = "{limit}"\n'
    twin = Twin(heated_box(("[[heaters]]", driver + "[[heaters]]")))
    system = twin.system()
    duty = jnp.array([0.25, 0.5])
    reference = jnp.asarray(293.0)
    heat = system.heat_into_nodes(jnp.zeros(3), duty, reference)
    assert heat == pytest.approx([6.0, 0.0, 7.5])
    power = system.bridge.supply_power(system.module, duty, jnp.zeros(2), jnp.zeros(2))
    assert power == pytest.approx([7.5, 6.0])


@pytest.mark.slow
@pytest.mark.parametrize(("averaging", "heat"), [("on-off", 0.6), ("voltage", 0.36)])
def test_a_resistance_is_fed_by_the_driver(averaging, heat):
    """12 V through 2 ohm and 0.4 ohm of switches: on for 0.6 of the time, or 0.6 of the voltage."""
    driver = (
        f'[driver]\nsupply_voltage = "12 V"\non_resistance = "0.4 ohm"\naveraging = "{averaging}"\n'
    )
    twin = Twin(
        heated_box(
            ("[[heaters]]", driver + "[[heaters]]"),
            ('power = "12 W"', 'electrical_resistance = "2 ohm"'),
        )
    )
    current = 12 / 2.4
    system = twin.system()
    flow = system.heat_into_nodes(jnp.zeros(3), jnp.array([0.0, 0.6]), jnp.asarray(293.0))
    assert flow == pytest.approx([heat * 2 * current**2, 0.0, 0.0])
    power = system.bridge.supply_power(
        system.module, jnp.array([0.0, 0.6]), jnp.zeros(2), jnp.zeros(2)
    )
    assert power == pytest.approx([0.0, heat * 12 * current])


@pytest.mark.slow
def test_the_heat_has_a_derivative_at_rest():
    """With respect to the duty it is the power, also at a duty of 0; with respect to the power it
    is the duty."""
    twin = Twin(heated_box())
    model = jt.linearize(twin, duty=0.0)
    gain = np.asarray(model.B) * np.array([60.0, 400.0, 25.0])[:, None]
    assert gain == pytest.approx(np.array([[0.0, 12.0], [0.0, 0.0], [30.0, 0.0]]))

    def end(power):
        system = twin.with_values({"P": power}).system()
        return system.steady_state(jnp.array([0.5, 0.0]), jnp.asarray(293.15))

    at_rest = np.asarray(jax.jacfwd(end)(jnp.asarray(30.0)))
    assert at_rest * 30 == pytest.approx(by_hand((0.5, 0.0), 1e6) - AMBIENT, rel=1e-4)


@pytest.mark.slow
def test_draws_of_a_batch_are_as_single_runs():
    twin = Twin(heated_box())
    experiment = Experiment.schedule("0:0.8/0,100:0.2/1", duration=200, cells=2)
    draws = {"P": np.array([20.0, 30.0, 45.0]), "R_film": np.array([0.3, 0.5, 0.9])}
    batch = simulate_batch(twin, experiment, draws)
    for number in range(3):
        values = {name: column[number] for name, column in draws.items()}
        single = simulate(twin.with_values(values), experiment)
        assert batch[number] == pytest.approx(single.temperatures, abs=1e-4)


def test_a_heater_that_is_asked_to_cool_is_told_with_column_and_time():
    twin = Twin(heated_box())
    experiment = Experiment.schedule("0:0.5,40:0.5/-0.1", duration=60, cells=2)
    message = "duty_bulb: expected 0 to 1, because the heater 'bulb' cannot cool, got -0.1 at 40 s"
    with pytest.raises(SimulationError, match=message):
        simulate(twin, experiment)
    with pytest.raises(SimulationError, match="expected the 2 heaters of heated box, got 1"):
        simulate(twin, Experiment.schedule("0:0.5", duration=60))


def test_a_recording_in_which_a_heater_cools_is_told_with_its_file(tmp_path):
    file = tmp_path / "box.csv"
    file.write_text("time_s,duty_P1,duty_P2,T_air_degC\n0,0,0,20\n1,-0.25,0,20\n2,0,0,20\n")
    message = (
        f"{file}: duty_heater: expected 0 to 1, because the heater 'heater' cannot cool, got -0.25"
    )
    with pytest.raises(jt.errors.RecordingError, match=message):
        jt.read_recording(file, rig=heated_box())


def test_columns_may_have_the_names_of_the_heaters(tmp_path):
    file = tmp_path / "box.csv"
    file.write_text("time_s,duty_bulb,pwm_heater,T_air_degC\n0,0.5,51,20\n1,0,255,20\n")
    found = jt.read_recording(file, rig=heated_box(), counts=255)  # which its file does not state
    assert found.duty == pytest.approx(np.array([[0.2, 0.5], [1.0, 0.0]]))
    plain = jt.read_recording(file, counts=255)
    assert plain.cells == ("bulb", "heater")
    assert plain.for_rig(heated_box()) == found
