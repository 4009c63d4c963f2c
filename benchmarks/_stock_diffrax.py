"""Stock diffrax: one of its solvers with adaptive steps, vmapped over the draws."""

from collections.abc import Callable

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ._equations import equations, rooms, stretches
from ._task import Task

Run = Callable[[], Float[np.ndarray, "d t c"]]


def stock_diffrax(solver: diffrax.AbstractSolver, task: Task, count: int, tolerance: float) -> Run:
    """The equations as a diffrax user writes them, with a fresh step at each change of the input.

    A driver's lag is a state more for each cell.
    """
    time = task.experiment.time
    network = equations(task.twin)
    parts, room = stretches(task.experiment, network), rooms(task.experiment, network)
    begins = jnp.array([start for start, _, _ in parts])
    commands = jnp.stack([jnp.asarray(command) for _, _, command in parts])
    cells, draws = commands.shape[1] - 1, task.draws(count)

    def solve(values: dict[str, jax.Array]) -> jax.Array:
        system = task.twin.with_values(values).system()
        reference = system.ambient_temperature

        def field(t, state, system):
            command = commands[jnp.searchsorted(begins, t, side="right") - 1]
            command, room = command[:-1], command[-1]
            if system.lag is None:
                return system.heat_into_nodes(state, command, reference, room) / system.capacitance
            x, duty = state[:-cells], state[-cells:]
            slope = system.heat_into_nodes(x, duty, reference, room) / system.capacitance
            return jnp.concatenate([slope, (command - duty) / system.lag])

        rest = jnp.zeros(0 if system.lag is None else cells)
        start = jnp.concatenate([system.initial_temperature - reference, rest])
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            solver,
            t0=0.0,
            t1=float(time[-1]),
            dt0=None,
            y0=start,
            args=system,
            saveat=diffrax.SaveAt(ts=jnp.asarray(time)),
            stepsize_controller=diffrax.ClipStepSizeController(
                diffrax.PIDController(rtol=tolerance, atol=tolerance), jump_ts=begins[1:]
            ),
            max_steps=None,
            adjoint=diffrax.ForwardMode(),
        )
        assert solution.ys is not None
        rises = solution.ys[:, : system.capacitance.size]
        return system.channel_temperatures(rises, room[:, None]) + reference - 273.15

    compiled = jax.jit(jax.vmap(solve))

    def run() -> Float[np.ndarray, "d t c"]:
        with jax.enable_x64(True):
            return np.asarray(compiled({name: jnp.asarray(v) for name, v in draws.items()}))

    run()
    return run
