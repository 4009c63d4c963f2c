"""Any diffrax solver on a twin's equations."""

from dataclasses import replace
from typing import final

import diffrax
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._arguments import finite_number, of_kind
from .._errors import SimulationError
from ..io import Experiment
from ..physics import System
from ._drive import Drive
from ._initial import CheckedInitial, initial_temperatures
from ._network_exponential import HeldInputs, NetworkProblem, network_field
from ._time_grid import time_grid

RESCUE_STEPS = 5000
"""Of the stiff solver that takes over, between two changes of the input on average, at most; it
needs some hundreds."""


@final
class DiffraxMethod(eqx.Module):
    """How `diffrax.diffeqsolve` is to solve a twin.

    **Arguments:**

    - `solver`: any diffrax solver.
    - `stepsize_controller`: an adaptive one; None for a `PIDController` at 1e-7 where the solver
      estimates its error, else for the steps that the default solver takes.
    - `dt0`: first step of that controller, s; None lets it choose.
    - `adjoint`: how derivatives pass through the solve; None for `diffrax.ForwardMode`, which keeps
      no steps, however many they are.
    - `max_steps`: None for no limit.
    """

    solver: diffrax.AbstractSolver
    stepsize_controller: diffrax.AbstractStepSizeController | None = None
    dt0: float | None = eqx.field(static=True, default=None)
    adjoint: diffrax.AbstractAdjoint | None = None
    max_steps: int | None = eqx.field(static=True, default=None)

    @property
    def is_implicit(self) -> bool:
        """Whether its steps solve equations."""
        return isinstance(self.solver, diffrax.AbstractImplicitSolver)


def checked_method(
    solver: diffrax.AbstractSolver,
    stepsize_controller: diffrax.AbstractStepSizeController | None,
    dt0: float | None,
    adjoint: diffrax.AbstractAdjoint | None,
) -> DiffraxMethod:
    """The method that a user asks for.

    **Raises:** `SimulationError` for what diffrax cannot take, and for a controller that would step
    over input changes.
    """
    kinds = (
        ("solver", solver, diffrax.AbstractSolver, "a diffrax solver or None"),
        (
            "stepsize_controller",
            stepsize_controller,
            diffrax.AbstractStepSizeController,
            "a diffrax controller or None",
        ),
        ("adjoint", adjoint, diffrax.AbstractAdjoint, "a diffrax adjoint or None"),
    )
    for name, value, kind, expected in kinds:
        if value is not None:
            of_kind(name, value, kind, expected, SimulationError)
    if dt0 is not None and finite_number("dt0", dt0, SimulationError) <= 0:
        raise SimulationError(f"dt0: expected a number above 0, in s, or None, got {dt0!r}")
    if stepsize_controller is not None:
        if not isinstance(stepsize_controller, diffrax.AbstractAdaptiveStepSizeController):
            raise SimulationError(
                "stepsize_controller: expected an adaptive controller or None, got "
                f"{type(stepsize_controller).__name__}; others step over input changes"
            )
    elif dt0 is not None and not isinstance(solver, diffrax.AbstractAdaptiveSolver):
        raise SimulationError(
            f"dt0: expected None for {type(solver).__name__}, which has no error estimate and "
            f"takes the steps of the default solver, got {dt0!r}"
        )
    return DiffraxMethod(solver, stepsize_controller, None if dt0 is None else float(dt0), adjoint)


def stiff_method(experiment: Experiment) -> DiffraxMethod:
    """The method that takes over where no steps of the default solver are short enough."""
    # Temperatures without a bound would keep it at ever shorter steps.
    most = RESCUE_STEPS * (1 + len(_input_changes(experiment)))
    return DiffraxMethod(diffrax.Kvaerno5(), max_steps=most)


def solve_with_diffrax(
    system: System, experiment: Experiment, initial: CheckedInitial, method: DiffraxMethod
) -> tuple[Float[Array, "times rig_nodes"], Float[Array, "times channels"], diffrax.RESULTS]:
    """Runs a network through an experiment with a diffrax solver.

    Steps end at every input change and start anew behind it: a step that straddled one would see
    neither input.

    **Arguments:**

    - `system`: the equations.
    - `experiment`: its times, inputs and ambient.
    - `initial`: the start, checked.
    - `method`: solver and options.

    **Returns:** absolute temperatures of the rig's nodes and of its channels at the experiment's
    times, K, and diffrax's own result.
    """
    grid = time_grid(system, experiment)
    drive = Drive.of(system, replace(grid, steady_start=isinstance(initial, str)))
    reference = drive.reference
    start = initial_temperatures(system, initial, grid.duty[0], reference)
    changes = _input_changes(experiment)
    held = np.concatenate([[0], changes])
    time = experiment.time - experiment.time[0]
    ambient = jnp.zeros(len(held))
    if grid.ambient_at is not None:
        ambient = jnp.asarray(grid.ambient_at[held]) - reference
    inputs = HeldInputs(
        starts=jnp.asarray(time[held]),
        duty=jnp.asarray(experiment.duty[held]),
        ambient=ambient,
        lag=system.lag,
        delay=system.delay,
        steady_start=isinstance(initial, str),
        drift=drive.ambient_drift,
    )
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(network_field),
        method.solver,
        t0=0.0,
        t1=float(time[-1]),
        dt0=method.dt0,
        y0=start - reference,
        args=NetworkProblem(system, inputs, reference),
        saveat=diffrax.SaveAt(ts=jnp.asarray(time)),
        stepsize_controller=_clipped(method, experiment, changes, system),
        adjoint=diffrax.ForwardMode() if method.adjoint is None else method.adjoint,
        max_steps=method.max_steps,
        throw=False,
    )
    deviation = solution.ys
    assert deviation is not None
    readings = system.channel_temperatures(deviation, drive.ambient_at_samples())
    states = deviation[:, system.wiring.position] + reference
    return states, readings + reference, solution.result


def _clipped(
    method: DiffraxMethod,
    experiment: Experiment,
    changes: Int[np.ndarray, " changes"],
    system: System,
) -> diffrax.AbstractStepSizeController:
    """A controller that ends a step just before each input change and starts one just behind."""
    time, delay = experiment.time - experiment.time[0], system.delay
    controller = method.stepsize_controller
    if controller is None and isinstance(method.solver, diffrax.AbstractAdaptiveSolver):
        controller = diffrax.PIDController(rtol=1e-7, atol=1e-7)
    if isinstance(controller, diffrax.AbstractAdaptiveStepSizeController):
        if changes.size == 0 and delay is None:
            return controller
        jumps = jnp.asarray(time[changes])
        if delay is not None:
            # Commands arrive late, the ambient does not.
            jumps = jnp.sort(jnp.concatenate([jumps, delay + jnp.append(jumps, 0.0)]))
        return diffrax.ClipStepSizeController(controller, jump_ts=jumps)
    # Without an error estimate: the steps of the default solver, known before anything is traced.
    grid = time_grid(system, experiment)
    sizes = np.asarray(grid.sizes)[np.asarray(grid.size)]
    changes = changes[changes < len(time) - 1]  # a change at the last sample is never felt
    ends = np.append(np.cumsum(sizes)[:-1], time[-1])
    nearest = np.abs(ends[:, None] - time[changes][None, :]).min(axis=1, initial=np.inf)
    around = [np.nextafter(time[changes], -np.inf), np.nextafter(time[changes], np.inf)]
    steps = np.unique(np.concatenate([[0.0], ends[nearest > 1e-6], *around]))
    return diffrax.StepTo(ts=jnp.asarray(steps))


def _input_changes(experiment: Experiment) -> Int[np.ndarray, " changes"]:
    """The samples at which an input differs from the sample before."""
    duty, ambient = experiment.duty, experiment.ambient
    changed = np.any(duty[1:] != duty[:-1], axis=1)
    if isinstance(ambient, np.ndarray):
        changed |= ambient[1:] != ambient[:-1]
    return 1 + np.flatnonzero(changed)
