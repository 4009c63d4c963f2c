"""Simulates one run of a twin."""

import os
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._arguments import of_kind
from .._celsius import ZERO_CELSIUS
from .._compilation import persistent_jit, persistent_jit_unoptimised
from .._jax_settings import own_settings
from .._name_suggestions import did_you_mean
from .._progress import announced
from ..errors import SimulationError
from ..io import EXPERIMENT, Experiment, check_duty_of_rig, of_rig
from ..physics import Twin, check_twin, wiring_of
from ._check_values import check_values
from ._drive import Drive
from ._initial import CheckedInitial, Initial, checked_initial, initial_temperatures, keeps_symmetry
from ._integrate import integrate
from ._modes import run_modes, unresolved_network
from ._refinement import Results, needs_shorter_steps, solve_refined, stability_number
from ._run import Run
from ._time_grid import TimeGrid, padded_time_grid

if TYPE_CHECKING:
    import diffrax

    from ._diffeqsolve import DiffraxMethod


@runtime_checkable
class FittedTwins(Protocol):
    """The interface of `jaxtwin.Fit` that simulation uses: a twin for each experiment. Simulation
    cannot import matching."""

    def twin_for(self, experiment: Experiment) -> Twin:
        """The twin with the experiment's own values."""
        ...


def twin_of_experiment(twin: Twin | FittedTwins, experiment: Experiment) -> Twin:
    """Returns a twin unchanged, or the twin of a fit for an experiment.

    **Raises:** `SimulationError` if it is neither, or the experiment is none; the errors of
    `Fit.twin_for`.
    """
    if not isinstance(twin, FittedTwins):
        check_twin("twin", twin, SimulationError)
    if isinstance(experiment, str | os.PathLike):
        place = repr(os.fspath(experiment))
        raise SimulationError(
            f"experiment: expected {EXPERIMENT}, got {place}; read a file with "
            f"read_recording({place}), or run a schedule in words with twin.simulate"
        )
    of_kind("experiment", experiment, Experiment, EXPERIMENT, SimulationError)
    return twin.twin_for(experiment) if isinstance(twin, FittedTwins) else twin


# The numbers of nodes, of all and for each cell, from which on a run uses few modes. All modes of
# 600 nodes take a tenth of a second; each cell adds 26 vectors to the space of the few modes.
LARGE, NODES_PER_CELL = 600, 104


@announced("simulation")
def simulate(
    twin: Twin | FittedTwins,
    experiment: Experiment,
    *,
    initial: Initial = None,
    solver: "diffrax.AbstractSolver | None" = None,
    stepsize_controller: "diffrax.AbstractStepSizeController | None" = None,
    dt0: float | None = None,
) -> Run:
    """Simulates a twin over an experiment, in float64.

    The default solver integrates the linear network exactly and the heat flows of the cells in
    steps of fourth order (see `jaxtwin.simulation`). It was the fastest solver measured at errors
    below 1e-3 K in the channels. The solver estimates its error. If the error is too large, or the
    heat flows of the cells are stiff (`stability_number`), the run is solved again with steps of a
    quarter, then of an eighth, and at last by `diffrax.Kvaerno5`. For networks of 600 nodes and
    more, the solver uses only the few modes that the drive reaches, and estimates the error of this
    reduction.

    **Arguments:**

    - `twin`: the twin; or a fit, which is run with the experiment's own values, see `Fit.twin_for`.
    - `experiment`: the duty cycles, each held until the next sample. Its ambient temperature, if it
      was recorded, replaces that of the rig. If the experiment names channels, only these are
      returned.
    - `initial`: the temperatures at the start. None: those of the rig file. `"steady"`: the steady
      state under the first input. A number: a uniform temperature, degC. An array `(nodes,)`: the
      temperature of each node, degC. Names of nodes -> degC: these, while the others begin as the
      rig file says.
    - `solver`: any diffrax solver, or None for the default.
    - `stepsize_controller`, `dt0`: an adaptive step size controller for this solver and its first
      step, s. The default is a `PIDController` with tolerances of 1e-7 if the solver estimates its
      error, otherwise the steps of the default solver. Steps always end at changes of the input.

    **Returns:** a `Run` at the times of the experiment.

    **Raises:** `SimulationError` if experiment and rig do not match, if the solve does not reach
    its end, if a step size controller is given without a solver, or if float64 cannot resolve the
    rates of the network (the fastest rate times the duration, or times the longest time constant if
    that is shorter, above 2e11; this happens at contacts below about 1e-11 K/W); `ParameterError`
    if a resistance, a heat capacity, or the driver's lag or delay is not above 0, or if a parameter
    has several values.
    """
    method = chosen_method(solver, stepsize_controller, dt0)
    twin = twin_of_experiment(twin, experiment)
    experiment = ordered(experiment, twin)
    channels = checked_channels(twin, experiment)
    check_values(twin)
    start = checked_initial(twin, initial)

    def solve(_: Int[np.ndarray, " draws"], refinement: int) -> Results:
        grid = padded_time_grid(twin, experiment, refinement, steady_start=isinstance(start, str))
        solution = None
        if is_large(twin, start):
            from ._reduced_modes import run_reduced  # SciPy's sparse solvers take a while to import

            solution = run_reduced(twin, grid, start)
        if solution is None:
            solution = run_exponential(twin, grid, start)
        states, readings, number, error = solution
        samples = slice(len(experiment.time))
        return {
            "states": np.array(states)[None, samples],
            "readings": np.array(readings)[None, samples],
            "refused": needs_shorter_steps(number, error, refinement)[None],
        }

    def solve_by(method: "DiffraxMethod") -> Results:
        from ._diffrax_programs import diffrax_run, is_successful

        states, readings, result = diffrax_run(twin, start, experiment, method)
        if not is_successful(result):
            name = type(method.solver).__name__
            raise SimulationError(
                f"{twin.rig.name}: {name}: {result}. If the temperatures do not stay finite or "
                "change too fast, look for parameters far outside their bounds"
            )
        return {"states": np.asarray(states)[None], "readings": np.asarray(readings)[None]}

    def rescue(_: Int[np.ndarray, " draws"]) -> Results:
        from ._diffeqsolve import stiff_method

        return solve_by(stiff_method(experiment, twin.rig.inputs))

    with own_settings():
        if method is None:
            results = solve_refined(1, solve, rescue)
        else:
            _check_resolved(twin, experiment)
            results = solve_by(method)
        states, readings = results["states"][0], results["readings"][0]
        if not np.isfinite(states).all():
            _check_resolved(twin, experiment)
            raise SimulationError(
                f"{twin.rig.name}: the temperatures do not stay finite; look for parameters far "
                "outside their bounds"
            )
    return Run(
        experiment=experiment,
        channels=channels,
        temperatures=readings[:, [twin.channels.index(name) for name in channels]] - ZERO_CELSIUS,
        nodes=tuple(node.name for node in twin.netlist.nodes),
        states=states - ZERO_CELSIUS,
        rig=twin.rig.name,
        elements=len(twin.rig.plate.element_names),
        twin=twin,
        is_steady_start=isinstance(start, str),
    )


def prepare_simulation(twin: Twin, experiment: Experiment) -> None:
    """Compiles or loads the programs that `simulate` runs first for such a twin and experiment.

    A thread can do this while another estimates the values with which the twin is simulated.
    """
    if not is_large(twin, None):
        with own_settings():
            run_exponential.prepare(twin, padded_time_grid(twin, experiment), None)


def is_large(twin: Twin, initial: CheckedInitial) -> bool:
    """Whether a run of a twin uses few modes: the network is large, and few cells drive it."""
    if isinstance(initial, str) or twin.rig.inputs:
        return False
    netlist = wiring_of(twin.rig, keeps_symmetry(initial)).netlist
    return len(netlist.nodes) >= max(LARGE, NODES_PER_CELL * len(netlist.cells))


def response(
    twin: Twin | FittedTwins,
    experiment: Experiment,
    *,
    initial: Initial = None,
    solver: "diffrax.AbstractSolver | None" = None,
    stepsize_controller: "diffrax.AbstractStepSizeController | None" = None,
    dt0: float | None = None,
    adjoint: "diffrax.AbstractAdjoint | None" = None,
) -> Float[Array, "times channels"]:
    """Computes the temperatures of the channels as a pure JAX function of the twin's parameters.

    The function can be called inside `jax.jit`, `jax.vmap`, `jax.jacfwd` and `jax.grad`; outside of
    `jax.jit` it is compiled by itself. `simulate` computes the same and adds checks and labels.
    The precision is that of the caller: call it inside `jax.enable_x64(True)` for float64.
    A duty or a room that is differentiated needs `jaxtwin.Stepper`: an `Experiment` holds numbers.
    The default solver always takes its longest steps; only `simulate` checks whether shorter steps
    or a stiff solver are needed. The result is NaN if float64 cannot resolve the rates of the
    network, for which `simulate` raises an error, and if a diffrax solver does not reach the end.

    **Arguments:** those of `simulate`, and

    - `adjoint`: the adjoint of a diffrax solve, which determines how it is differentiated. The
      default is `diffrax.DirectAdjoint()`, for both `jax.grad` and `jax.jacfwd`. For one of them
      `diffrax.RecursiveCheckpointAdjoint()` or `diffrax.ForwardMode()` take less memory or time.

    **Returns:** `(times, channels)`, degC, for the channels that the experiment names, else all.

    **Raises:** `SimulationError` if experiment and rig do not match, or if diffrax does not accept
    an option.
    """
    method = chosen_method(solver, stepsize_controller, dt0, adjoint)
    twin = twin_of_experiment(twin, experiment)
    experiment = ordered(experiment, twin)
    names = checked_channels(twin, experiment)
    columns = np.array([twin.channels.index(name) for name in names])
    start = checked_initial(twin, initial)
    with own_settings(float64=None):
        if method is None:
            grid = padded_time_grid(twin, experiment, steady_start=isinstance(start, str))
            _, readings, _, _ = run_exponential(twin, grid, start)
        else:
            from ._diffeqsolve import differentiable
            from ._diffrax_programs import diffrax_run, is_successful

            method = differentiable(method, experiment)
            _, readings, result = diffrax_run(twin, start, experiment, method)
            readings = jnp.where(is_successful(result), readings, jnp.nan)
        return readings[: len(experiment.time), columns] - ZERO_CELSIUS


def ordered(experiment: Experiment, twin: Twin) -> Experiment:
    """Returns an experiment with its columns of duty in the order of a twin's rig.

    **Raises:** `SimulationError` if the rig has other cells and heaters.
    """
    check_twin("twin", twin, SimulationError)
    of_kind("experiment", experiment, Experiment, EXPERIMENT, SimulationError)
    return of_rig(experiment, twin.rig, experiment.name or "the experiment", SimulationError)


def checked_channels(twin: Twin, experiment: Experiment) -> tuple[str, ...]:
    """Returns the channels that an experiment requests of a twin.

    **Raises:** `SimulationError` if the experiment names a channel that the rig does not have, or
    drives another number of cells and heaters, a heater is to cool, or it states an input that the
    rig does not have.
    """
    check_twin("twin", twin, SimulationError)
    of_kind("experiment", experiment, Experiment, EXPERIMENT, SimulationError)
    label = experiment.name or "the experiment"
    check_duty_of_rig(experiment, twin.rig, label, SimulationError)
    unknown = [name for name in experiment.channels if name not in twin.channels]
    if unknown:
        raise SimulationError(
            f"{label}: channels: expected those of {twin.rig.name}, {', '.join(twin.channels)}, "
            f"got {', '.join(unknown)}{did_you_mean(unknown, twin.channels)}"
        )
    return experiment.channels or twin.channels


def chosen_method(
    solver: "diffrax.AbstractSolver | None",
    stepsize_controller: "diffrax.AbstractStepSizeController | None",
    dt0: float | None,
    adjoint: "diffrax.AbstractAdjoint | None" = None,
) -> "DiffraxMethod | None":
    """Returns the method by which diffrax solves; None for the default solver.

    **Raises:** `SimulationError` for an option that diffrax does not accept, and for options of a
    diffrax solver without a solver.
    """
    if solver is not None:
        from ._diffeqsolve import checked_method

        return checked_method(solver, stepsize_controller, dt0, adjoint)
    options = {"stepsize_controller": stepsize_controller, "dt0": dt0, "adjoint": adjoint}
    given = [name for name, value in options.items() if value is not None]
    if given:
        raise SimulationError(
            f"{', '.join(given)}: expected a solver beside it, got none; pass solver=..., as the "
            "default solver chooses its own steps"
        )
    return None


def _check_resolved(twin: Twin, experiment: Experiment) -> None:
    if np.isnan(_stability_number(twin, padded_time_grid(twin, experiment))):
        raise unresolved_network(twin)


@persistent_jit_unoptimised
def _stability_number(twin: Twin, grid: TimeGrid) -> Float[Array, ""]:
    system, inputs = twin.system(lumped=True), grid.summary()
    return stability_number(system, run_modes(system, inputs), inputs)


@persistent_jit
def run_exponential(
    twin: Twin, grid: TimeGrid, initial: CheckedInitial
) -> tuple[
    Float[Array, "times rig_nodes"],
    Float[Array, "times channels"],
    Float[Array, ""],
    Float[Array, ""],
]:
    """Computes the absolute temperatures of the rig's nodes and of its channels, K, the
    `stability_number`, and the error estimate of the solution, K."""
    system = twin.system(lumped=keeps_symmetry(initial))
    inputs = grid.summary()
    drive, modes = Drive.of(system, grid), run_modes(system, inputs)
    start = initial_temperatures(system, initial, inputs.first, drive.reference)
    read = integrate(system, drive, modes, start, np.eye(start.size))
    deviation = read.at_samples(drive.grid)
    readings = system.channel_temperatures(deviation, drive.ambient_at_samples())
    states = deviation[:, system.wiring.position] + drive.reference
    number = stability_number(system, modes, inputs)
    return states, readings + drive.reference, number, read.error_estimate
