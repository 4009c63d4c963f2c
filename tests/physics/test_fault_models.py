"""Faults change the equations as the parameter of the rig file that stands for them would."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hand_rig import hand_rig

from jaxtwin import SimulationError, Twin
from jaxtwin.physics import FAULT_MODELS, Fault, System, TimedFault
from jaxtwin.rig import Value
from jaxtwin.simulation import Stepper

EXAMPLES = {
    "loosen": ("P1", 10.0),
    "fail": ("P1", 1.0),
    "age": ("P1", 1.3),
    "block": ("P1", 3.0),
    "weaken": ("supply", 0.8),
    "gain": ("T11", 0.9),
    "cover": ("T11", 0.5),
    "move": ("x", 2e-3),
}


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


def assert_equal(one: System, other: System) -> None:
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


def test_a_channel_of_another_gain_is_one_of_that_parameter(twin: Twin):
    other = twin.with_values({"g_T12": float(twin.values["g_T12"]) * 0.9})
    assert_equal(changed(twin, fault(twin, "gain", "T12", 0.9)), system_of(other))


def test_a_weak_supply_is_one_of_a_lower_voltage(twin: Twin):
    driver = replace(twin.rig.driver, supply_voltage=Value(9.6))
    other = Twin(replace(twin.rig, driver=driver))
    weak = changed(twin, fault(twin, "weaken"))
    np.testing.assert_allclose(weak.bridge.supply_voltage, system_of(other).bridge.supply_voltage)


def test_an_aged_cell_is_one_of_a_higher_resistance():
    twin = Twin("single-cell")
    other = twin.with_values({"R_E": float(twin.values["R_E"]) * 1.3})
    assert_equal(changed(twin, fault(twin, "age", "P1", 1.3)), system_of(other))


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


@pytest.mark.parametrize("model", [name for name in EXAMPLES if name != "fail"])
def test_a_fault_of_no_size_changes_nothing_and_has_a_slope(twin: Twin, model: str):
    """The hypotheses of a diagnosis are fitted by gradients."""
    none = 0.0 if model in ("cover", "move") else 1.0
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
        ("weaken", "P1", "unknown part 'P1'.* Known: supply"),
    ],
)
def test_a_part_that_is_not_there_is_refused(twin: Twin, model: str, part: str, words: str):
    with pytest.raises(SimulationError, match=words):
        TimedFault(model, part, 0.0, 1.0).of(twin)


def test_a_rig_without_a_camera_has_none_to_move():
    with pytest.raises(SimulationError, match="expected a rig whose channels are zones"):
        fault(Twin(hand_rig()), "move", "x", 1e-3)


def test_every_model_has_an_example():
    assert EXAMPLES.keys() == FAULT_MODELS.keys()
