"""Any diffrax solver on a twin's equations."""

import diffrax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._errors import SimulationError
from ..io import Experiment
from ..physics import System
from ._schedule import Schedule, twin_schedule
from ._solver import HeldInputs, NetworkProblem, network_field


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
    max_steps: int | None,
) -> tuple[Float[Array, "times nodes"], diffrax.RESULTS]:
    """Runs a network through an experiment with a diffrax solver.

    Steps end at every input change and start anew behind it: a step that straddled one would see
    neither input.

    **Returns:** the nodes' deviations from the reference at the experiment's times, and diffrax's
    own result.
    """
    time = experiment.time - experiment.time[0]
    changes = input_changes(experiment)
    starts = jnp.asarray(np.concatenate([[0.0], time[changes]]))
    held = np.concatenate([[0], changes])
    duty = jnp.asarray(experiment.duty[held])
    if schedule.ambient_at is None:
        ambient = jnp.zeros(len(held))
    else:
        ambient = jnp.asarray(schedule.ambient_at[held]) - reference

    drift = system.ambient_drift if schedule.ambient_at is None else None
    inputs = HeldInputs(starts, duty, ambient, system.lag, system.delay, at_rest, drift)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(network_field),
        solver,
        t0=0.0,
        t1=float(time[-1]),
        dt0=dt0,
        y0=initial - reference,
        args=NetworkProblem(system, inputs, reference),
        saveat=diffrax.SaveAt(ts=jnp.asarray(time)),
        stepsize_controller=_clipped(solver, controller, dt0, experiment, changes, system),
        # Jacobians by forward mode, which keeps no steps, however many they are.
        adjoint=diffrax.ForwardMode(),
        max_steps=max_steps,
        throw=False,
    )
    assert solution.ys is not None
    return solution.ys, solution.result


def _clipped(
    solver: diffrax.AbstractSolver,
    controller: diffrax.AbstractStepSizeController | None,
    dt0: float | None,
    experiment: Experiment,
    changes: Int[np.ndarray, " changes"],
    system: System,
) -> diffrax.AbstractStepSizeController:
    """A controller that ends a step just before each input change and starts one just behind."""
    time, delay = experiment.time - experiment.time[0], system.delay
    if controller is None and isinstance(solver, diffrax.AbstractAdaptiveSolver):
        controller = diffrax.PIDController(rtol=1e-7, atol=1e-7)
    if controller is not None:
        if not isinstance(controller, diffrax.AbstractAdaptiveStepSizeController):
            raise SimulationError(
                f"stepsize_controller: found {type(controller).__name__}, allowed are adaptive "
                "controllers, or None: others step over input changes"
            )
        if changes.size == 0 and delay is None:
            return controller
        jumps = jnp.asarray(time[changes])
        if delay is not None:
            # Commands arrive late, the ambient does not.
            jumps = jnp.sort(jnp.concatenate([jumps, delay + jnp.append(jumps, 0.0)]))
        return diffrax.ClipStepSizeController(controller, jump_ts=jumps)
    if dt0 is not None:
        raise SimulationError(
            f"dt0: found {dt0!r}, allowed is None for {type(solver).__name__}, which has no error "
            "estimate and takes the steps of the default solver"
        )
    # Without an error estimate: the steps of the default solver, known before anything is traced.
    schedule = twin_schedule(system, experiment)
    sizes = np.asarray(schedule.sizes)[np.asarray(schedule.size)]
    changes = changes[changes < len(time) - 1]  # one at the last sample is never felt
    ends = np.append(np.cumsum(sizes)[:-1], time[-1])
    nearest = np.abs(ends[:, None] - time[changes][None, :]).min(axis=1, initial=np.inf)
    around = [np.nextafter(time[changes], -np.inf), np.nextafter(time[changes], np.inf)]
    steps = np.unique(np.concatenate([[0.0], ends[nearest > 1e-6], *around]))
    return diffrax.StepTo(ts=jnp.asarray(steps))


def input_changes(experiment: Experiment) -> np.ndarray:
    """The samples at which an input differs from the one before."""
    duty, ambient = experiment.duty, experiment.ambient
    changed = np.any(duty[1:] != duty[:-1], axis=1)
    if isinstance(ambient, np.ndarray):
        changed |= ambient[1:] != ambient[:-1]
    return 1 + np.flatnonzero(changed)
