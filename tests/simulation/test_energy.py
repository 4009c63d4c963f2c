"""Conservation of energy in whole runs, with flows summed outside the package.

Between any two marks: electrical work + heat from the surroundings = heat stored in all nodes.
At every saved time, in each cell: q_h - q_c = I V.
"""

import tomllib
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import simpson

from jaxtwin import Experiment, Twin
from jaxtwin.data import data_folder
from jaxtwin.rig import rig_from_tables
from jaxtwin.simulation import Run

# Powered, then reversed in one cell and full in the other, then off: 40 s each. Samples are 0.02 s
# apart for 10 s after each change and 0.5 s after that: Simpson's rule on them is good to 1e-8.
FINE, COARSE, PART = np.arange(0, 10, 0.02), np.arange(10, 40, 0.5), 40.0
TIME = np.concatenate([*(PART * n + np.concatenate([FINE, COARSE]) for n in range(3)), [120.0]])
DUTIES = np.array([[0.5, 0.8], [-0.4, 1.0], [0.0, 0.0]])
EXPERIMENT = Experiment(TIME, DUTIES[np.minimum(TIME // PART, 2).astype(int)])


def on_off(twin: Twin, T: np.ndarray, duty: np.ndarray) -> tuple[np.ndarray, ...]:
    """q_c, q_h (W) and the mean of I V (W) over a period: connected for |duty|, shorted for the
    rest. Constants of `dual-cell`."""
    values = twin.numbers_si
    alpha, R_E, R_s, R_on = values["alpha"], values["R_E"], values["R_supply"], 0.1
    index = twin.netlist.index
    cold, hot = (T[:, [index[f"P1.{side}"], index[f"P2.{side}"]]] for side in ("TC", "TH"))
    emf = alpha * (hot - cold)
    on = (-np.sign(duty) * 12.0 - emf) / (R_E + R_on + R_s)
    off = -emf / (R_E + R_on)
    share = np.abs(duty)

    def mean(flow):
        return share * flow(on) + (1 - share) * flow(off)

    return (
        mean(lambda current: alpha * current * cold - R_E * current**2 / 2),
        mean(lambda current: alpha * current * hot + R_E * current**2 / 2),
        mean(lambda current: current * (emf + R_E * current)),
    )


class Balance:
    """What a run stores, and what it is given in each of the three parts, J."""

    def __init__(self, run: Run, C, to_air, ambient: float, power):
        T = run.states + 273.15
        marks = np.searchsorted(TIME, [0, 40, 80, 120])
        self.stored = np.diff(T[marks] @ C)
        self.given, self.exchanged = [], []
        for duty, (first, last) in zip(DUTIES, pairwise(marks), strict=True):
            bend = np.searchsorted(TIME, TIME[first] + 10)
            spans = [slice(first, bend + 1), slice(bend, last + 1)]
            flows = [
                np.column_stack([power(T[span], duty), to_air * (ambient - T[span])])
                for span in spans
            ]

            def integral(flows, spans=spans):
                return sum(
                    simpson(flow.sum(axis=1), x=TIME[span])
                    for flow, span in zip(flows, spans, strict=True)
                )

            self.given.append(integral(flows))
            self.exchanged.append(integral([np.abs(flow) for flow in flows]))


@pytest.mark.slow
@pytest.mark.parametrize("values", ["startup", "initial"])
def test_heat_in_is_heat_out_plus_stored(values, circuits, twins):
    """The paper's circuit, matrices from the authors' file, in each part to 1e-6 of all heat that
    it exchanged."""
    circuit = circuits[values]
    run = twins[values].simulate(EXPERIMENT)

    def power(T, duty):
        _, _, current, voltage = circuit.cells(T, duty)
        return current * voltage

    balance = Balance(run, circuit.C, circuit.to_air, 288.15, power)
    assert (np.abs(balance.given - balance.stored) < 1e-6 * np.array(balance.exchanged)).all()
    # Something happened: the first part takes up kilojoules.
    assert balance.stored[0] > 1000


@pytest.mark.slow
def test_heat_in_is_heat_out_plus_stored_with_on_off_switching():
    """`dual-cell` with a command that is followed at once: capacitances and links of the netlist,
    sinks with a mass, losses that grow with the rise."""
    document = tomllib.loads((data_folder() / "rigs" / "dual-cell.toml").read_text())
    for part in ("lag", "delay"):
        del document["parameters"][document["driver"].pop(part)]
    twin = Twin(rig_from_tables(document, "at once"))
    values = twin.numbers_si
    C = np.array([node.capacitance.evaluate(values) for node in twin.netlist.nodes])
    to_air = np.zeros(len(C))
    for link in twin.netlist.links:
        if link.b == "ambient":
            to_air[twin.netlist.index[link.a]] += 1 / link.resistance(values)
    loss, index, air = twin.netlist.loss, twin.netlist.index, 289.15
    assert loss is not None
    assert loss.exponent is not None
    exponent = loss.exponent.evaluate(values)
    film, radiating = np.zeros(len(C)), np.zeros(len(C))
    for link in twin.netlist.links:
        film[index[link.a]] += (link.role == "film") / link.resistance(values)
    for node, areas in loss.radiators:
        radiating[index[node]] = sum(area.evaluate(values) for area in areas)

    def power(T, duty):
        """Electrical, and what is lost beyond the film as it is at a rise of 20 K."""
        rise = T - air
        more = ((rise**2 + 1) / (20.0**2 + 1)) ** (exponent / 2) - 1
        lost = film * more * rise + 5.670374419e-8 * radiating * (T**4 - air**4)
        return np.column_stack([on_off(twin, T, duty)[2], -lost])

    run = twin.simulate(EXPERIMENT)
    balance = Balance(run, C, to_air, air, power)
    assert (np.abs(balance.given - balance.stored) < 1e-6 * np.array(balance.exchanged)).all()
    assert balance.stored[0] > 1000


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper-2024", "dual-cell"])
def test_difference_of_the_sides_heats_is_electrical_power_at_every_saved_time(
    name, circuits, float64
):
    """q_h - q_c = I V with q_h and q_c of the package, I and V by hand, and all of them by hand."""
    twin = Twin(name)
    run = twin.simulate(EXPERIMENT)
    T, duty = run.states + 273.15, EXPERIMENT.duty
    if name == "paper-2024":
        q_c, q_h, current, voltage = circuits["startup"].cells(T, duty)
        power = current * voltage
    else:
        q_c, q_h, power = on_off(twin, T, duty)
    system = twin.system()
    index = twin.netlist.index
    sides = [index[f"P{cell}.{side}"] for side in ("TC", "TH") for cell in (1, 2)]
    heat = jax.vmap(system.cell_heat)(jnp.asarray(T[:, sides]), jnp.asarray(duty))
    np.testing.assert_allclose(heat.hot - heat.cold, power, atol=1e-9)
    np.testing.assert_allclose(heat.power, power, atol=1e-9)
    np.testing.assert_allclose(heat.cold, q_c, atol=1e-9)
    np.testing.assert_allclose(heat.hot, q_h, atol=1e-9)
    assert np.abs(power).max() > 10


@pytest.mark.slow
def test_instantaneous_balance_at_every_saved_time(circuits, float64):
    """Heat into all nodes = electrical power + heat from the surroundings, to 1e-6 of the largest
    flow: the package's rates of change, the authors' circuit's flows."""
    twin, circuit = Twin("paper-2024"), circuits["startup"]
    run = twin.simulate(EXPERIMENT)
    T = run.states + 273.15
    system, reference = twin.system(), twin.system().ambient_temperature
    into = jax.vmap(lambda x, u: system.heat_into_nodes(x, u, reference))(
        jnp.asarray(T) - reference, jnp.asarray(EXPERIMENT.duty)
    )
    _, _, current, voltage = circuit.cells(T, EXPERIMENT.duty)
    from_air = (288.15 - T) @ circuit.to_air
    given = (current * voltage).sum(axis=1) + from_air
    np.testing.assert_allclose(into.sum(axis=1), given, atol=1e-6 * np.abs(from_air).max())
    # And node by node, where the saved temperatures go next.
    rates = [circuit.rate(*now, 288.15) for now in zip(T, EXPERIMENT.duty, strict=True)]
    np.testing.assert_allclose(into / circuit.C, rates, atol=1e-10)
