"""The few modes of a match, against all modes."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from placed_rig import AT, GRID, placed_rig

from jaxtwin import Experiment, Twin, match
from jaxtwin.matching._native_recordings import FEW, MANY, few_modes
from jaxtwin.physics import System
from jaxtwin.simulation import Modes, padded_time_grid, run_modes, solve_network

FINE = GRID.replace('"1 cm"', '"0.7 cm"')  # 23 x 12 elements
HEATER = """
[[heaters]]
name = "film"
power = "10 W"
capacitance = "0.05 J/K"
at = ["13 cm", "4 cm"]
size = "2 cm"
contact_resistance = "0.5 K/W"
"""
STEP = Experiment.schedule("0:0.6/0.5,200:-0.2/1", duration=400.0, cells=2)


@eqx.filter_jit
def system_of(twin: Twin) -> System:
    return twin.system(lumped=False)


def modes_of(twin: Twin) -> tuple[Modes, Modes]:
    system, summary = system_of(twin), padded_time_grid(twin, STEP).summary()
    modes = eqx.filter_jit(run_modes)(system, summary)
    return modes, few_modes(system, modes)


@pytest.mark.slow
@pytest.mark.usefixtures("float64")
def test_readings_and_sides_in_few_modes_are_those_in_all():
    """The heater settles in 25 ms, as fast as the fastest ripples of the grid: its own rise of 5 K
    above the plate is kept, because its mode is one that heat reaches."""
    twin = Twin(placed_rig(AT, grid=FINE, parts=HEATER))
    modes, few = modes_of(twin)
    assert (modes.rates.size, few.rates.size) == (279, FEW)
    system, grid = system_of(twin), padded_time_grid(twin, STEP)
    sides = jnp.eye(system.capacitance.size)[jnp.array([*system.wiring.cold, *system.wiring.hot])]
    read = jnp.concatenate([jnp.asarray(system.channel_weights), sides])
    start = jnp.asarray(system.initial_temperature)
    exact, found = (
        np.asarray(eqx.filter_jit(solve_network)(system, grid, start, read, chosen)[1])
        for chosen in (modes, few)
    )
    assert np.abs(exact).max() > 20
    np.testing.assert_allclose(found, exact, atol=0.02)
    np.testing.assert_array_equal(few.rates[: FEW // 2], modes.rates[: FEW // 2])
    assert few.rates[-1] == modes.rates[-1]  # that of the heater


@pytest.mark.slow
def test_a_network_of_not_many_nodes_keeps_its_modes():
    modes, few = modes_of(Twin(placed_rig(AT, grid=GRID.replace('"1 cm"', '"2 cm"'), parts=HEATER)))
    assert modes.rates.size < MANY
    assert few is modes


@pytest.mark.long
def test_a_match_on_a_fine_grid_finds_the_place_of_the_cell():
    """A recording of a cell at (5.3, 3.7) cm, matched from (5.0, 4.0) cm in few modes."""
    place = 'at = ["x_1", "y_1"]\nsize = "4 cm"\ncontact_resistance = "R_contact"'
    zones = "".join(
        f'[[channels]]\nname = "Z{n}"\nx = ["{x} cm", "{x + 3} cm"]\ny = ["{y} cm", "{y + 3} cm"]\n'
        for n, (x, y) in enumerate([(0, 0), (0, 5), (6, 0), (6, 5)])
    )
    twin = Twin(placed_rig(place, grid=FINE, parts=zones))
    step = Experiment.schedule("0:0.6", duration=300.0, cells=1)
    truth = {"x_1": 53.0, "y_1": 37.0, "R_contact": 0.9}
    fit = match(twin, [twin.with_values(truth).simulate(step).to_recording(noise=0.05, seed=1)])
    for name, value in truth.items():
        assert fit.parameters[name].value == pytest.approx(value, rel=0.03)
