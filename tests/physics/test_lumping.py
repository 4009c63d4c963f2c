"""Nodes that are always equal, made one: nothing that can be read changes."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxtwin import load_rig
from jaxtwin._compilation._fingerprint import fingerprint
from jaxtwin.physics import System, Twin
from jaxtwin.physics._wiring import wiring_of
from jaxtwin.rig import Circuit, Rig

assembled = eqx.filter_jit(Twin.system)
lumped_of = eqx.filter_jit(lambda twin: twin.system(lumped=True))
read = eqx.filter_jit(System.channel_temperatures)


@eqx.filter_jit
def rates(system: System, deviation: jax.Array, duty: jax.Array) -> jax.Array:
    heat = system.heat_into_nodes(deviation, duty, system.ambient_temperature)
    return heat / system.capacitance


@pytest.mark.parametrize(
    ("rig", "nodes"),
    [
        ("paper-2024", 28 - 8),  # row 3 repeats row 1
        ("dual-cell", 30),  # each row has a height, a film factor and contacts of its own
    ],
)
def test_mirror_images_become_one(rig, nodes):
    rig = load_rig(rig)
    lumped = wiring_of(rig, lumped=True)
    assert len(lumped.netlist.nodes) == nodes
    names = [node.name for node in wiring_of(rig).netlist.nodes]
    stands_for = {
        name: lumped.netlist.nodes[p].name for name, p in zip(names, lumped.position, strict=True)
    }
    assert stands_for["P2.TH"] == "P2.TH"
    assert stands_for["V38"] == ("V18" if rig.name == "paper-2024" else "V38")


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["paper-2024", "dual-cell"])
def test_symmetric_states_change_and_read_as_they_do_unlumped(rig, float64):
    """In any state in which mirror images are equal."""
    twin = Twin(rig)
    whole, lumped = assembled(twin), lumped_of(twin)
    position = lumped.wiring.position
    rng = np.random.default_rng(2)
    for duty in ([0.5, 0.78], [-1.0, 0.3]):
        deviation = jnp.asarray(rng.normal(0, 20, len(lumped.capacitance)))
        found = rates(lumped, deviation, jnp.asarray(duty))[position]
        expected = rates(whole, deviation[position], jnp.asarray(duty))
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11)
        np.testing.assert_allclose(
            read(lumped, deviation), read(whole, deviation[position]), rtol=1e-12
        )


def test_capacitance_and_way_to_the_air_are_kept_in_sum(float64):
    """681.7 J/K and 4.604 W/K of the plate, and the cells."""
    twin = Twin("paper-2024")
    whole, lumped = assembled(twin), lumped_of(twin)
    for name in ("capacitance", "ambient_conductance"):
        total = float(getattr(whole, name).sum())
        assert float(getattr(lumped, name).sum()) == pytest.approx(total, rel=1e-13)


def test_nodes_with_different_links_are_not_lumped():
    """Without the link from V38 to the air, V18 is no longer its image, nor is V17 that of V37."""
    rig = load_rig("paper-2024")
    lumped = wiring_of(without_link(rig, ("V38", "ambient")), lumped=True)
    assert len(lumped.netlist.nodes) == 28


def without_link(rig: Rig, ends: tuple[str, str]) -> Rig:
    assert rig.circuit is not None
    groups = tuple(
        dataclasses.replace(group, between=tuple(pair for pair in group.between if pair != ends))
        for group in rig.circuit.links
    )
    return dataclasses.replace(rig, circuit=Circuit(rig.circuit.capacitance, groups))


@pytest.mark.parametrize("name", ["R_E", "R_pc", "R_Tez", "C_element", "C_esp"])
def test_negative_resistances_and_heat_capacities_are_not_valid(name):
    """`physical` is what a sweep marks a draw by: a resistance or capacitance below 0."""
    with jax.enable_x64(True):
        assert bool(assembled(Twin("paper-2024")).is_valid)
        assert not bool(assembled(Twin("paper-2024", {name: -1.0})).is_valid)


def test_the_wiring_of_another_rig_or_network_has_another_digest():
    """By which kept programs are found."""
    rigs = [load_rig("paper-2024"), load_rig("dual-cell")]
    wirings = [wiring_of(rig, lumped) for rig in rigs for lumped in (False, True)]
    assert len({fingerprint(wiring) for wiring in wirings}) == 4
