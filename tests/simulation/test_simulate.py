"""What a run starts from, what drives it, and what it refuses."""

import numpy as np
import pytest
from scipy.optimize import root

from jaxtwin import Experiment, Twin
from jaxtwin._compilation import clear_programs
from jaxtwin.errors import ParameterError, SimulationError
from jaxtwin.simulation._simulate import prepare_simulation, run_exponential

TIME = np.arange(61.0)
DUTY = np.where(TIME < 20, 0.5, 0.8)[:, None] * np.array([1.0, -0.5])
EXPERIMENT = Experiment(TIME, DUTY)


@pytest.fixture(scope="module")
def twin(twins) -> Twin:
    return twins["startup"]


@pytest.fixture(scope="module")
def from_rig(twin):
    """As the rig says: plate at 15 degC, cells at 298 K."""
    return twin.simulate(EXPERIMENT)


def test_rig_s_own_start(from_rig, circuits):
    np.testing.assert_allclose(from_rig.states[0], circuits["startup"].start() - 273.15, atol=1e-9)


@pytest.mark.slow
def test_uniform_start(twin, circuits):
    run = twin.simulate(EXPERIMENT, initial=21.0)
    np.testing.assert_allclose(run.states[0], 21.0, atol=1e-9)
    start = np.full(28, 21 + 273.15)
    expected = circuits["startup"].solve(TIME, DUTY, start=start)
    np.testing.assert_allclose(run.states, expected, atol=1e-3)


@pytest.mark.slow
def test_each_node_s_own_start(twin, circuits):
    """Nothing about it is symmetric, so mirror images must not be solved as one."""
    start = np.random.default_rng(0).uniform(10, 30, 28)
    run = twin.simulate(EXPERIMENT, initial=start)
    np.testing.assert_allclose(run.states[0], start, atol=1e-9)
    expected = circuits["startup"].solve(TIME, DUTY, start=start + 273.15)
    np.testing.assert_allclose(run.states, expected, atol=1e-3)


def test_rig_s_start_node_by_node_gives_the_rig_s_run(twin, from_rig):
    """All 28 nodes one by one, against mirror images solved as one."""
    run = twin.simulate(EXPERIMENT, initial=from_rig.states[0])
    np.testing.assert_allclose(run.states, from_rig.states, atol=1e-9)


def test_steady_start_stays_where_it_is(twin, circuits):
    """At rest under the first input: scipy's root of the authors' circuit, unmoved until the
    switch."""
    run = twin.simulate(EXPERIMENT, initial="steady")
    circuit = circuits["startup"]
    rest = root(lambda T: circuit.rate(T, DUTY[0], 288.15) * circuit.C, circuit.start(), tol=1e-12)
    assert rest.success
    np.testing.assert_allclose(run.states[:21], np.tile(rest.x - 273.15, (21, 1)), atol=1e-7)
    assert np.abs(run.states[-1] - run.states[0]).max() > 1


def test_start_and_ambient_of_the_rig_are_parameters(twin):
    """Twin with other T_start and T_amb, no power: plate and surroundings as given."""
    other = twin.with_values({"T_start": 30.0, "T_amb": 5.0})
    run = other.simulate(Experiment(TIME, 0 * DUTY))
    assert run.node("V11")[0] == pytest.approx(30.0)
    # Every node lies between its surroundings and the warmest start, and they all cool.
    assert run.states[1:].min() > 5.0
    assert (run.states[-1] < run.states[0]).all()


def test_constant_recorded_ambient_takes_the_place_of_the_rig_s(twin):
    """The same run as with T_amb itself."""
    recorded = twin.simulate(Experiment(TIME, DUTY, ambient=22.0))
    own = twin.with_values({"T_amb": 22.0}).simulate(EXPERIMENT)
    np.testing.assert_allclose(recorded.states, own.states, atol=1e-9)
    np.testing.assert_allclose(recorded.temperatures, own.temperatures, atol=1e-9)


def test_recorded_ambient_series(twin, circuits):
    """Held from sample to sample, against scipy; the start "steady" is at rest in its first
    value."""
    ambient = 15 + 5 * np.sin(TIME / 9).round(1)
    experiment = Experiment(TIME, DUTY, ambient=ambient)
    expected = circuits["startup"].solve(TIME, DUTY, ambient=ambient)
    np.testing.assert_allclose(twin.simulate(experiment).states, expected, atol=1e-3)


@pytest.mark.slow
def test_gain_acts_on_the_rise_above_the_recorded_ambient():
    """reading = ambient + gain (T - ambient), each at its own time."""
    ambient = 15 + 5 * np.sin(TIME / 9).round(1)
    experiment = Experiment(TIME, DUTY, ambient=ambient, channels=("TBM", "TAM"))
    true = Twin("dual-cell", {"g_TAM": 1.0}).simulate(experiment).channel("TAM")
    read = Twin("dual-cell", {"g_TAM": 0.8}).simulate(experiment).channel("TAM")
    assert np.ptp(true) > 10
    np.testing.assert_allclose(read, ambient + 0.8 * (true - ambient), atol=1e-9)


def test_time_need_not_start_at_zero(twin, from_rig):
    """Also seconds since 1970, whose last bit is a quarter of a microsecond."""
    for start, limit in ((-40.0, 1e-9), (1e5, 1e-9), (1.7e9, 1e-5)):
        run = twin.simulate(Experiment(TIME + start, DUTY))
        np.testing.assert_allclose(run.states, from_rig.states, atol=limit)


def test_more_samples_of_the_same_inputs_give_the_same_run(twin, from_rig):
    """Inputs are held, so a run depends on when they change and not on who looks when."""
    time = np.arange(0, 60.25, 0.25)
    duty = DUTY[np.minimum(time, 60).astype(int)]
    run = twin.simulate(Experiment(time, duty))
    np.testing.assert_allclose(run.states[::4], from_rig.states, atol=1e-9)


def test_duty_of_the_last_sample_does_not_count(twin, from_rig):
    """It is held from the last sample on, when the run is over."""
    duty = DUTY.copy()
    duty[-1] = -1.0
    run = twin.simulate(Experiment(TIME, duty))
    np.testing.assert_allclose(run.states, from_rig.states, atol=1e-6)


def test_channels_that_the_experiment_names_in_its_order(twin, from_rig):
    run = twin.simulate(Experiment(TIME, DUTY, channels=("TCM", "T11")))
    assert run.channels == ("TCM", "T11")
    assert run.temperatures.shape == (61, 2)
    np.testing.assert_array_equal(run.channel("T11"), from_rig.channel("T11"))
    np.testing.assert_array_equal(run.temperatures[:, 0], from_rig.channel("TCM"))


def test_all_channels_where_the_experiment_names_none(twin, from_rig):
    """Section 7 of circuit.md: single nodes, but TBM, the mean of V24 and V25."""
    assert from_rig.channels == twin.channels
    assert len(from_rig.channels) == 15
    nodes = {"T11": "V11", "T16": "V18", "T22": "V33", "TAM": "V22", "TCM": "V27"}
    for channel, node in nodes.items():
        np.testing.assert_allclose(from_rig.channel(channel), from_rig.node(node), atol=1e-9)
    mean = (from_rig.node("V24") + from_rig.node("V25")) / 2
    np.testing.assert_allclose(from_rig.channel("TBM"), mean, atol=1e-9)


def test_mirror_images_of_the_circuit_stay_equal(from_rig):
    """circuit.md section 10: row 3 repeats row 1, so T1j = T2j in simulation."""
    for column in range(1, 9):
        top, bottom = from_rig.node(f"V1{column}"), from_rig.node(f"V3{column}")
        np.testing.assert_allclose(top, bottom, atol=1e-9)


def test_a_run_of_more_steps_than_memory_holds_is_refused(twin):
    """A year in one piece is the most; a century would be a hundred million steps."""
    century = Experiment([0.0, 3.2e9], np.zeros((2, 2)), name="century")
    with pytest.raises(
        SimulationError, match=r"century: expected at most 3.2e\+07 s, got 3.2e\+09 s"
    ):
        twin.simulate(century)


@pytest.mark.parametrize("cells", [1, 3])
def test_wrong_number_of_cells_is_refused(twin, cells):
    experiment = Experiment(TIME, np.zeros((61, cells)), name="zone-A")
    message = f"zone-A: duty: expected the 2 cells of paper-2024, got {cells}"
    with pytest.raises(SimulationError, match=message):
        twin.simulate(experiment)


def test_unknown_channels_are_refused(twin):
    experiment = Experiment(TIME, DUTY, channels=("T11", "T31"))
    with pytest.raises(SimulationError, match=r"the experiment: channels: .*T11.* got T31"):
        twin.simulate(experiment)


@pytest.mark.parametrize(
    "initial",
    ["rest", [15.0, 16.0], np.zeros((28, 1)), np.nan, np.inf, np.full(28, np.nan)],
    ids=["word", "two", "matrix", "nan", "inf", "nans"],
)
def test_impossible_start_is_refused(twin, initial):
    with pytest.raises(SimulationError, match=r'initial: expected None, "steady".* got'):
        twin.simulate(EXPERIMENT, initial=initial)


@pytest.mark.parametrize("value", [-2.0, 0.0])
@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("R_E", "electrical resistance of P1"),
        ("R_pc", "resistance V23 - P1.TC"),
        ("R_Tez", "resistance V12 - ambient"),
        ("R_Th", "resistance P1.TC - P1.TH"),
        ("C_element", "capacitance of V11"),
    ],
)
def test_resistance_or_heat_capacity_not_above_zero_is_refused(twin, name, what, value):
    """Some of them would give finite temperatures, which mean nothing."""
    message = rf"paper-2024: {what} \({name}\): expected a value above 0, got {value:g} in SI units"
    with pytest.raises(ParameterError, match=message):
        twin.with_values({name: value}).simulate(EXPERIMENT)


@pytest.mark.parametrize(("name", "what"), [("t_lag", "lag"), ("t_delay", "delay")])
def test_a_driver_ahead_of_its_command_is_refused(name, what):
    message = (
        rf"dual-cell: {what} of the driver \({name}\): expected a value above 0, got -3 in SI units"
    )
    with pytest.raises(ParameterError, match=message):
        Twin("dual-cell", {name: -3.0}).simulate(EXPERIMENT)


def test_several_values_of_a_parameter_are_refused(twin):
    """Draws go to `simulate_batch`."""
    with pytest.raises(ParameterError, match=r"parameter R_E: expected one value, got 3"):
        twin.with_values({"R_E": np.array([1.9, 2.0, 2.1])}).simulate(EXPERIMENT)


@pytest.mark.slow
def test_temperatures_that_overflow_are_an_error(twin):
    """A start beyond all measure, whose square is no number any more."""
    with pytest.raises(SimulationError, match=r"paper-2024: .* do not stay finite"):
        twin.with_values({"T_start": 1e200}).simulate(EXPERIMENT)


def test_a_prepared_simulation_compiles_nothing_more(twin):
    """Whatever the values are with which the twin is simulated in the end."""
    clear_programs()
    prepare_simulation(twin, EXPERIMENT)
    assert len(run_exponential._programs) == 1
    twin.with_values({"R_E": 2.2}).simulate(EXPERIMENT)
    assert len(run_exponential._programs) == 1


def test_temperatures_are_read_by_the_name_of_a_channel_or_node() -> None:
    plan = Experiment.schedule("0:0.3", duration=10, cells=2)
    run = Twin("tclab").simulate(plan)
    np.testing.assert_array_equal(run["T2"], run.temperatures[:, 1])
    np.testing.assert_array_equal(run["H1"], run.states[:, run.nodes.index("H1")])
    with pytest.raises(SimulationError, match=r"unknown channel or node 'T_pcb'. Known: T1, T2, H"):
        run["T_pcb"]
