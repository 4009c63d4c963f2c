"""The truth that every way is measured against: scipy's Radau at 1e-10, draw by draw."""

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

import jaxtwin as jt

from ._equations import equations, stretches

TOLERANCE = 1e-10


def reference_readings(
    twin: jt.Twin, experiment: jt.Experiment, method: str = "Radau", tolerance: float = TOLERANCE
) -> Float[np.ndarray, "times channels"]:
    """What the channels of one twin read with the rig's own start, degC; NaN where it fails."""
    network = equations(twin)
    time = experiment.time
    states = np.empty((len(time), len(network.initial)))
    states[0] = last = network.initial
    for start, end, command in stretches(experiment, network.delay):
        solution = solve_ivp(
            lambda _, x, command=command: network.rate(x, command),
            (start, end),
            last,
            method=method,
            dense_output=True,
            jac=lambda _, x, command=command: network.jacobian(x, command),
            rtol=tolerance,
            atol=tolerance,
        )
        if not solution.success:
            return np.full((len(time), len(network.gain)), np.nan)
        inside = (time > start) & (time <= end)
        states[inside] = solution.sol(time[inside]).T
        last = solution.y[:, -1]
    return network.readings(states)
