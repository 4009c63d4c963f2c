"""Solves a twin's equations with any diffrax solver."""

from dataclasses import replace
from typing import final

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._arguments import finite_number, of_kind
from ..errors import SimulationError
from ..io import Experiment
from ..physics import System
from ..rig import Input
from ._drive import Drive
from ._initial import CheckedInitial, initial_temperatures
from ._input_levels import input_changes, input_levels
from ._network_exponential import HeldInputs, NetworkProblem, network_field
from ._rodas5p import Rodas5P
from ._time_grid import time_grid

# The largest mean number of steps of the stiff solver between two changes of the input. It usually
# needs some hundreds, and many more where its tolerance is near the rounding errors of the network:
# of 4000 draws between all bounds of `paper-2024`, three fail.
RESCUE_STEPS = 5000

# The limit of the steps of a solve that is differentiated: a power of 16, as diffrax rounds it, and
# for each sample.
MIN_MAX_STEPS, STEPS_PER_SAMPLE = 16**4, 64


@final
class DiffraxMethod(eqx.Module):
    """The options of `diffrax.diffeqsolve` for a twin.

    **Arguments:**

    - `solver`: any diffrax solver.
    - `stepsize_controller`: an adaptive controller; None for a `PIDController` at 1e-7 if the
      solver estimates its error, and otherwise for the steps of the default solver.
    - `dt0`: the first step of that controller, s; None: the controller chooses it.
    - `adjoint`: the adjoint of the solve; None for `diffrax.ForwardMode`, which stores no steps.
    - `max_steps`: the largest number of steps; None for no limit.
    """

    solver: diffrax.AbstractSolver
    stepsize_controller: diffrax.AbstractStepSizeController | None = None
    dt0: float | None = eqx.field(static=True, default=None)
    adjoint: diffrax.AbstractAdjoint | None = None
    max_steps: int | None = eqx.field(static=True, default=None)

    @property
    def calls_lapack(self) -> bool:
        """Whether the solver calls LAPACK for the linear systems of its steps."""
        if isinstance(self.solver, Rodas5P):
            return self.solver.sparsity is None
        return isinstance(self.solver, diffrax.AbstractImplicitSolver)


def checked_method(
    solver: diffrax.AbstractSolver,
    stepsize_controller: diffrax.AbstractStepSizeController | None,
    dt0: float | None,
    adjoint: diffrax.AbstractAdjoint | None,
) -> DiffraxMethod:
    """Checks the options that a user gives.

    **Raises:** `SimulationError` for options that diffrax does not accept, and for a controller
    that would step over input changes.
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
    if dt0 is not None:
        finite_number("dt0", dt0, SimulationError, above=0, unit="s")
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


def differentiable(method: DiffraxMethod, experiment: Experiment) -> DiffraxMethod:
    """The method with an adjoint for derivatives of both directions where none was chosen, and with
    a limit of its steps, without which diffrax gives none in reverse mode."""
    most = max(MIN_MAX_STEPS, STEPS_PER_SAMPLE * len(experiment.time))
    adjoint = diffrax.DirectAdjoint() if method.adjoint is None else method.adjoint
    return replace(method, adjoint=adjoint, max_steps=method.max_steps or most)


def stiff_method(experiment: Experiment, inputs: tuple[Input, ...]) -> DiffraxMethod:
    """The method for draws for which no steps of the default solver are short enough."""
    # With unbounded temperatures it would take shorter and shorter steps without end.
    changes = input_changes(experiment, input_levels(experiment, inputs))
    most = RESCUE_STEPS * (1 + len(changes))
    return DiffraxMethod(diffrax.Kvaerno5(), max_steps=most)


def solve_with_diffrax(
    system: System, experiment: Experiment, initial: CheckedInitial, method: DiffraxMethod
) -> tuple[Float[Array, "times rig_nodes"], Float[Array, "times channels"], diffrax.RESULTS]:
    """Runs a network through an experiment with a diffrax solver.

    Steps end at every input change, because a step across a change would be accurate for neither
    input.

    **Arguments:**

    - `system`: the equations.
    - `experiment`: the times, the inputs and the ambient temperature.
    - `initial`: the checked initial temperatures.
    - `method`: the solver and its options.

    **Returns:** absolute temperatures of the rig's nodes and of its channels at the experiment's
    times, K, and diffrax's own result.
    """
    grid = time_grid(system, experiment)
    drive = Drive.of(system, replace(grid, steady_start=isinstance(initial, str)))
    reference = drive.reference
    start = initial_temperatures(system, initial, grid.duty[0], reference)
    levels = input_levels(experiment, system.wiring.inputs)
    changes = input_changes(experiment, levels)
    held = np.concatenate([[0], changes])
    time = experiment.elapsed
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
        conditions=None
        if levels is None
        else jax.vmap(system.conditions)(jnp.asarray(levels[held])),
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
    """Makes a controller end a step just before each input change and start a step just after
    it."""
    time, delay = experiment.elapsed, system.delay
    controller = method.stepsize_controller
    if controller is None and isinstance(method.solver, diffrax.AbstractAdaptiveSolver):
        controller = diffrax.PIDController(rtol=1e-7, atol=1e-7)
    if isinstance(controller, diffrax.AbstractAdaptiveStepSizeController):
        if changes.size == 0 and delay is None:
            return controller
        jumps = jnp.asarray(time[changes])
        if delay is not None:
            # The driver delays commands, but not the ambient temperature.
            jumps = jnp.sort(jnp.concatenate([jumps, delay + jnp.append(jumps, 0.0)]))
        return diffrax.ClipStepSizeController(controller, jump_ts=jumps)
    # Without an error estimate: the steps of the default solver, known before anything is traced.
    grid = time_grid(system, experiment)
    sizes = np.asarray(grid.sizes)[np.asarray(grid.size)]
    changes = changes[changes < len(time) - 1]  # a change at the last sample has no effect
    ends = np.append(np.cumsum(sizes)[:-1], time[-1])
    nearest = np.abs(ends[:, None] - time[changes][None, :]).min(axis=1, initial=np.inf)
    around = [np.nextafter(time[changes], -np.inf), np.nextafter(time[changes], np.inf)]
    steps = np.unique(np.concatenate([[0.0], ends[nearest > 1e-6], *around]))
    return diffrax.StepTo(ts=jnp.asarray(steps))
