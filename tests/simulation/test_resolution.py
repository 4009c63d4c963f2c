"""How small a resistance may be: float64 sums conductances to a part of 2e-16 of the largest.

The truth for a contact of nearly nothing is the circuit of conftest.py with both of its ends made
one node, which has no large conductance in it, solved by scipy's Radau.
"""

import diffrax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxtwin import Experiment, match, reduce_batch
from jaxtwin.errors import MatchError, SimulationError

DUTY = np.full(2, 0.5)
HELD = Experiment(np.arange(75.0), np.tile(DUTY, (75, 1)))
CONTACTS = (("V23", "P1.TC"), ("V26", "P2.TC"))


def channels_without_contacts(circuit) -> np.ndarray:
    """The plate's temperatures, `(times, nodes)`, degC, with each contact's two ends as one."""
    place = {name: number for number, name in enumerate(circuit.nodes)}
    conductance, whole = circuit.G.copy(), np.eye(len(circuit.nodes))
    for a, b in ((place[a], place[b]) for a, b in CONTACTS):
        contact = -conductance[a, b]
        conductance[[a, b], [b, a]] = 0
        conductance[[a, b], [a, b]] -= contact
        whole[b] = whole[a]
    whole = whole[:, [n for n in range(len(circuit.nodes)) if n not in (24, 26)]]
    joined, air = whole.T @ conductance @ whole, whole.T @ circuit.to_air * 288.15
    capacitance = whole.T @ circuit.C

    def rate(_: float, T: np.ndarray) -> np.ndarray:
        q_c, q_h, _, _ = circuit.cells(whole @ T, DUTY)
        heat = np.zeros(len(circuit.nodes))
        heat[circuit.cold], heat[circuit.hot] = -q_c, q_h
        return (air - joined @ T + whole.T @ heat) / capacitance

    # The two ends meet at once, by their capacities.
    start = whole.T @ (circuit.C * circuit.start()) / capacitance
    span = (HELD.time[0], HELD.time[-1])
    part = solve_ivp(rate, span, start, "Radau", HELD.time[1:], rtol=1e-10, atol=1e-10)
    return (whole @ part.y).T[:, :24] - 273.15


@pytest.mark.slow
@pytest.mark.parametrize("contact", [1e-8, 1e-10])
def test_contacts_down_to_1e_10_are_right_to_a_millikelvin(contact, circuits, twins):
    run = twins["startup"].with_values({"R_pc": contact}).simulate(HELD)
    expected = channels_without_contacts(circuits["startup"])
    assert np.abs(run.states[1:, :24] - expected).max() < 1e-3


@pytest.mark.slow
def test_a_contact_of_1e_12_is_refused_by_name(twins):
    """Rounding would be 4e-3 K in 74 s, and 0.3 K at 1e-14."""
    twin = twins["startup"].with_values({"R_pc": 1e-12})
    for solver in (None, diffrax.Kvaerno5()):
        with pytest.raises(SimulationError, match=r"resistance .*P\d\.TC: .* got 1e-12 K/W"):
            twin.simulate(HELD, solver=solver)


@pytest.mark.slow
def test_in_a_batch_such_draws_are_marked_and_leave_the_others_alone(twins):
    contacts = np.array([0.09, 1e-12, 1e-10])
    found = reduce_batch(twins["startup"], HELD, {"R_pc": contacts}, ["final"])
    assert found.failed.tolist() == [False, True, False]
    assert found.final is not None
    assert np.isnan(found.final[1]).all()
    alone = twins["startup"].with_values({"R_pc": 1e-10}).simulate(HELD)
    # Rounding at 1e-10 K/W is up to 2e-4 K (benchmarks/NOTES.md, 45), and a batch rounds otherwise.
    np.testing.assert_allclose(found.final[2], alone.temperatures[-1], atol=2e-4)


@pytest.mark.slow
def test_a_match_does_not_start_where_nothing_can_be_told(twins):
    run = twins["startup"].simulate(HELD)
    recorded = Experiment(
        HELD.time, HELD.duty, temperatures=run.temperatures, channels=run.channels
    )
    twin = twins["startup"].with_values({"R_pc": 1e-12})
    with pytest.raises(MatchError, match="expected finite temperatures"):
        match(twin, recorded, free=["R_ph"])
