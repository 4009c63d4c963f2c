"""Closed loops: the plant is the Stepper's, the faults those that were asked for."""

from typing import Any

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from small_rigs import bundled

import jaxtwin as jt
from jaxtwin import Stepper, Twin
from jaxtwin.control import (
    MEASURES,
    PID,
    Draught,
    HeatInput,
    closed_loop,
    scenario,
    simulate_closed_loop,
    simulate_closed_loops,
)
from jaxtwin.control.loops._measures import units_of
from jaxtwin.control.loops._simulate_closed_loops import twin_at_medians
from jaxtwin.errors import ControlError, ParameterError, SimulationError

# Of all loops, s: the same shapes compile nothing anew.
DURATION = 120.0


@pytest.mark.slow
def test_a_loop_is_controller_and_stepper_in_turns(twin: Twin, pid: PID):
    """By hand, sample by sample, with quantised duty."""
    run = simulate_closed_loop(twin, pid, "0:20,20:24", duration=DURATION, noise=False)
    with jax.enable_x64(True):
        stepper = Stepper(twin, 1.0)
        plant = stepper.start()
        state = pid.init(np.zeros(2), np.asarray(stepper.channels(plant)).mean(keepdims=True))
        for sample in range(40):
            channels = np.asarray(stepper.channels(plant))
            np.testing.assert_allclose(run.run.temperatures[sample], channels, atol=1e-9)
            reference = np.array([20.0 if sample < 20 else 24.0])
            duty, state = pid.step(state, reference, channels.mean(keepdims=True))
            counts = np.round(np.asarray(duty) * 255)
            np.testing.assert_allclose(run.duty[sample] * 255, counts, atol=1e-9)
            plant = stepper.step(plant, counts / 255)
    assert abs(run.output[-1, 0] - 24) < 0.5
    table = run.measures()
    assert table.loc["energy", "value"] == pytest.approx(run.energy[-1])
    assert set(run.to_xarray()) >= {"temperature", "duty", "power", "energy", "controlled"}
    above, duty, power = run.plot().axes
    assert [axes.get_ylabel() for axes in (above, duty, power)] == [
        "temperature, °C",
        "duty, %",
        "power, W",
    ]
    plt.close("all")
    assert list(run.to_dataframe().columns)[:2] == ["reference mean of all", "mean of all"]


@pytest.mark.slow
def test_gradients_are_those_of_differences(twin: Twin):
    conditions = scenario(twin, PID(0.05), 35, duration=DURATION, quantised=False)

    def cost(Kp: jax.Array, resistance: jax.Array) -> jax.Array:
        plant = twin.with_values({"R_E": resistance})
        loop = closed_loop(plant, PID(Kp=Kp, Ki=0.001), conditions)
        return MEASURES["integral_squared_error"][0](loop)

    with jax.enable_x64(True):
        at = jnp.array(0.02), jnp.array(2.0)
        compiled = jax.jit(cost)
        gradient = jax.jit(jax.grad(cost, (0, 1)))(*at)
        for place, (slope, size) in enumerate(zip(gradient, (1e-5, 1e-4), strict=True)):
            up, down = (
                compiled(*(x + sign * size * (n == place) for n, x in enumerate(at)))
                for sign in (1, -1)
            )
            np.testing.assert_allclose(slope, (up - down) / (2 * size), rtol=1e-5)


@pytest.mark.slow
def test_draws_are_loops_side_by_side(twin: Twin, pid: PID):
    """Of plant and controller, in both precisions, and with a function of one's own."""
    draws = {"R_E": [1.9, 2.1, -1.0], "t_delay": [1.0, 3.5, 2.0]}
    found = simulate_closed_loops(
        twin,
        pid,
        35,
        duration=DURATION,
        draws=draws,
        controller_draws={"Kp": [0.05, 0.2, 0.1]},
    )
    assert found.failed.tolist() == [False, False, True]
    single = simulate_closed_loop(
        twin.with_values({"R_E": 2.1, "t_delay": 3.5}),
        PID(Kp=0.2, Ki=0.001),
        35,
        duration=DURATION,
    ).measures()["value"]
    for name in MEASURES:
        np.testing.assert_allclose(found[name][1], single[name], rtol=1e-6, err_msg=name)
    fast = simulate_closed_loops(
        twin,
        pid,
        35,
        duration=DURATION,
        controller_draws={"Kp": [0.05, 0.2]},
        measures={"hottest": lambda loop: loop.plate.max()},
        precision="float32",
    )
    assert fast["hottest"].shape == (2,)
    assert fast["hottest"][0] < fast["hottest"][1]


@pytest.mark.slow
def test_measures_of_many_loops_have_the_units_of_single_ones(twin: Twin, pid: PID):
    """In the dataset, in the table of a notebook and below the picture, under whatever name; the
    unit of a function of one's own is not known."""
    measures = {
        "hottest_cell_side": MEASURES["hottest_cell_side"][0],
        "squared": MEASURES["integral_squared_error"][0],
        "own": lambda loop: loop.plate.max(),
    }
    found = simulate_closed_loops(
        twin, pid, 35, duration=DURATION, draws={"R_E": [1.9, 2.1]}, measures=measures
    )
    data = found.to_xarray()
    assert {name: data[name].attrs.get("units") for name in measures} == {
        "hottest_cell_side": "degC",
        "squared": "K^2 s",
        "own": None,
    }
    assert found._repr_html_().count("<td>degC</td>") == 1
    assert [axes.get_xlabel() for axes in found.plot().axes] == ["°C", "K² s", ""]
    plt.close("all")


def test_every_measure_is_known_by_its_function():
    assert units_of({name: function for name, (function, _) in MEASURES.items()}) == {
        name: unit for name, (_, unit) in MEASURES.items()
    }


@pytest.mark.slow
def test_a_stall_and_a_failed_channel_end_with_the_cells_off(twin: Twin, pid: PID):
    """The last reading stands for silence; then the cells are off, for good."""
    lost = simulate_closed_loop(
        twin, pid, 45, duration=DURATION, failed_channels={"T14": 60.0}, noise=False
    )
    assert np.all(lost.duty[60:63] != 0)
    assert np.all(lost.measurement[60:] == lost.measurement[59])
    assert np.all(lost.duty[64:] == 0)
    stalled = simulate_closed_loop(twin, pid, 45, duration=DURATION, faults="stall=60/6")
    assert np.all(stalled.duty[64:] == 0)
    brief = simulate_closed_loop(twin, pid, 45, duration=DURATION, faults="stall=60/2,drop=0.3")
    assert np.all(brief.duty[70:] != 0)


@pytest.mark.slow
def test_recalibrations_are_those_of_the_virtual_rig(twin: Twin, pid: PID):
    conditions = scenario(twin, pid, 35, duration=DURATION, faults="jumps=60", noise=False, seed=5)
    # Frames of the virtual rig have the same: tests/live/test_virtual_rig.py.
    random = np.random.default_rng([5, 1])
    fast, slow = random.normal(0, 1.0), random.normal(0, 1.0)  # the rig file: 1 K, 10 s and 40 s
    assert not conditions.arrives[60]
    assert conditions.arrives[61]
    expected = fast * np.exp(-20 / 10) + slow * np.exp(-20 / 40)
    np.testing.assert_allclose(conditions.error[80], expected)
    np.testing.assert_array_equal(conditions.error[:60], 0)


@pytest.mark.slow
def test_noise_is_that_of_the_camera_s_zones(twin: Twin, pid: PID):
    conditions = scenario(twin, pid, 35, duration=3000)
    deviation = np.asarray(conditions.error).std(axis=0)
    pixels = 80 * 36 / 12  # of a zone; each has 0.1 K
    np.testing.assert_allclose(deviation[0], 0.1 / np.sqrt(pixels), rtol=0.1)


@pytest.mark.slow
def test_disturbances_warm_and_cool_the_plate(twin: Twin):
    hand = HeatInput(("V14", "V15"), 40, 80, 10.0)
    draught = Draught(("V14", "V15"), 40, 80, 40.0)
    off = PID(0.0)
    settings: dict[str, Any] = {"duration": DURATION, "noise": False, "initial": 40.0}
    still = simulate_closed_loop(twin, off, 30, **settings).run.node("V14")
    warm = simulate_closed_loop(twin, off, 30, disturbances=[hand], **settings).run.node("V14")
    cool = simulate_closed_loop(twin, off, 30, disturbances=[draught], **settings).run.node("V14")
    # The same until then, but for rounding: heat makes another compiled program.
    np.testing.assert_allclose(warm[:41], still[:41], rtol=0, atol=1e-10)
    assert 2 < (warm - still)[79] < 30
    assert -8 < (cool - still)[79] < -0.3
    room = simulate_closed_loop(twin, off, 30, ambient="0:16,40:26", **settings).run.node("V14")
    assert (room - still)[-1] > 1


@pytest.mark.slow
def test_a_delay_of_4_s_gives_the_readings_of_4_s_before(twin: Twin, pid: PID):
    settings: dict[str, Any] = {"duration": DURATION, "noise": False}
    late = simulate_closed_loop(twin, pid, 35, sensor_delay=4, **settings)
    np.testing.assert_allclose(late.measurement[4:], late.output[:-4], atol=1e-12)


@pytest.mark.slow
def test_a_slow_controller_has_steps_of_the_plant_between_its_samples(twin: Twin):
    slow = simulate_closed_loop(
        twin, PID(0.1, 0.001, sample_time_s=2.5), 35, duration=DURATION, noise=False
    )
    assert len(slow.time) == 48 * 3 + 1
    np.testing.assert_array_equal(slow.duty[0], slow.duty[2])
    again = jt.simulate(twin, slow.run.experiment)
    np.testing.assert_allclose(slow.run.temperatures, again.temperatures, atol=5e-3)


@pytest.mark.slow
def test_power_is_what_the_supply_gives(twin: Twin):
    """Half duty on both cells: half the current of a cell that is connected, from 12 V."""
    run = simulate_closed_loop(twin, lambda t, r, y: jnp.full(2, 0.5), 30, duration=DURATION)
    values = twin.values
    sides = [[run.run.node(f"P{cell}.{side}")[-1] for side in ("TC", "TH")] for cell in (1, 2)]
    duty = round(0.5 * 255) / 255
    for (cold, hot), power in zip(sides, run.power[-1], strict=True):
        emf = values["alpha"] * (hot - cold)
        current = (12 + emf) / (values["R_E"] + 0.1 + values["R_supply"])
        np.testing.assert_allclose(power, 12 * duty * current, rtol=1e-3)
    assert run.energy[-1] == pytest.approx(run.measures().loc["energy", "value"])


# Power of `printer-bed` at full duty, W: its tracks, switch and supply.
HEATER = 12.0**2 / (1.2 + 0.01 + 0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("delay", "lag"), [(0.0, 1e-9), (1.3, 2.0)])
def test_energy_is_the_integral_of_the_delayed_and_lagged_duty(delay: float, lag: float):
    """By hand: t - d - tau (1 - exp(-(t - d) / tau)). The delay is no multiple of the steps."""
    driver = {"delay": f"{delay} s", "lag": f"{lag} s"} if delay else {}
    run = simulate_closed_loop(
        bundled("printer-bed", driver),
        lambda time, reference, measurement: 0.8,
        30,
        duration=30.0,
        quantised=False,
    )
    late = np.maximum(run.time - delay, 0.0)
    power = 0.8 * HEATER * (1 - np.exp(-late / lag))
    np.testing.assert_allclose(run.power[1:, 0], power[1:], rtol=1e-9, atol=1e-9)
    expected = 0.8 * HEATER * (late - lag * (1 - np.exp(-late / lag)))
    np.testing.assert_allclose(run.energy, expected, rtol=0, atol=1e-3 * HEATER)


@pytest.mark.slow
def test_the_peak_of_a_short_pulse_lies_between_the_steps():
    """By hand: full duty for a second arrives at 1.3 s and decays from 2.3 s on; a lag of 2 s."""
    run = simulate_closed_loop(
        bundled("printer-bed", {"delay": "1.3 s", "lag": "2 s"}),
        lambda time, reference, measurement: jnp.where(time < 0.5, 1.0, 0.0),
        30,
        duration=30.0,
    )
    peak = HEATER * (1 - np.exp(-1 / 2.0))
    assert run.measures().loc["peak_power", "value"] == pytest.approx(peak, rel=1e-9)
    at_the_steps = HEATER * (1 - np.exp(-0.7 / 2.0))
    assert run.power.sum(axis=1).max() == pytest.approx(at_the_steps, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [2.0, 2.6])
def test_power_and_energy_are_those_of_the_run(twin: Twin, pid: PID, delay: float):
    """Two ways to the same rule: steps of one size, and any times and commands."""
    plant = twin.with_values({"t_delay": delay})
    run = simulate_closed_loop(plant, pid, "0:20,20:40", duration=DURATION, seed=2)
    np.testing.assert_allclose(run.power, run.run.power, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(run.energy, run.run.energy, rtol=1e-9, atol=1e-6)
    assert run.energy[-1] > 1000


@pytest.mark.slow
@pytest.mark.parametrize(
    ("references", "settings", "message"),
    [
        (200, {}, "expected .* to .* degC, which a duty of .* can hold, got 200.0 degC at 0 s"),
        ("0:35,600:45", {}, "expected times up to the end at 120 s, got 600 s"),
        ("10:35", {}, "expected times that begin at 0"),
        ("0:35/36", {}, "expected one temperature for all outputs, or one for each of the 1"),
        ("0:warm", {}, "expected 'time:temperature'"),
        ("ramp 0:35", {}, "expected a temperature at time 0 before a ramp or a curve"),
        ("0:20,slope 60:35", {}, "'ramp 600:45' or 'curve 600:45', .* got 'slope 60:35'"),
        ([1.0, 2.0], {}, "expected a number, text such as"),
        (35, {"duration": 0.5}, "expected a multiple of the controller's sample time"),
        (35, {"faults": "fail=P1@60"}, "expected drop, jumps and stall"),
        (35, {"sensor_delay": 0.3}, "expected a multiple of the step of the plant"),
        (35, {"failed_channels": {"T99": 1.0}}, "unknown channel 'T99'"),
        (35, {"disturbances": [Draught(("V99",), 0, 1, 1)]}, "unknown element 'V99'"),
        (35, {"silence": -1}, "silence: expected a number of at least 0, in s, got -1"),
        (35, {"initial": -300}, "initial: expected -273.15 degC and above, got -300 degC"),
        (
            35,
            {"ambient": "0:20,60:-300"},
            "ambient: expected -273.15 degC and above, got -300 degC",
        ),
    ],
)
def test_references_and_settings_that_do_not_fit_are_refused(
    twin: Twin, pid: PID, references: Any, settings: dict[str, Any], message: str
):
    with pytest.raises(ControlError, match=message):
        simulate_closed_loop(twin, pid, references, **{"duration": DURATION, **settings})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "expected draws or controller_draws, .* simulate_closed_loop simulates a single loop"),
        ({"draws": {}, "measures": ["energy"]}, "expected draws or controller_draws"),
        ({"draws": {"R_E": [2.0]}, "workers": 0}, "workers: expected a whole number above 0"),
        ({"controller_draws": {"Kx": [1.0]}}, "unknown parameter 'Kx'"),
        ({"draws": {"R_E": [1.0]}, "controller_draws": {"Kp": [1, 2]}}, "same number of draws"),
        ({"draws": {"R_E": [2.0]}, "measures": ["speed"]}, "unknown measure 'speed'"),
    ],
)
def test_draws_and_measures_that_do_not_fit_are_refused(
    twin: Twin, pid: PID, settings: dict[str, Any], message: str
):
    with pytest.raises(ControlError, match=f"^simulate_closed_loops: .*{message}"):
        simulate_closed_loops(twin, pid, 35, duration=DURATION, **settings)


@pytest.mark.parametrize(
    ("controller", "message"),
    [
        (PID(0.1, measured=["TAM", "TBM", "TCM"]), "2 cells, got a PID whose gains do not fit"),
        (PID([0.1, 0.1, 0.1]), "2 cells, got a PID whose gains do not fit"),
        (PID([[0.1], [0.1]]), "2 cells, got a PID whose gains do not fit"),
        (lambda *_: jnp.zeros(3), r"returns a duty, or 2 of them.* of shape \(3,\)"),
    ],
)
def test_a_controller_of_another_number_of_cells_is_refused(
    twin: Twin, controller: Any, message: str
):
    with pytest.raises(ControlError, match=message):
        simulate_closed_loop(twin, controller, 35, duration=DURATION)


@pytest.mark.parametrize(
    ("draws", "message"),
    [
        ({"Kp": [0.1, -1.0]}, r"draw 1: PID: Kp: expected finite numbers of at least 0, got -1\.0"),
        ({"Kp": [0.1, 0.1], "Ki": [[0.0, 0.0], [0.0, -2.0]]}, r"draw 1: PID: Ki: .* -2\.0\]"),
        ({"Kp": []}, r"Kp: expected finite numbers \(draws, \.\.\.\), got \[\]"),
        ({"Kp": [[0.1, 0.1, 0.1]]}, "2 cells, got a PID whose gains do not fit"),
    ],
)
def test_draws_of_a_controller_are_as_good_as_its_parameters(
    twin: Twin, pid: PID, draws: dict[str, Any], message: str
):
    with pytest.raises(ControlError, match=message):
        simulate_closed_loops(twin, pid, 35, duration=DURATION, controller_draws=draws)


def test_checks_are_made_with_the_median_of_the_valid_draws(twin: Twin):
    drawn = {"R_E": np.array([0.3, -1.0, 0.5]), "t_delay": np.array([1.0, 2.0, 3.0])}
    values = twin_at_medians(twin, drawn).values
    assert (values["R_E"], values["t_delay"]) == (0.4, 2.0)
    with pytest.raises(ParameterError, match=r"dual-cell: draw 0: .*R_E.* above 0, got -2"):
        simulate_closed_loops(twin, PID(0.1), 35, duration=DURATION, draws={"R_E": [-2.0, -1.0]})


def test_a_duty_that_does_not_stay_finite_ends_the_simulation(twin: Twin):
    with pytest.raises(SimulationError, match="do not stay finite"):
        simulate_closed_loop(twin, lambda time, *_: time * jnp.inf, 35, duration=DURATION)


def test_a_controller_slower_than_the_plate_is_refused(twin: Twin):
    with pytest.raises(ControlError, match="at most the rig's longest time constant"):
        simulate_closed_loop(twin, PID(0.1, sample_time_s=3000), 35, duration=6000)
