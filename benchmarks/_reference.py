"""The truth that every way is measured against: scipy's Radau at 1e-10, draw by draw, or at the
next power of ten at which rounding lets it arrive."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.integrate import solve_ivp

import jaxtwin as jt

from ._equations import Equations, equations, rooms, stretches

TOLERANCE = 1e-10
TRIES = 3
"""Each with ten times the tolerance of the one before."""
EVALUATIONS = 40_000
"""Of the equations between two changes of the input, in all tries but the last: some five thousand
are common. Where a time constant is below a microsecond, rounding may keep the solver from 1e-10,
and its steps shrink without end."""


class _StalledError(Exception):
    """Rounding is larger than the tolerance."""


def reference_readings(
    twin: jt.Twin, experiment: jt.Experiment, method: str = "Radau", tolerance: float = TOLERANCE
) -> Float[np.ndarray, "times channels"]:
    """What the channels of one twin read with the rig's own start, degC; NaN where it fails."""
    network = equations(twin)
    for number in range(TRIES):
        limit = EVALUATIONS if number < TRIES - 1 else None
        try:
            return _readings(network, experiment, method, tolerance * 10**number, limit)
        except _StalledError:
            continue
    raise AssertionError("the last try has no limit")


def _readings(
    network: Equations,
    experiment: jt.Experiment,
    method: str,
    tolerance: float,
    limit: int | None,
) -> Float[np.ndarray, "times channels"]:
    time = experiment.time
    states = np.empty((len(time), len(network.initial)))
    states[0] = last = network.initial
    for start, end, command in stretches(experiment, network):
        solution = solve_ivp(
            _limited(lambda _, x, command=command: network.rate(x, command), limit),
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
        if inside.any():  # not behind a short delay
            states[inside] = solution.sol(time[inside]).T
        last = solution.y[:, -1]
    return network.readings(states, rooms(experiment, network))


def _limited(call: Callable[..., Any], limit: int | None) -> Callable[..., Any]:
    count = 0

    def counted(*given: Any) -> Any:
        nonlocal count
        count += 1
        if limit is not None and count > limit:
            raise _StalledError
        return call(*given)

    return counted
