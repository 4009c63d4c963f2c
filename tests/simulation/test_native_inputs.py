"""Inputs besides the duty in draws by `rodas5p.c`: against SciPy, the physics and the programs of
JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from boxes import box, box_table, by_radau
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtwin import Experiment, Twin, reduce_batch, simulate_batch
from jaxtwin.rig import rig_from_tables
from jaxtwin.simulation._initial import checked_initial
from jaxtwin.simulation._native_chunk import native_run
from jaxtwin.simulation._native_library import VARIABLE
from jaxtwin.simulation._native_network import native_network, pack_draws
from jaxtwin.simulation._native_steps import commanded_steps
from jaxtwin.simulation._reductions import REDUCTIONS, ReductionName

pytestmark = pytest.mark.c_compiler

SCHEDULES = {
    "lid": "0:0,150:1,300:0,620:1",
    "fan": "0:1,250:0,500:2.5",
    "V_supply": "0:12,100:11,450:12.5",
    "T_water": "0:20,350:35",
}


def experiment() -> Experiment:
    return Experiment.schedule(
        "0:0.5,200:0,400:-0.3", duration=900, step=5, ambient=20.0, inputs=SCHEDULES
    )


def is_native(twin: Twin, run: Experiment) -> bool:
    columns = np.arange(len(twin.channels))
    start = checked_initial(twin, None)
    found = native_run(
        twin, run, start, columns, 0,
        own_delays=False, samples="all", reductions=(), with_plate=False,
    )  # fmt: skip
    return found is not None


@pytest.mark.slow
def test_draws_with_all_inputs_are_those_of_scipy():
    twin = Twin(box())
    values = {"R_open": np.array([0.15, 0.05, 1.0]), "R_air": np.array([0.8, 0.3, 2.0])}
    assert is_native(twin, experiment())
    found = simulate_batch(twin, experiment(), values)
    nodes = [[node.name for node in twin.netlist.nodes].index(name) for name in ("V12", "air")]
    for number, temperatures in enumerate(found):
        draw = twin.with_values({name: row[number] for name, row in values.items()})
        exact = by_radau(draw, experiment())[:, nodes]
        np.testing.assert_allclose(temperatures, exact, rtol=0, atol=3e-4)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_reductions_with_inputs_are_those_of_jax(precision, monkeypatch):
    """With a recording, a room that changes, a voltage that does at every sample, and a draw that
    is invalid; energy by JAX takes temperatures to be linear between samples."""
    twin = Twin(box())
    time = np.arange(301.0)
    steps = Experiment(
        time,
        np.where(time < 150, 0.6, -0.4),
        channels=twin.channels,
        temperatures=20 + np.stack([time / 30, time / 60], axis=1),
        ambient=20 + np.where(time < 100, 0.0, 1.5),
        inputs={
            "lid": np.where((time > 60) & (time < 90), "open", "closed"),
            "fan": 1.0,
            "V_supply": 12 + 0.1 * np.sin(time),
            "T_water": 20.0,
        },
    )
    draws = {"R_open": np.array([0.1, 0.2, -1.0, 0.4]), "R_air": np.linspace(0.5, 1, 4)}
    names: list[ReductionName] = list(REDUCTIONS)
    found = reduce_batch(twin, steps, draws, names, precision=precision)
    out = np.empty((4, 301, 2), precision)
    whole = simulate_batch(twin, steps, draws, precision=precision, out=out)
    monkeypatch.setenv(VARIABLE, "off")
    other = reduce_batch(twin, steps, draws, names, precision=precision)
    assert found.failed.tolist() == other.failed.tolist() == [False, False, True, False]
    for name in names:
        assert found[name].dtype == other[name].dtype
        assert np.isnan(found[name][2]).all()
        np.testing.assert_allclose(found[name], other[name], rtol=2e-3, atol=2e-3)
    np.testing.assert_array_equal(found["maximum"], whole.max(axis=1))


@pytest.mark.slow
@pytest.mark.parametrize(
    "rig", ["heated-box", pytest.param("battery-pack", marks=pytest.mark.long)]
)
def test_draws_of_bundled_rigs_with_inputs_are_those_of_jax(rig, monkeypatch):
    twin = Twin(rig)
    time = np.arange(0.0, 1201.0, 2.0)
    inputs = {
        "heated-box": {"lid": np.where(time < 600, "closed", "open"), "fan": 0.3 + time / 1200},
        "battery-pack": {"T_coolant": 20 + 5 * np.sin(time / 90), "flow": 0.3 + time / 1200},
    }[rig]
    run = Experiment(time, np.full((len(time), len(twin.wiring.cold)), 0.6), inputs=inputs)
    draws = {
        name: np.full(9, twin.values[name]) * np.linspace(0.7, 1.4, 9)
        for name in list(twin.rig.parameters)[1:6]
    }
    assert is_native(twin, run)
    found = simulate_batch(twin, run, draws)
    monkeypatch.setenv(VARIABLE, "off")
    np.testing.assert_allclose(found, simulate_batch(twin, run, draws), rtol=0, atol=6e-4)


@pytest.mark.slow
def test_inputs_that_change_while_the_driver_has_a_delay_stay_with_jax():
    """Their changes would come within steps, which move with the delay."""
    table = box_table()
    table["driver"] |= {"lag": "1 s", "delay": "7 s"}
    twin = Twin(rig_from_tables(table, "box"))
    assert not is_native(twin, experiment())
    assert is_native(twin, experiment().with_inputs(lid=1.0, fan=0.5, V_supply=11.0, T_water=25.0))


@pytest.mark.slow
def test_a_draw_whose_resistance_in_any_state_is_not_above_0_fails(monkeypatch):
    """Whether or not the lid is ever opened."""
    twin, closed = Twin(box()), experiment().with_inputs(lid=0.0)
    draws = {"R_open": np.array([0.1, -0.1])}
    for setting in ("", "off"):
        monkeypatch.setenv(VARIABLE, setting)
        assert reduce_batch(twin, closed, draws, ["final"]).failed.tolist() == [False, True]


LEVELS = st.tuples(st.floats(0, 1), st.floats(0, 3), st.floats(5, 20), st.floats(5, 60))


@pytest.mark.slow
@given(LEVELS, st.floats(0.05, 5.0), st.floats(-10, 10), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_the_numbers_under_any_inputs_are_those_of_the_physics(levels, resistance, room, seed):
    """What `apply_inputs` of `rodas5p.c` does, followed in NumPy, gives the heat that
    `System.under` does at any temperatures of the nodes."""
    twin = Twin(box()).with_values({"R_open": resistance})
    system = twin.system(lumped=True)
    network = native_network(system.wiring)
    table, inputs, order = network.elimination, network.inputs, network.elimination.order
    at = np.array([*levels[:3], levels[3] + 273.15])
    with jax.enable_x64(True):
        grid = commanded_steps(experiment(), False, 0, system.wiring.inputs_and_effects)
        draws = {"R_open": np.array([resistance])}
        packed = pack_draws(twin, draws, grid.summary(), None, False)
        numbers = np.array(packed)[:, 0]
        system = twin.system(lumped=True)
        under = system.under(system.conditions(jnp.asarray(at)))
        factors = np.asarray(inputs.of_draw(system)) * inputs.of_steps(at[None])[0]
        x = np.random.default_rng(seed).normal(0, 30, len(order))
        reference = jnp.asarray(293.15)
        rest = (jnp.zeros(1), reference, jnp.asarray(room))
        whole = np.asarray(under.heat_into_nodes(jnp.asarray(x), *rest))
        expected = whole - _heat_of_cells(under, x, reference)
        voltage = float(np.asarray(under.bridge.supply_voltage))
    changes = np.add.reduceat(factors, inputs.effect_term[:-1])
    which = np.repeat(np.arange(len(changes)), np.diff(inputs.effect_number))
    np.add.at(numbers, inputs.changed_number, np.array(inputs.changed_sign) * changes[which])
    nodes, entries = len(order), len(table.column)
    parts = np.split(numbers[5:], np.cumsum([entries, nodes, nodes, 1, nodes, nodes, 1, 1, 1]))
    conductance, _, to_ambient, held, to_held, _, _, _, supply, *_ = parts
    matrix = np.zeros((nodes, nodes))
    matrix[np.repeat(np.arange(nodes), np.diff(table.row)), table.column] = conductance
    heat = to_ambient * room + held * to_held - matrix @ x[order]
    np.testing.assert_allclose(heat, expected[order], rtol=1e-9, atol=1e-7)
    assert supply[0] == pytest.approx(voltage, rel=1e-12)


def _heat_of_cells(system, x, reference):
    """The heat that the cells at rest, shorted by their bridges, move into each node."""
    wiring, found = system.wiring, np.zeros(len(x))
    sides = np.concatenate([wiring.cold, wiring.hot])
    heat = system.cell_heat(reference + x[sides], jnp.zeros(len(wiring.cold)))
    found[wiring.cold] -= np.asarray(heat.cold)
    found[wiring.hot] += np.asarray(heat.hot)
    return found
