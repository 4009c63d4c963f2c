"""Inputs besides the duty: a lid that opens, a fan that stops, a voltage, cooling water."""

import numpy as np
import pytest
from boxes import box, box_table, by_radau

import jaxtwin as jt
from jaxtwin import Experiment, Twin
from jaxtwin.rig import rig_from_tables

SCHEDULES = {
    "lid": "0:0,150:1,300:0,620:1",
    "fan": "0:1,250:0,500:2.5",
    "V_supply": "0:12,100:11,450:12.5",
    "T_water": "0:20,350:35",
}


def _experiment(inputs: dict[str, str] = SCHEDULES) -> Experiment:
    return Experiment.schedule(
        "0:0.5,200:0,400:-0.3", duration=900, step=5, ambient=20.0, inputs=inputs
    )


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin(box())


@pytest.fixture(scope="module")
def exact(twin: Twin) -> np.ndarray:
    return by_radau(twin, _experiment())


@pytest.mark.slow
def test_all_inputs_together_agree_with_the_equations_solved_by_scipy(twin, exact):
    run = jt.simulate(twin, _experiment())
    assert np.abs(run.states - exact).max() < 1e-4


@pytest.mark.slow
def test_a_fan_whose_speed_changes_at_every_sample_agrees_with_scipy(twin):
    fan = 1 + 0.9 * np.sin(np.arange(181) / 7)
    experiment = _experiment().with_inputs(fan=fan)
    run = jt.simulate(twin, experiment)
    assert np.abs(run.states - by_radau(twin, experiment)).max() < 2e-3


@pytest.mark.slow
def test_draws_of_a_batch_are_single_runs(twin):
    values = np.array([0.15, 0.05])
    batch = jt.simulate_batch(twin, _experiment(), {"R_open": values})
    for temperatures, value in zip(batch, values, strict=True):
        run = jt.simulate(twin.with_values({"R_open": value}), _experiment())
        np.testing.assert_allclose(temperatures, run.temperatures, atol=1e-4)


@pytest.mark.slow
def test_derivatives_of_the_resistance_of_each_state_are_central_differences(twin):
    import jax

    experiment = _experiment()
    at = {"R_air": 0.8, "R_closed": 4.0, "R_open": 0.15}

    def simulated(values: dict) -> np.ndarray:
        return jt.simulate(twin.with_values(values), experiment).temperatures

    with jax.enable_x64(True):
        slopes = jax.jacfwd(lambda values: jt.response(twin.with_values(values), experiment))(at)
    for name, value in at.items():
        ahead, behind = (simulated(at | {name: value * (1 + h)}) for h in (1e-4, -1e-4))
        difference = (ahead - behind) / (2e-4 * value)
        np.testing.assert_allclose(slopes[name], difference, atol=2e-3 * np.abs(difference).max())


def test_names_of_states_are_their_numbers(twin):
    numbers = _experiment(SCHEDULES)
    named = _experiment(SCHEDULES | {"lid": "0:closed,150:open,300:closed,620:open"})
    np.testing.assert_array_equal(
        jt.simulate(twin, named).temperatures, jt.simulate(twin, numbers).temperatures
    )


@pytest.mark.slow
def test_a_schedule_without_inputs_has_the_values_of_the_rig_file(twin):
    plain = Experiment.schedule("0:0.5", duration=300, step=5, ambient=20.0)
    stated = plain.with_inputs(lid="closed", fan=1.0, V_supply=12.0, T_water=20.0)
    np.testing.assert_array_equal(
        jt.simulate(twin, plain).temperatures, jt.simulate(twin, stated).temperatures
    )


@pytest.mark.slow
def test_power_follows_the_measured_voltage(twin):
    experiment = Experiment.schedule(
        "0:1", duration=100, step=1, ambient=20.0, inputs={"V_supply": "0:12,50:6"}
    )
    power = jt.simulate(twin, experiment).power[:, 0]
    # V (V - emf) / R, with half the voltage.
    assert power[0] == pytest.approx(12**2 / 2.1)
    assert power[50] < power[49] / 3


@pytest.mark.slow
def test_a_driver_with_a_delay_delays_the_duty_and_not_the_lid():
    table = box_table()
    table["driver"] |= {"lag": "1 s", "delay": "tau"}
    table["parameters"]["tau"] = {"value": 7.3, "unit": "s", "bounds": [0.1, 60.0], "free": True}
    twin = Twin(rig_from_tables(table, "box"))
    duty, lid = np.zeros(121), np.zeros(121)
    duty[20:], lid[60:] = 0.5, 1.0
    run = jt.simulate(twin, Experiment(np.arange(121.0), duty, ambient=20.0, inputs={"lid": lid}))
    air = run.temperatures[:, run.channels.index("Tair")]
    assert np.abs(air[:28] - 20).max() < 1e-3
    assert air[60] > air[59] > 20.5
    assert air[62] < air[60]


@pytest.mark.slow
def test_a_recording_that_lacks_an_input_is_refused_in_one_sentence(twin):
    run = jt.simulate(twin, _experiment())
    recording = Experiment(
        run.experiment.time,
        run.experiment.duty,
        channels=run.channels,
        temperatures=run.temperatures,
        inputs={name: run.experiment.inputs[name] for name in ("fan", "V_supply", "T_water")},
        name="monday",
    )
    with pytest.raises(
        jt.errors.SimulationError, match="monday: expected a column for the input 'lid'"
    ):
        jt.simulate(twin, recording)
    jt.simulate(twin, recording.with_inputs(lid="closed"))


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        ({"lid": "ajar"}, "input lid: unknown state 'ajar'. Known: closed, open"),
        ({"lid": 2.0}, "input lid: expected closed, open, or 0 to 1, got 2"),
        ({"fan": "fast"}, "input fan: expected a number, got 'fast'"),
        ({"door": 1.0}, "inputs: expected those of box, lid, fan, V_supply, T_water, got 'door'"),
    ],
)
def test_an_unknown_state_or_input_is_refused(twin, inputs, message):
    plain = Experiment.schedule("0:0.5", duration=60, step=5, ambient=20.0)
    with pytest.raises(jt.errors.SimulationError, match=message):
        jt.simulate(twin, plain.with_inputs(**inputs))


@pytest.mark.slow
def test_a_match_finds_the_resistance_of_each_state(twin):
    run = jt.simulate(twin, _experiment())
    noise = np.random.default_rng(3).normal(0, 0.05, run.temperatures.shape)
    recording = Experiment(
        run.experiment.time,
        run.experiment.duty,
        channels=run.channels,
        temperatures=run.temperatures + noise,
        ambient=20.0,
        inputs=run.experiment.inputs,
        name="synthetic",
    )
    start = twin.with_values({"R_open": 0.3, "R_closed": 2.5, "R_air": 1.2})
    fit = jt.match(start, [recording])
    for name in ("R_open", "R_closed", "R_air"):
        estimate = fit.parameters[name]
        assert abs(estimate.value - float(twin.values[name])) < 4 * estimate.standard_error


@pytest.mark.slow
def test_a_stepper_takes_inputs_for_each_step(twin):
    lid = np.repeat([0.0, 1.0, 0.0], [100, 50, 51])
    experiment = Experiment(np.arange(201.0), np.full(201, 0.5), ambient=20.0)
    run = jt.simulate(twin, experiment.with_inputs(lid=lid, fan=0.0))
    stepper = jt.Stepper(twin, step_size=1.0)
    state = stepper.start()
    for number, state_of_lid in ((100, "closed"), (50, "open"), (50, 0)):
        held = {"lid": state_of_lid, "fan": 0.0}
        state = stepper.step(state, [0.5], 20.0, steps=number, inputs=held)
    np.testing.assert_allclose(state.nodes, run.states[-1], atol=1e-3)
    with pytest.raises(jt.errors.SimulationError, match="input lid: unknown state 'ajar'"):
        stepper.step(state, [0.5], inputs={"lid": "ajar"})
    with pytest.raises(jt.errors.SimulationError, match="unknown input 'door'"):
        stepper.step(state, [0.5], inputs={"door": 1.0})


@pytest.mark.slow
def test_a_run_as_a_recording_has_all_inputs(twin):
    """Those that are not stated had the values of the rig file."""
    lid = np.repeat([0, 1], [5, 6])
    experiment = Experiment(np.arange(11.0), np.full(11, 0.5), ambient=20.0).with_inputs(lid=lid)
    recording = jt.simulate(twin, experiment).to_recording()
    assert set(recording.inputs) == {"lid", "fan", "V_supply", "T_water"}
    np.testing.assert_array_equal(recording.inputs["lid"], lid)
    np.testing.assert_array_equal(recording.inputs["V_supply"], 12.0)
    again = jt.simulate(twin, recording)
    np.testing.assert_array_equal(again.states, jt.simulate(twin, experiment).states)


def test_all_leaves_of_a_stepper_are_arrays(twin):
    import equinox as eqx
    import jax

    for one in (twin, Twin("tclab"), Twin("single-cell")):
        assert all(map(eqx.is_array, jax.tree.leaves(jt.Stepper(one))))
