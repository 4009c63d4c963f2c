"""The equations as a whole, against a network summed link by link and cells by scalar formulas."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtwin import load_rig
from jaxtwin.physics import System, Twin
from jaxtwin.rig import Rig

CASES = [
    ("paper-2024", None),
    ("paper-2024", "startup"),
    ("paper-2024", "initial"),
    ("paper-2024", "published"),
    ("dual-cell", None),
]
duties = st.tuples(st.floats(-1, 1), st.floats(-1, 1))


def twin_of(name: str, parameter_set: str | None) -> Twin:
    rig = load_rig(name)
    return Twin(rig, None if parameter_set is None else rig.parameter_sets[parameter_set])


assembled = eqx.filter_jit(Twin.system)
heat = eqx.filter_jit(System.heat_into_nodes)


def values_si(twin: Twin) -> dict[str, float]:
    table = twin.rig.parameters
    return {name: table[name].to_si(float(value)) for name, value in twin.values.items()}


def cell_by_hand(rig: Rig, cell, values, duty, cold, hot) -> tuple[float, float, float]:
    """Heat out of the cold side, heat into the hot side and electrical power, eqs. (7)-(9)."""
    alpha = cell.seebeck_coefficient.evaluate(values)
    R_E = cell.electrical_resistance.evaluate(values)
    V = rig.driver.supply_voltage.evaluate(values)
    R_s = rig.driver.supply_resistance.evaluate(values)
    R_on = rig.driver.on_resistance.evaluate(values)
    emf = alpha * (hot - cold)
    if rig.driver.averaging == "voltage":
        phases = [(1.0, (-duty * V - emf) / (R_E + R_on + abs(duty) * R_s))]
    else:
        on = (-np.sign(duty) * V - emf) / (R_E + R_on + R_s)
        phases = [(abs(duty), on), (1 - abs(duty), -emf / (R_E + R_on))]
    q_c = sum(share * (alpha * i * cold - R_E * i**2 / 2) for share, i in phases)
    q_h = sum(share * (alpha * i * hot + R_E * i**2 / 2) for share, i in phases)
    return q_c, q_h, sum(share * i * (emf + R_E * i) for share, i in phases)


def plate_loss_by_hand(twin: Twin, values, rise: np.ndarray, air: float) -> np.ndarray:
    """What each node loses beyond its links' film as it is at a rise of 20 K, W: natural convection
    of an air that is never stiller than at 1 K, and radiation."""
    loss, index = twin.netlist.loss, twin.netlist.index
    lost = np.zeros(len(rise))
    if loss is None:
        return lost
    exponent = 0.0 if loss.exponent is None else loss.exponent.evaluate(values)
    for link in twin.netlist.links:
        if link.role == "film":
            node, film = index[link.a], 1 / sum(r.evaluate(values) for r in link.resistances)
            factor = ((rise[node] ** 2 + 1) / (20.0**2 + 1)) ** (exponent / 2)
            lost[node] += film * (factor - 1) * rise[node]
    for name, areas in loss.radiators:
        area, hot = sum(term.evaluate(values) for term in areas), air + rise[index[name]]
        lost[index[name]] += 5.670374419e-8 * area * (hot**4 - air**4)
    return lost


@pytest.fixture(scope="module", params=CASES, ids=lambda case: "-".join(filter(None, case)))
def twin(request) -> Twin:
    return twin_of(*request.param)


@pytest.fixture(scope="module")
def system(twin) -> System:
    with jax.enable_x64(True):
        return assembled(twin)


@eqx.filter_jit
def steady_state(system: System, duty: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Deviations, the heat that still goes into each node, and the electrical power."""
    reference, wiring = system.ambient_temperature, system.wiring
    deviation = system.steady_state(duty, reference)
    sides = jnp.concatenate([deviation[wiring.cold], deviation[wiring.hot]]) + reference
    power = system.cell_heat(sides, duty).power.sum()
    return deviation, system.heat_into_nodes(deviation, duty, reference), power


def test_heat_into_every_node_equals_a_direct_build(twin, system, network, float64):
    nodes = [node.name for node in twin.netlist.nodes]
    values = values_si(twin)
    matrix, ambient = network(nodes, twin.netlist.links, values)
    rng = np.random.default_rng(1)
    for duty in ([0.0, 0.0], [1.0, -1.0], [0.5, 0.78], [-0.3, 0.2]):
        deviation, drift, reference = rng.normal(0, 20, len(nodes)), 1.7, 289.0
        expected = -matrix @ deviation + ambient * drift
        expected -= plate_loss_by_hand(twin, values, deviation - drift, reference + drift)
        for cell, d in zip(twin.netlist.cells, duty, strict=True):
            cold, hot = nodes.index(cell.cold), nodes.index(cell.hot)
            sides = deviation[[cold, hot]] + reference
            q_c, q_h, _ = cell_by_hand(twin.rig, cell, values, d, *sides)
            expected[cold] -= q_c
            expected[hot] += q_h
        found = heat(
            system,
            jnp.asarray(deviation),
            jnp.asarray(duty),
            jnp.asarray(reference),
            jnp.asarray(drift),
        )
        scale = np.abs(matrix) @ np.abs(deviation) + np.abs(expected)
        assert (np.abs(np.asarray(found) - expected) <= 1e-13 * scale + 1e-10).all()


def test_numbers_of_the_nodes_are_those_of_the_netlist(twin, system):
    values = values_si(twin)
    for node, C, T in zip(
        twin.netlist.nodes, system.capacitance, system.initial_temperature, strict=True
    ):
        assert float(C) == pytest.approx(node.capacitance.evaluate(values), rel=1e-14)
        assert float(T) == pytest.approx(node.initial_temperature.evaluate(values), rel=1e-14)
    assert float(system.ambient_temperature) == pytest.approx(
        twin.rig.ambient_temperature.evaluate(values), rel=1e-14
    )


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(filter(None, case)))
@settings(max_examples=20)
@given(duty=duties, seed=st.integers(0, 1000))
def test_energy_is_conserved_in_every_state(case, duty, seed):
    """All heat into nodes is electrical power plus what the surroundings give."""
    with jax.enable_x64(True):
        twin = twin_of(*case)
        system = assembled(twin)
        nodes = [node.name for node in twin.netlist.nodes]
        deviation = np.random.default_rng(seed).normal(0, 30, len(nodes))
        reference = system.ambient_temperature
        found = heat(system, jnp.asarray(deviation), jnp.asarray(duty), reference)
        into, conductance = np.asarray(found), np.asarray(system.ambient_conductance)
        sides = [
            deviation[[nodes.index(cell.cold), nodes.index(cell.hot)]] + float(reference)
            for cell in twin.netlist.cells
        ]
    values = values_si(twin)
    power = sum(
        cell_by_hand(twin.rig, cell, values, d, *temperatures)[2]
        for cell, d, temperatures in zip(twin.netlist.cells, duty, sides, strict=True)
    )
    given_by_ambient = -(conductance @ deviation)
    given_by_ambient -= plate_loss_by_hand(twin, values, deviation, float(reference)).sum()
    scale = np.abs(into).sum() + conductance @ np.abs(deviation)
    assert into.sum() == pytest.approx(power + given_by_ambient, abs=1e-12 * scale)


@pytest.mark.slow
@pytest.mark.parametrize(
    "duty", [[0.0, 0.0], [0.502, 0.502], [1.0, 1.0], [-1.0, -1.0], [0.8, -0.4]]
)
def test_nothing_changes_in_the_steady_state(twin, system, duty, float64):
    """No net heat in any node, and the electrical power leaves to the surroundings."""
    deviation, into, power = steady_state(system, jnp.asarray(duty))
    assert float(jnp.abs(into).max()) < 1e-9
    lost = float(system.ambient_conductance @ deviation)
    air = float(system.ambient_temperature)
    lost += plate_loss_by_hand(twin, values_si(twin), np.asarray(deviation), air).sum()
    assert lost == pytest.approx(float(power), rel=1e-9, abs=1e-9)


def test_unheated_plate_is_as_warm_as_the_surroundings(system, float64):
    deviation, _, _ = steady_state(system, jnp.zeros(2))
    np.testing.assert_allclose(deviation, 0, atol=1e-12)


def test_steady_state_of_the_published_values_is_the_published_run_s_end(float64):
    """circuit.md, section 11: after 500 s at 78.4 % V22 is at 50.4 and the cell at 188 degC; the
    plate has settled to a few tenths by then."""
    twin = twin_of("paper-2024", "published")
    deviation, _, _ = steady_state(assembled(twin), jnp.full(2, 200 / 255))
    celsius = np.asarray(deviation) + 15.0
    index = twin.netlist.index
    assert celsius[index["V22"]] == pytest.approx(50.4, abs=0.3)
    assert celsius[index["P1.TC"]] == pytest.approx(188, abs=1)


def test_conductance_is_symmetric_and_its_rows_sum_to_the_links_to_air(system):
    conductance = np.asarray(system.conductance)
    assert (conductance == conductance.T).all()
    scale = np.abs(conductance).sum(axis=1)
    error = np.abs(conductance.sum(axis=1) - np.asarray(system.ambient_conductance))
    assert (error <= 1e-14 * scale).all()


def test_channels_read_the_surroundings_and_part_of_the_rise(float64):
    """reading = ambient + gain (T - ambient), by hand for TAM with a gain of 0.8."""
    twin = Twin("dual-cell", {"g_TAM": 0.8})
    system = assembled(twin)
    column = twin.channels.index("TAM")
    nodes = len(twin.netlist.nodes)
    uniform = system.channel_temperatures(jnp.full((1, nodes), 10.0), jnp.full((1, 1), 4.0))
    assert float(uniform[0, column]) == pytest.approx(4.0 + 0.8 * (10.0 - 4.0))
    # The tap covers 3.75 ... 4.75 cm x 5.25 ... 6.25 cm. The centre of V22 is at 3 cm x 6 cm, its
    # neighbours' are at 7 cm and at 2 and 9.75 cm.
    along_x = 1 - (0.75 + 1.75) / 2 / 4
    along_y = 0.75 * (1 - 0.75 / 4 / 2) + 0.25 * (1 - 0.25 / 3.75 / 2)
    single = jnp.zeros(nodes).at[twin.netlist.index["V22"]].set(10.0)
    reading = float(system.channel_temperatures(single)[column])
    assert reading == pytest.approx(0.8 * 10 * along_x * along_y)


def test_stiff_shorted_cell_is_what_the_slope_of_the_heat_says(float64):
    """alpha^2 T / R, which solvers treat linearly: d q_c / d(T_h - T_c) of a braked cell."""
    system = assembled(Twin("dual-cell"))
    reference = float(system.ambient_temperature)

    slope = jax.jit(jax.jacfwd(lambda T: system.cell_heat(T, jnp.zeros(2)).cold))(
        jnp.full(4, reference)
    )
    loop = system.module.electrical_resistance + system.bridge.on_resistance
    expected = jnp.asarray(system.module.seebeck_coefficient) ** 2 * reference / loop
    np.testing.assert_allclose(jnp.diag(slope[:, :2]), expected, rtol=1e-12)
    np.testing.assert_allclose(jnp.diag(slope[:, 2:]), -expected, rtol=1e-12)
