"""Any diffrax solver on a twin's equations."""

import diffrax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..io import Experiment
from ..physics import System
from ._actuator import lagged_duty
from ._schedule import Schedule


def solve_with_diffrax(
    system: System,
    schedule: Schedule,
    initial: Float[Array, " nodes"],
    reference: Float[Array, ""],
    experiment: Experiment,
    solver: diffrax.AbstractSolver,
    controller: diffrax.AbstractStepSizeController | None,
    dt0: float | None,
    at_rest: bool,
) -> tuple[Float[Array, "times nodes"], diffrax.RESULTS]:
    """Runs a network through an experiment with a diffrax solver.

    Steps end at every input change and start anew behind it: a step that straddled one would see
    neither input.

    **Returns:** the nodes' deviations from the reference at the experiment's times, and diffrax's
    own result.
    """
    time = experiment.time - experiment.time[0]
    changes = _changes(experiment)
    starts = jnp.asarray(np.concatenate([[0.0], time[changes]]))
    held = np.concatenate([[0], changes])
    duty = jnp.asarray(experiment.duty[held])
    if schedule.ambient_at is None:
        ambient = jnp.zeros(len(held))
    else:
        ambient = jnp.asarray(schedule.ambient_at[held]) - reference

    def field(t: Float[Array, ""], deviation: Array, system: System) -> Float[Array, " nodes"]:
        now = jnp.searchsorted(starts, t, side="right") - 1
        given = duty[now]
        if system.lag is not None:
            given = lagged_duty(system.lag, system.delay, starts, duty, t, at_rest)
        heat = system.heat_into_nodes(deviation, given, reference, ambient[now])
        return heat / system.capacitance

    if controller is None:
        adaptive = isinstance(solver, diffrax.AbstractAdaptiveSolver)
        controller = (
            diffrax.PIDController(rtol=1e-7, atol=1e-7) if adaptive else diffrax.ConstantStepSize()
        )
    if dt0 is None and not isinstance(controller, diffrax.PIDController):
        dt0 = 0.5 * float(np.median(np.diff(time)))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        solver,
        t0=0.0,
        t1=float(time[-1]),
        dt0=dt0,
        y0=initial - reference,
        args=system,
        saveat=diffrax.SaveAt(ts=jnp.asarray(time)),
        stepsize_controller=diffrax.ClipStepSizeController(
            controller, jump_ts=jnp.asarray(time[changes])
        ),
        # Jacobians by forward mode; the twin is small and its step count unbounded beforehand.
        adjoint=diffrax.ForwardMode(),
        max_steps=None,
        throw=False,
    )
    assert solution.ys is not None
    return solution.ys, solution.result


def _changes(experiment: Experiment) -> np.ndarray:
    """The samples at which an input differs from the one before."""
    duty, ambient = experiment.duty, experiment.ambient
    changed = np.any(duty[1:] != duty[:-1], axis=1)
    if isinstance(ambient, np.ndarray):
        changed |= ambient[1:] != ambient[:-1]
    return 1 + np.flatnonzero(changed)
