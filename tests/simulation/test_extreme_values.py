"""Values up to a thousand times off: two of many draws between 1e-3 and 1e3 times those of
`single-cell`, log-uniform, on which the default solver's steps leave every bound (1e83 K, NaN).

The truth is scipy's Radau on the equations of the network.
"""

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxtwin import Experiment, Twin, simulate, simulate_batch

TIME = np.arange(31.0)
DRIVE = Experiment(TIME, np.full((31, 1), 0.5))

# A load whose loss grows with the 92nd power of its rise, and one of 0.05 J/K on a poor conductor.
DRAWS = {
    "C_load": [2360.0, 0.0477],
    "R_loss": [264.0, 0.0112],
    "n_film": [91.7, 38.0],
    "alpha": [0.164, 0.115],
    "R_E": [0.233, 0.025],
    "R_Th": [0.022, 43.1],
    "C_side": [1.95, 487.0],
    "R_pc": [0.0223, 0.0373],
    "R_ph": [91.9, 0.000279],
    "C_sink": [103.0, 6220.0],
    "R_sink": [169.0, 0.84],
    "R_supply": [3.72, 0.0327],
    "g_T": [0.105, 4.49],
}


def reference(twin: Twin) -> np.ndarray:
    """What the channel reads, degC."""
    system = twin.system()
    air = system.ambient_temperature

    @jax.jit
    def rate(x: jax.Array) -> jax.Array:
        return system.heat_into_nodes(x, jax.numpy.full(1, 0.5), air) / system.capacitance

    slope = jax.jit(jax.jacfwd(rate))
    part = solve_ivp(
        lambda _, x: np.asarray(rate(x)),
        (0.0, TIME[-1]),
        np.asarray(system.initial_temperature - air),
        "Radau",
        TIME,
        jac=lambda _, x: np.asarray(slope(x)),
        rtol=1e-8,
        atol=1e-8,
    )
    assert part.success
    return np.asarray(system.channel_temperatures(jax.numpy.asarray(part.y.T)) + air - 273.15)


@pytest.mark.slow
@pytest.mark.parametrize("draw", [0, 1])
def test_one_run_is_rescued_and_a_batch_gives_the_same(draw, float64):
    twin = Twin("single-cell")
    own = {name: values[draw] for name, values in DRAWS.items()}
    run = simulate(twin.with_values(own), DRIVE)
    np.testing.assert_allclose(run.temperatures, reference(twin.with_values(own)), atol=1e-3)
    both = simulate_batch(twin, DRIVE, {name: np.array(v) for name, v in DRAWS.items()})
    np.testing.assert_allclose(both[draw], run.temperatures, atol=1e-9)
