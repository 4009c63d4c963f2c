"""The twin: parameters in and out, transformations of JAX, derivatives, precision."""

import dataclasses
import inspect
from collections.abc import Callable, Iterable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxtwin
from jaxtwin import Experiment, load_rig
from jaxtwin.errors import ParameterError, RigError, SimulationError
from jaxtwin.physics import Twin
from jaxtwin.physics._wiring import wiring_of
from jaxtwin.rig import Channel, ZoneSensor


@eqx.filter_jit
def everything(twin: Twin) -> jax.Array:
    """A number that every parameter moves: rates of change and readings of an uneven state."""
    system = twin.system()
    nodes = jnp.arange(len(twin.netlist.nodes))
    ambient = system.ambient_temperature
    deviation = system.initial_temperature - ambient + 10 * jnp.cos(nodes)
    rate = system.heat_into_nodes(deviation, jnp.array([0.5, -0.3]), ambient) / system.capacitance
    late = sum(time for time in (system.lag, system.delay) if time is not None)
    drift = 0.0 if system.ambient_drift is None else 1e3 * system.ambient_drift
    return (
        jnp.sin(nodes) @ rate + 0.01 * system.channel_temperatures(deviation).sum() + late + drift
    )


@eqx.filter_jit
def rise_of_tam(twin: Twin) -> jax.Array:
    """Steady rise of TAM at half duty, K."""
    system = twin.system()
    deviation = system.steady_state(jnp.full(2, 0.5), system.ambient_temperature)
    return system.channel_temperatures(deviation)[twin.channels.index("TAM")]


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("dual-cell")


def test_values_of_the_table_unless_others_are_given():
    rig = load_rig("paper-2024")
    twin = Twin(rig, {"R_E": 1.5, "C_esp": 1300})
    assert list(twin.values) == list(rig.parameters)
    assert float(twin.values["R_E"]) == 1.5
    assert float(twin.values["C_esp"]) == 1300.0
    assert float(twin.values["R_pc"]) == 0.09


def test_a_plate_of_more_elements_than_a_twin_can_have_is_refused():
    """Before tables of all pairs of 40 000 nodes fill the memory."""
    rig = load_rig("dual-cell")
    plate = dataclasses.replace(rig.plate, columns=(1e-3,) * 200, rows=(1e-3,) * 200)
    with pytest.raises(
        RigError, match=r"dual-cell.toml .*at most 4000 elements in a twin, got 40000"
    ):
        Twin(dataclasses.replace(rig, plate=plate)).channels  # noqa: B018 - asks for the network


def test_new_values_leave_the_old_twin_alone(twin):
    other = twin.with_values({"R_E": 2.5})
    assert (float(other.values["R_E"]), float(twin.values["R_E"])) == (2.5, 1.97)
    assert other.rig is twin.rig


def test_parameter_sets_are_values_for_a_twin():
    rig = load_rig("paper-2024")
    published = Twin(rig, rig.parameter_sets["published"])
    assert float(published.values["R_E"]) == 0.01
    assert float(published.values["alpha"]) == pytest.approx(0.05077, abs=1e-5)


def test_temperatures_are_given_in_the_unit_of_the_table():
    assert Twin("paper-2024", {"T_amb": 20.0}).numbers_si["T_amb"] == 293.15


def test_unknown_parameter_is_refused_with_those_that_are_known():
    with pytest.raises(ParameterError, match="unknown parameter 'R_e', did you mean 'R_E'"):
        Twin("dual-cell", {"R_e": 2.0})


def test_a_parameter_file_gives_its_values(tmp_path):
    path = tmp_path / "fit.toml"
    path.write_text('[parameters]\nR_E = { value = 2200.0, unit = "mohm" }\n', "utf-8")
    for twin in (Twin("dual-cell", path), Twin("dual-cell").with_values(str(path))):
        assert float(twin.values["R_E"]) == pytest.approx(2.2)
    with pytest.raises(ParameterError, match="cannot be read"):
        Twin("dual-cell", tmp_path / "none.toml")


@pytest.mark.parametrize("name", ["publishd", "published"])
def test_the_name_of_a_parameter_set_is_answered_with_the_sets(name):
    words = r"no such file; did you mean rig\.parameter_sets\['published'\]\? Parameter sets .*, "
    with pytest.raises(ParameterError, match=words):
        Twin("paper-2024", name)


def test_a_schedule_in_words_needs_a_duration(twin):
    """It is the experiment that `Experiment.schedule` makes of it."""
    run = twin.simulate("0:0.3/0.2,5:0.5", duration=10.0)
    same = Experiment.schedule("0:0.3/0.2,5:0.5", duration=10.0, cells=2)
    assert run.experiment == same
    with pytest.raises(
        SimulationError, match=r"expected a duration beside the schedule '0:0.3', got none"
    ):
        twin.simulate("0:0.3")
    with pytest.raises(SimulationError, match=r"got 10.0 beside an experiment"):
        twin.simulate(same, duration=10.0)


def test_the_method_takes_the_keywords_of_the_function(twin):
    own = dict(inspect.signature(Twin.simulate).parameters)
    assert own.pop("duration").default is None
    given = inspect.signature(jaxtwin.simulate).parameters
    assert list(own)[2:] == list(given)[2:]
    assert all(own[name].default == given[name].default for name in list(given)[2:])
    run = twin.simulate("0:0.3", duration=10.0, initial=30.0)
    np.testing.assert_allclose(run.states[0], 30.0)


def test_unknown_parameter_of_a_changed_twin_is_refused(twin):
    with pytest.raises(ParameterError, match="unknown parameter 'R_Tfx'"):
        twin.with_values({"R_Tfx": 2.0})


@pytest.mark.parametrize(
    "value",
    [np.nan, np.inf, -np.inf, np.array([1.0, np.nan]), jnp.array(jnp.inf), "2.0", None, 2j, True],
    ids=repr,
)
def test_what_is_no_finite_number_is_refused(twin, value):
    with pytest.raises(
        ParameterError, match=r"dual-cell: parameter R_E: expected finite numbers, got"
    ):
        twin.with_values({"R_E": value})


def test_unknown_cell_is_refused(twin):
    with pytest.raises(ParameterError, match="expected one of the cells P1, P2, got 'P3'"):
        twin.module("P3")


def test_module_of_a_cell_has_the_twin_s_values(twin):
    module = twin.with_values({"R_E": 2.25}).module("P2")
    assert float(module.electrical_resistance) == 2.25
    assert float(module.seebeck_coefficient) == 0.0508
    assert module.optimum_current(290.0) == pytest.approx(0.0508 * 290 / 2.25)


def test_new_values_compile_nothing_anew(twin):
    """The values are leaves, the rig is static."""
    traces = []

    @jax.jit
    def traced(twin: Twin) -> jax.Array:
        traces.append(twin)
        return twin.system().capacitance

    for value in (300.0, 400.0, 410):
        traced(twin.with_values({"c_copper": value}))
    traced(Twin("dual-cell"))  # read again: another rig object with the same contents
    assert len(traces) == 1


@pytest.mark.slow
def test_draws_in_one_call_equal_draws_one_by_one(twin, float64):
    """vmap over a twin whose parameters hold draws."""
    draws = np.random.default_rng(0).uniform(1.5, 2.5, 5)
    batch = jax.vmap(lambda R_E: everything(twin.with_values({"R_E": R_E})))(draws)
    single = [float(everything(twin.with_values({"R_E": R_E}))) for R_E in draws]
    np.testing.assert_allclose(batch, single, rtol=1e-12)
    assert np.ptp(single) > 0.01


def slopes(function: Callable[[Twin], jax.Array], twin: Twin, names: Iterable[str]) -> list[float]:
    """Central differences, one parameter at a time."""
    found = []
    for name in names:
        at = float(twin.values[name])
        step = 1e-5 * abs(at) or 0.1
        above, below = (twin.with_values({name: at + way * step}) for way in (1, -1))
        found.append(float(function(above) - function(below)) / (2 * step))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "derivative"), [("paper-2024", jax.grad), ("dual-cell", jax.jacfwd)]
)
def test_derivatives_equal_finite_differences_in_every_parameter(name, derivative, float64):
    """Backward and forward; the camera's zones moved, as their weights have second derivatives that
    jump where an edge of a zone is half a pixel beside the plate's outline."""
    twin = Twin(name)
    moved = {"d_x": 1.3, "d_y": -0.7, "s_view": 1.01, "r_view": 0.4}
    twin = twin.with_values({key: value for key, value in moved.items() if key in twin.values})
    values = {name: jnp.asarray(value) for name, value in twin.values.items()}

    def of_values(values: dict[str, jax.Array]) -> jax.Array:
        return everything(twin.with_values(values))

    expected = slopes(everything, twin, values)
    assert np.abs(expected).min() > 1e-8, "every parameter takes part"
    found = jax.jit(derivative(of_values))(values)
    np.testing.assert_allclose([found[name] for name in values], expected, rtol=1e-5, atol=1e-9)


@pytest.mark.slow
def test_slopes_of_a_steady_state_equal_finite_differences(float64):
    """Newton's iterations are differentiated through, on a circuit whose symmetry gives it equal
    eigenvalues."""
    twin = Twin("paper-2024")
    names = ("R_E", "R_pc", "R_Tez2", "R_ph", "alpha")
    values = {name: jnp.asarray(twin.values[name]) for name in names}
    found = jax.jit(jax.jacfwd(lambda values: rise_of_tam(twin.with_values(values))))(values)
    expected = slopes(rise_of_tam, twin, names)
    np.testing.assert_allclose([found[name] for name in names], expected, rtol=1e-5)


def test_precision_is_the_caller_s_and_values_keep_theirs(twin):
    """Nothing switches float64 on behind one's back; float32 is good for the usual five digits."""
    assert all(np.asarray(value).dtype == np.float64 for value in twin.values.values())
    assert eqx.filter_eval_shape(twin.system).conductance.dtype == jnp.float32
    single = everything(twin)
    assert single.dtype == jnp.float32
    with jax.enable_x64(True):
        double = everything(twin)
        assert double.dtype == jnp.float64
    assert float(single) == pytest.approx(float(double), rel=1e-5)


def test_twin_prints_what_it_is(twin):
    assert repr(twin) == "<Twin of dual-cell: 49 parameters>"


def test_wiring_is_equal_for_rigs_of_equal_content_only():
    """Compiled code is shared by equal wirings, so nothing that it depends on may be left out.

    A circuit given link by link does not show how high its rows are, a zone's weights do.
    """
    rig = load_rig("paper-2024")
    zone = Channel("zone", ZoneSensor((0.0, 0.1), (0.0, 0.05)))
    rig = dataclasses.replace(rig, channels=(zone,))
    same = dataclasses.replace(rig, title="another title")
    taller = dataclasses.replace(rig.plate, rows=(0.03, 0.05, 0.035))
    other = dataclasses.replace(rig, plate=taller)
    assert wiring_of(rig) == wiring_of(same)
    assert hash(wiring_of(rig)) == hash(wiring_of(same))
    assert wiring_of(rig) != wiring_of(other)
    assert wiring_of(rig).channel_weights.tolist() != wiring_of(other).channel_weights.tolist()


def test_a_value_is_read_by_its_name() -> None:
    twin = Twin("tclab")
    assert twin["R_1"] == twin.values["R_1"]
    with pytest.raises(ParameterError, match=r"tclab: unknown parameter 'R_loss'.* Known: C_1, "):
        twin["R_loss"]
