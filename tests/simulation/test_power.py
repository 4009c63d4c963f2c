"""Electrical power and energy of runs and of many draws: by hand, and by conservation of energy."""

from dataclasses import replace
from typing import Any

import diffrax
import numpy as np
import pytest
from scipy.integrate import simpson
from small_rigs import bundled

from jaxtwin import Experiment, Twin, reduce_batch, simulate
from jaxtwin.errors import SimulationError

# Power of `printer-bed` at full duty, W: its tracks, switch and supply.
HEATER = 12.0**2 / (1.2 + 0.01 + 0.05)


def stepped(interval: float) -> Experiment:
    """A third of full duty for 20 s, off for 20 s, full for 20 s."""
    time = np.arange(0.0, 60.0 + interval / 2, interval)
    return Experiment(
        time, np.array([1 / 3, 0.0, 1.0])[np.minimum(time // 20, 2).astype(int), None]
    )


@pytest.mark.slow
@pytest.mark.parametrize("interval", [0.5, 10.0])
def test_a_heater_draws_its_share_of_full_power(interval: float):
    """Switched on for |duty|: V^2 / R for that part of the time."""
    experiment = stepped(interval)
    run = Twin("printer-bed").simulate(experiment)
    np.testing.assert_allclose(run.power, HEATER * experiment.duty, rtol=1e-12)
    expected = HEATER * np.interp(experiment.time, [0, 20, 40, 60], [0, 20 / 3, 20 / 3, 80 / 3])
    np.testing.assert_allclose(run.energy, expected, rtol=1e-12, atol=1e-9)


@pytest.mark.slow
def test_energy_behind_a_delay_and_a_lag_is_that_of_the_delayed_and_lagged_duty():
    """The integral of the duty behind a step, by hand: t - d - tau (1 - exp(-(t - d) / tau)). The
    delay is no multiple of the interval."""
    twin = bundled("printer-bed", {"delay": "1.3 s", "lag": "2 s"})
    time = np.arange(0.0, 30.5, 0.5)
    run = twin.simulate(Experiment(time, np.full((len(time), 1), 0.8)))
    late = np.maximum(time - 1.3, 0.0)
    expected = 0.8 * HEATER * (late - 2.0 * (1 - np.exp(-late / 2.0)))
    np.testing.assert_allclose(run.power[:, 0], 0.8 * HEATER * (1 - np.exp(-late / 2)), rtol=1e-9)
    np.testing.assert_allclose(run.energy, expected, rtol=0, atol=1e-4 * HEATER)


@pytest.mark.slow
def test_energy_drawn_is_the_heat_stored_and_lost():
    """`paper-2024` with switches that have no resistance: heat stored in all nodes and lost through
    all links to the surroundings, summed outside of the package, to 1e-4 of the energy."""
    twin = bundled("paper-2024", {"on_resistance": "0 ohm"})
    values, index = twin.numbers_si, twin.netlist.index
    time = np.arange(0.0, 120.0 + 0.05, 0.1)
    duties = np.array([[0.5, 0.8], [-0.4, 1.0], [0.0, 0.0]])
    run = twin.simulate(Experiment(time, duties[np.minimum(time // 40, 2).astype(int)]))
    C = np.array([node.capacitance.evaluate(values) for node in twin.netlist.nodes])
    to_air = np.zeros(len(C))
    for link in twin.netlist.links:
        if link.b == "ambient":
            to_air[index[link.a]] += 1 / link.resistance(values)
    stored = C @ (run.states[-1] - run.states[0])
    ambient = values["T_amb"] - 273.15
    lost = simpson((run.states - ambient) @ to_air, x=time)
    assert run.energy[-1] == pytest.approx(stored + lost, rel=1e-4)
    assert run.energy[-1] > 1000
    # A cell that is switched off, shorted by the bridge, draws nothing.
    assert not run.power[time > 81].any()


@pytest.mark.slow
def test_samples_far_apart_cost_little_accuracy():
    """Peltier cells behind delay and lag, sampled each 10 s instead of each 0.1 s."""
    twin = Twin("dual-cell")

    def energy(interval: float) -> float:
        time = np.arange(0.0, 120.0 + interval / 2, interval)
        duty = np.where(time[:, None] < 60, [0.5, 0.8], [0.3, -0.4])
        return float(twin.simulate(Experiment(time, duty)).energy[-1])

    assert energy(10.0) == pytest.approx(energy(0.1), rel=5e-3)


DRAWS = {"R_E": np.array([1.8, 2.0, 2.3]), "R_supply": np.array([0.1, 0.5, 0.3])}


@pytest.fixture(scope="module")
def plate() -> tuple[Twin, Experiment]:
    time = np.arange(0.0, 40.5, 0.5)
    duty = np.where(time[:, None] < 20, [0.5, 0.8], [-0.2, 0.4])
    return Twin("dual-cell"), Experiment(time, duty)


@pytest.mark.slow
@pytest.mark.parametrize("solver", [None, pytest.param(diffrax.Kvaerno5(), marks=pytest.mark.long)])
def test_many_draws_have_the_energy_and_the_peak_of_their_runs(solver: Any, plate):
    """With the driver's delay and lag, by the default solver and by diffrax. Draws in C are
    integrated over their steps, the run from temperatures that are linear between samples."""
    twin, experiment = plate
    found = reduce_batch(twin, experiment, DRAWS, ["energy", "peak_power"], solver=solver)
    for n in range(3):
        one = twin.with_values({name: values[n] for name, values in DRAWS.items()})
        run = simulate(one, experiment)
        assert found.energy is not None
        assert found.peak_power is not None
        assert found.energy[n] == pytest.approx(run.energy[-1], rel=1e-4)
        assert found.peak_power[n] == pytest.approx(run.power.sum(axis=1).max(), rel=0.02)
    assert found.to_xarray()["energy"].attrs["units"] == "J"
    assert np.ptp(found["energy"]) > 10


@pytest.mark.slow
def test_a_draw_that_fails_has_no_energy(plate):
    twin, experiment = plate
    found = reduce_batch(twin, experiment, {"R_E": [2.0, -1.0]}, ["energy"])
    assert found["energy"][0] > 0
    assert np.isnan(found["energy"][1])


@pytest.mark.slow
def test_a_part_of_a_run_says_that_it_has_no_power(plate):
    twin, experiment = plate
    run = twin.simulate(experiment)
    with pytest.raises(SimulationError, match="expected the run of a twin from its start"):
        _ = run.between(10.0).energy
    assert replace(run, twin=None).time[-1] == 40.0
