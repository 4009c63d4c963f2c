"""scipy's LSODA, one draw after the other, as most scripts do it."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.integrate import odeint

from ._equations import Equations, equations, rooms, stretches
from ._task import Task


def lsoda(task: Task, count: int, tolerance: float) -> Callable[[], Float[np.ndarray, "d t c"]]:
    """With the analytic Jacobian, and a fresh start at each change of the input."""
    networks = [equations(twin) for twin in task.twins(count)]
    parts = stretches(task.experiment, networks[0])
    room = rooms(task.experiment, networks[0])

    def solve(network: Equations) -> Float[np.ndarray, "t c"]:
        states = [network.initial[None]]
        for start, end, command in parts:
            solution = odeint(
                lambda x, _, command: network.rate(x, command),
                states[-1][-1],
                np.arange(start, end + 0.5),
                args=(command,),
                Dfun=lambda x, _, command: network.jacobian(x, command),
                rtol=tolerance,
                atol=tolerance,
                mxstep=10000,
            )
            states.append(solution[1:])
        return network.readings(np.concatenate(states), room)

    return lambda: np.stack([solve(network) for network in networks])
