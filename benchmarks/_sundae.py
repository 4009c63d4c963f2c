"""CVODE of SUNDIALS by scikit-sundae, one draw after the other, with equations in NumPy."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from sksundae.cvode import CVODE

from ._equations import Equations, equations, rooms, stretches
from ._task import Task


def cvode(task: Task, count: int, tolerance: float) -> Callable[[], Float[np.ndarray, "d t c"]]:
    """With the analytic Jacobian, dense, and a fresh start at each change of the input."""
    networks = [equations(twin) for twin in task.twins(count)]
    parts = stretches(task.experiment, networks[0])
    room = rooms(task.experiment, networks[0])

    def solve(network: Equations) -> Float[np.ndarray, "t c"]:
        def rate(_: float, x: np.ndarray, rates: np.ndarray, held: tuple[np.ndarray]) -> None:
            rates[:] = network.rate(x, held[0])

        def jacobian(
            _: float, x: np.ndarray, rates: np.ndarray, slopes: np.ndarray, held: tuple[np.ndarray]
        ) -> None:
            slopes[:] = network.jacobian(x, held[0])

        states = [network.initial[None]]
        for start, end, command in parts:
            solver = CVODE(
                rate,
                jacfn=jacobian,
                userdata=(command,),  # an array has no truth value, which it asks for
                rtol=tolerance,
                atol=tolerance,
                max_num_steps=10_000,
            )
            times = np.arange(start, end + 0.5)
            solution = solver.solve(times, states[-1][-1])
            # With two times it gives all its steps between them.
            states.append(solution.y[1:] if len(times) > 2 else solution.y[-1:])
        return network.readings(np.concatenate(states), room)

    return lambda: np.stack([solve(network) for network in networks])
