"""Faults change the equations as the parameter of the rig file that stands for them would."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hand_rig import hand_rig
from heated_box import heated_box

from jaxtwin import Twin
from jaxtwin.errors import SimulationError
from jaxtwin.physics import FAULT_MODELS, Fault, System, TimedFault
from jaxtwin.rig import Value
from jaxtwin.simulation import Stepper

EXAMPLES = {
    "loosen": ("P1", 10.0),
    "fail": ("P1", 1.0),
    "age": ("P1", 1.3),
    "fade": ("P1", 0.8),
    "reverse": ("P1", 1.0),
    "block": ("P1", 3.0),
    "weaken": ("supply", 0.8),
    "leak": ("plate", 2.0),
    "load": ("plate", 1.5),
    "gain": ("T11", 0.9),
    "cover": ("T11", 0.5),
    "offset": ("T11", 0.5),
    "swap": ("T11+T16", 1.0),
    "move": ("x", 2e-3),
    "delay": ("command", 1.0),
    "change": ("h_A", 2.0),
}

# Models whose size is 0, not 1, where there is no fault.
SHARES = ("fail", "reverse", "cover", "offset", "swap", "move", "delay")

# Models that change nothing at rest.
UNSEEN = ("load", "delay")


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin("dual-cell")


def fault(twin: Twin, model: str, *changes: Any) -> Fault:
    part, size = changes or EXAMPLES[model]
    return FAULT_MODELS[model](twin, part, size)


def system_of(twin: Twin) -> System:
    with jax.enable_x64(True):
        return eqx.filter_jit(Twin.system)(twin)


def changed(twin: Twin, fault: Fault) -> System:
    with jax.enable_x64(True):
        return fault(system_of(twin))


def heat(system: System, *duty: float) -> np.ndarray:
    """The heat out of the near sides of two cells at some temperatures, W."""
    with jax.enable_x64(True):
        sides = jnp.array([300.0, 310.0, 305.0, 300.0])
        return np.asarray(system.cell_heat(sides, jnp.array(duty)).cold)


def assert_equal(one: System, other: System) -> None:
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("model", EXAMPLES)
def test_a_fault_is_float64_also_where_jax_is_set_to_float32(twin: Twin, model: str):
    """Outside of `jax.enable_x64` an array of JAX would be rounded to 24 bits."""
    outside = fault(twin, model)(system_of(twin))
    inside = changed(twin, fault(twin, model))
    for one, other in zip(jax.tree.leaves(outside), jax.tree.leaves(inside), strict=True):
        assert np.asarray(one).dtype == np.asarray(other).dtype
        np.testing.assert_array_equal(one, other)


def test_a_channel_of_another_gain_is_one_of_that_parameter(twin: Twin):
    other = twin.with_values({"g_T12": float(twin.values["g_T12"]) * 0.9})
    assert_equal(changed(twin, fault(twin, "gain", "T12", 0.9)), system_of(other))


def test_a_weak_supply_is_one_of_a_lower_voltage(twin: Twin):
    driver = replace(twin.rig.driver, supply_voltage=Value(9.6))
    other = Twin(replace(twin.rig, driver=driver))
    weak = changed(twin, fault(twin, "weaken"))
    lower, healthy = heat(system_of(other), 0.5, -0.7), heat(system_of(twin), 0.5, -0.7)
    np.testing.assert_allclose(heat(weak, 0.5, -0.7), lower, rtol=1e-6)
    of_one = heat(changed(twin, fault(twin, "weaken", "P2", 0.8)), 0.5, -0.7)
    np.testing.assert_allclose(of_one, [healthy[0], lower[1]], rtol=1e-6)


def test_an_aged_cell_is_one_of_a_higher_resistance():
    twin = Twin("single-cell")
    other = twin.with_values({"R_E": float(twin.values["R_E"]) * 1.3})
    assert_equal(changed(twin, fault(twin, "age", "P1", 1.3)), system_of(other))


@pytest.mark.slow
def test_a_changed_parameter_is_one_of_another_value(twin: Twin):
    other = twin.with_values({"R_E": float(twin.values["R_E"]) * 1.3})
    assert_equal(changed(twin, fault(twin, "change", "R_E", 1.3)), system_of(other))


def test_a_faded_cell_is_one_of_a_lower_seebeck_coefficient():
    twin = Twin("single-cell")
    other = twin.with_values({"alpha": float(twin.values["alpha"]) * 0.8})
    assert_equal(changed(twin, fault(twin, "fade", "P1", 0.8)), system_of(other))


def test_a_reversed_cell_cools_with_the_current_that_should_heat(twin: Twin):
    """The heat of the leads' ends swapped is that of the opposite duty."""
    wrong = heat(changed(twin, fault(twin, "reverse", "P1", 1.0)), 0.5, 0.5)
    np.testing.assert_allclose(wrong, heat(system_of(twin), -0.5, 0.5), rtol=1e-6)


def test_half_of_the_strings_of_a_cell_have_twice_its_resistance(twin: Twin):
    half = changed(twin, fault(twin, "fail", "P1", 0.5)).module.electrical_resistance
    before = system_of(twin).module.electrical_resistance
    np.testing.assert_allclose(half, np.asarray(before) * [2.0, 1.0], rtol=1e-6)


def test_the_draught_on_a_box_is_one_of_a_lower_resistance_to_the_room():
    twin = Twin(heated_box())
    leak = changed(twin, fault(twin, "leak", "wall", 3.0))
    before = system_of(twin)
    wall = twin.netlist.index["wall"]
    np.testing.assert_allclose(leak.ambient_conductance[wall], 3 / 1.5, rtol=1e-6)
    added = np.asarray(leak.conductance) - np.asarray(before.conductance)
    assert np.flatnonzero(added).tolist() == [wall * (len(added) + 1)]
    np.testing.assert_allclose(added[wall, wall], 2 / 1.5, rtol=1e-6)


def test_a_draught_on_everything_leaves_the_sinks_alone(twin: Twin):
    leak, before = changed(twin, fault(twin, "leak", "all", 2.0)), system_of(twin)
    sinks = [twin.netlist.index[name] for name in ("P1.SINK", "P2.SINK")]
    of_sinks = np.asarray(before.ambient_conductance)[sinks]
    np.testing.assert_array_equal(np.asarray(leak.ambient_conductance)[sinks], of_sinks)
    on_plate = slice(before.wiring.elements)
    np.testing.assert_allclose(
        np.asarray(leak.ambient_conductance)[on_plate],
        2 * np.asarray(before.ambient_conductance)[on_plate],
    )


def test_something_put_on_the_plate_takes_up_heat(twin: Twin):
    loaded = np.asarray(changed(twin, fault(twin, "load")).capacitance)
    before = np.asarray(system_of(twin).capacitance)
    factor = np.where(np.arange(len(before)) < twin.wiring.elements, 1.5, 1.0)
    np.testing.assert_allclose(loaded, factor * before)


def test_swapped_channels_read_each_other_and_an_offset_is_added(twin: Twin):
    with jax.enable_x64(True):
        state = jnp.linspace(1.0, 5.0, len(system_of(twin).capacitance))
        healthy = np.asarray(system_of(twin).channel_temperatures(state))
        swapped = np.asarray(changed(twin, fault(twin, "swap")).channel_temperatures(state))
        moved = np.asarray(changed(twin, fault(twin, "offset")).channel_temperatures(state))
    order = [5, 1, 2, 3, 4, 0, *range(6, 15)]
    np.testing.assert_allclose(swapped, healthy[order], rtol=1e-6)
    np.testing.assert_allclose(moved - healthy, [0.5] + 14 * [0.0], atol=1e-6)


def test_a_delayed_command_is_one_of_a_longer_delay(twin: Twin):
    late, usual = changed(twin, fault(twin, "delay")).delay, system_of(twin).delay
    assert late is not None
    assert usual is not None
    np.testing.assert_allclose(late, float(usual) + 1.0)


def test_a_blocked_sink_is_one_of_a_higher_resistance_to_the_room():
    twin = Twin("single-cell")
    other = twin.with_values({"R_sink": float(twin.values["R_sink"]) * 3})
    assert_equal(changed(twin, fault(twin, "block", "P1", 3.0)), system_of(other))


def test_a_moved_camera_is_one_of_another_registration(twin: Twin):
    moved = changed(twin, fault(twin, "move", "x", 1e-3))
    other = twin.with_values({"d_x": 1.0})
    assert_equal(moved, system_of(other))


def test_a_loosened_contact_changes_its_conductance_by_its_factor_and_nothing_else(twin: Twin):
    system = system_of(twin)
    loose = changed(twin, fault(twin, "loosen", "P2", 10.0))
    side = int(system.wiring.cold[1])
    before, after = np.asarray(system.conductance), np.asarray(loose.conductance)
    plate = [n for n in np.flatnonzero(before[side]) if n not in (side, system.wiring.hot[1])]
    np.testing.assert_allclose(after[side, plate], before[side, plate] / 10)
    np.testing.assert_allclose(after, after.T)
    # Heat to the surroundings is the same: rows sum to the links that lead there.
    np.testing.assert_allclose(after.sum(axis=1), before.sum(axis=1), atol=1e-9)
    rows = [n for n in range(len(before)) if n != side and n not in plate]
    np.testing.assert_array_equal(after[rows], before[rows])


def test_a_rig_whose_cells_have_failed_stays_as_cold_as_the_room(twin: Twin):
    with jax.enable_x64(True):
        dead = fault(twin, "fail", "P2", 1.0)(changed(twin, fault(twin, "fail")))
        stepper = Stepper(dead, 1.0)
        room = float(stepper.ambient)
        state = stepper.step(stepper.start(room), np.ones(2), room, steps=300)
        assert np.abs(np.asarray(stepper.channels(state, room)) - room).max() < 1e-3


def test_half_of_a_covered_channel_reads_the_room(twin: Twin):
    gain = np.asarray(changed(twin, fault(twin, "cover")).gain)
    np.testing.assert_allclose(gain[0], 0.5 * np.asarray(system_of(twin).gain)[0])


@pytest.mark.slow
@pytest.mark.parametrize("model", [name for name in EXAMPLES if name not in UNSEEN])
def test_a_fault_of_no_size_changes_nothing_and_has_a_slope(twin: Twin, model: str):
    """The hypotheses of a diagnosis are fitted by gradients."""
    none = 0.0 if model in SHARES else 1.0
    part = EXAMPLES[model][0]

    plain = system_of(twin)

    @jax.jit
    def readings(size: jax.Array) -> jax.Array:
        system = FAULT_MODELS[model](twin, part, size)(plain)
        state = system.steady_state(jnp.array([0.5, 0.5]), system.ambient_temperature)
        return system.channel_temperatures(state)

    with jax.enable_x64(True):
        at_rest = eqx.filter_jit(System.steady_state)
        state = at_rest(plain, jnp.array([0.5, 0.5]), plain.ambient_temperature)
        expected = plain.channel_temperatures(state)
        np.testing.assert_allclose(readings(jnp.asarray(none)), expected, atol=1e-9)
        slope = jax.jit(jax.jacfwd(readings))(jnp.asarray(none))
        step = 1e-5
        apart = readings(jnp.asarray(none + step)) - readings(jnp.asarray(none - step))
        np.testing.assert_allclose(slope, apart / (2 * step), rtol=1e-3, atol=1e-3)
        assert np.abs(slope).max() > 0


@pytest.mark.parametrize(
    ("model", "part", "words"),
    [
        ("loosen", "P3", "unknown cell 'P3'.* Known: P1, P2"),
        ("gain", "T99", "unknown channel 'T99'"),
        ("move", "z", "unknown axis 'z'"),
        ("weaken", "P9", "unknown part 'P9'.* Known: supply, P1, P2"),
        ("change", "R_X", "unknown parameter 'R_X'"),
        ("leak", "roof", "unknown part 'roof'"),
        ("swap", "T11", "unknown channel ''"),
    ],
)
def test_a_part_that_is_not_there_is_refused(twin: Twin, model: str, part: str, words: str):
    with pytest.raises(SimulationError, match=words):
        TimedFault(model, part, 0.0, 1.0).of(twin)


def test_a_rig_without_a_camera_has_none_to_move():
    with pytest.raises(SimulationError, match="expected a rig whose channels are zones"):
        fault(Twin(hand_rig()), "move", "x", 1e-3)


def test_a_rig_without_a_delay_has_none_to_lengthen():
    with pytest.raises(SimulationError, match="expected a driver with a delay"):
        fault(Twin("single-cell"), "delay")


@pytest.mark.slow
def test_every_model_has_an_example():
    assert EXAMPLES.keys() == FAULT_MODELS.keys()
