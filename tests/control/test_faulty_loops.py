"""Many loops of a rig with a fault."""

import numpy as np

import jaxtwin as jt
from jaxtwin._jax_settings import own_settings
from jaxtwin.control import MEASURES, PID
from jaxtwin.control.loops._simulate_closed_loops import simulate_many_loops


def test_loops_with_a_fault_are_those_of_a_twin_with_the_changed_value():
    """A cell of a resistance that is half as large again, as a fault and as a value."""
    twin, pid = jt.Twin("single-cell"), PID(0.1, 0.001)
    conditions = jt.control.scenario(twin, pid, 30.0, duration=60, noise=False)
    aged = jt.physics.FAULT_MODELS["age"](twin, "P1", np.float64(1.5))
    results = []
    for value, fault in ((2.0, aged), (3.0, None)):
        with own_settings():
            found = simulate_many_loops(
                twin,
                pid,
                conditions,
                draws={"R_E": np.array([value])},
                controller_draws={},
                count=1,
                measures={"energy": MEASURES["energy"][0]},
                precision="float64",
                workers=1,
                fault=fault,
            )
        results.append(found["energy"])
    np.testing.assert_allclose(*results, rtol=1e-9)
