"""One run of a twin."""

from functools import lru_cache
from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from .._arguments import finite_number, of_kind
from .._errors import ParameterError, SimulationError
from .._jax_settings import own_settings
from ..io import Experiment
from ..io._experiment import EXPERIMENT
from ..physics import System, Twin, build_netlist, check_twin
from ..rig import Rig, Value
from ._ambient import ambient_of_samples, reference_temperature
from ._initial import Initial, checked_initial, initial_temperatures, keeps_symmetry
from ._own_twin import FittedTwins, own_twin
from ._padding import padded_schedule
from ._resolution import unresolved_network
from ._run import Run
from ._schedule import REFINEMENTS, Schedule, twin_schedule
from ._solve import (
    arriving,
    coupling_left,
    schedule_modes,
    solve_steps,
    too_coarse,
)

if TYPE_CHECKING:
    import diffrax


RESCUE_STEPS = 5000
"""Of the stiff solver that takes over, between two changes of the input on average, at most; it
needs some hundreds."""


def simulate(
    twin: Twin | FittedTwins,
    experiment: Experiment,
    *,
    initial: Initial = None,
    solver: "diffrax.AbstractSolver | None" = None,
    stepsize_controller: "diffrax.AbstractStepSizeController | None" = None,
    dt0: float | None = None,
) -> Run:
    """Runs a twin through an experiment, in float64.

    The default solver integrates the linear network exactly and steps over the cells' heat flows
    (see `jaxtwin.simulation`); it is the fastest that was measured at errors below 1e-3 K in the
    channels. It looks at its own error: where that is in doubt, or the cells' heat flows are stiff
    in themselves (`coupling_left`), its steps are halved, and where three halvings do not help
    `diffrax.Kvaerno5` takes its place.

    **Arguments:**

    - `twin`: the twin; or a fit, which is run with the experiment's own values, see `Fit.twin_for`.
    - `experiment`: its duty cycles drive the twin, held from sample to sample. A recorded ambient
      takes the place of the rig's. Where it names channels, these are returned.
    - `initial`: temperatures at the start. None: as the rig says. `"steady"`: at rest under the
      first input. A number: uniform, degC. An array `(nodes,)`: each node, degC.
    - `solver`: any diffrax solver, or None for the default.
    - `stepsize_controller`, `dt0`: an adaptive controller for that solver and its first step, s.
      By default a `PIDController` at 1e-7 where the solver estimates its error, else the steps that
      the default solver takes. Steps always end at input changes.

    **Returns:** a `Run` at the experiment's times.

    **Raises:** `SimulationError` where experiment and rig do not belong together, or the solve
    does not reach its end, or a controller comes without a solver, or the network's rates are
    further apart than float64 can tell (the fastest one times the run, or the longest time
    constant where that is shorter, above 2e11: contacts below some 1e-11 K/W); `ParameterError`
    where a resistance, a heat capacity, or a driver's lag or delay is not above 0, or a parameter
    holds more than one value.
    """
    if solver is not None:
        _check_solver(solver, stepsize_controller, dt0)
    if solver is None and not (stepsize_controller is None and dt0 is None):
        raise SimulationError(
            "stepsize_controller, dt0: found without a solver, allowed is beside one; the default "
            "solver chooses its steps itself"
        )
    twin = own_twin(twin, experiment)
    channels = checked_channels(twin, experiment)
    _check_values(twin)
    start = checked_initial(twin, initial)
    with own_settings():
        if solver is not None:
            _check_resolved(twin, padded_schedule(twin, experiment))
        for refinement in range(REFINEMENTS + 1 if solver is None else 0):
            schedule = padded_schedule(twin, experiment, refinement)
            states, readings, coupling, doubt = _run_exponential(twin, schedule, start)
            if not too_coarse(coupling, doubt, refinement):
                break
        else:
            schedule = twin_schedule(twin, experiment)
            states, readings = _run_checked(
                twin, schedule, start, experiment, solver, stepsize_controller, dt0
            )
        times = len(experiment.time)
        states, readings = np.asarray(states)[:times], np.asarray(readings)[:times]
    if not np.isfinite(states).all():
        with own_settings():
            _check_resolved(twin, padded_schedule(twin, experiment))
        raise SimulationError(
            f"{twin.rig.name}: the temperatures do not stay finite; look for parameters far "
            "outside their bounds"
        )
    return Run(
        experiment=experiment,
        channels=channels,
        temperatures=readings[:, [twin.channels.index(name) for name in channels]] - 273.15,
        nodes=tuple(node.name for node in twin.netlist.nodes),
        states=states - 273.15,
        rig=twin.rig.name,
    )


def response(
    twin: Twin | FittedTwins, experiment: Experiment, *, initial: Initial = None
) -> Float[Array, "times channels"]:
    """The channels' temperatures as a pure JAX function of the twin's parameters, degC.

    For one's own `jax.jit`, `jax.vmap`, `jax.jacfwd` or `jax.grad`; compiled by itself where it is
    called outside of `jax.jit`. `simulate` is this with checks and labels.
    Its precision is that of the caller: wrap it in `jax.enable_x64(True)` for float64.
    Always the default solver on its longest steps: only `simulate` looks whether shorter ones, or
    a stiff solver, are needed. NaN where the network's rates are further apart than float64 can
    tell, which `simulate` refuses.

    **Arguments:** as those of `simulate`.

    **Returns:** `(times, channels)`, degC, for the channels that the experiment names, else all.

    **Raises:** `SimulationError` where experiment and rig do not belong together.
    """
    twin = own_twin(twin, experiment)
    names = checked_channels(twin, experiment)
    columns = np.array([twin.channels.index(name) for name in names])
    start = checked_initial(twin, initial)
    with own_settings(float64=None):
        _, readings, _, _ = _run_exponential(twin, padded_schedule(twin, experiment), start)
        return readings[: len(experiment.time), columns] - 273.15


def checked_channels(twin: Twin, experiment: Experiment) -> tuple[str, ...]:
    """The channels that an experiment asks of a twin.

    **Raises:** `SimulationError` where it names others than the rig has, or drives another number
    of cells.
    """
    check_twin("twin", twin, SimulationError)
    of_kind("experiment", experiment, Experiment, EXPERIMENT, SimulationError)
    cells = len(twin.netlist.cells)
    label = experiment.name or "the experiment"
    if experiment.n_cells != cells:
        raise SimulationError(
            f"{label}: duty: found {experiment.n_cells} cells, allowed are the {cells} of "
            f"{twin.rig.name}"
        )
    unknown = [name for name in experiment.channels if name not in twin.channels]
    if unknown:
        raise SimulationError(
            f"{label}: channels: found {', '.join(unknown)}, allowed by {twin.rig.name} are "
            f"{', '.join(twin.channels)}"
        )
    return experiment.channels or twin.channels


def _check_solver(
    solver: "diffrax.AbstractSolver",
    controller: "diffrax.AbstractStepSizeController | None",
    dt0: float | None,
) -> None:
    import diffrax

    of_kind("solver", solver, diffrax.AbstractSolver, "a diffrax solver or None", SimulationError)
    if controller is not None:
        kind, allowed = diffrax.AbstractStepSizeController, "a diffrax controller or None"
        of_kind("stepsize_controller", controller, kind, allowed, SimulationError)
    if dt0 is not None and finite_number("dt0", dt0, SimulationError) <= 0:
        raise SimulationError(f"dt0: found {dt0!r} s, allowed is above 0 or None")


def _check_values(twin: Twin) -> None:
    """What has no meaning as a resistance or a heat capacity may still give finite temperatures."""
    values = twin.numbers_si
    for what, value in _positive_values(twin.rig):
        found = value.evaluate(values)
        if found <= 0:
            raise ParameterError(
                f"{twin.rig.name}: {what} ({value}): found {found:g} in SI units, allowed are "
                "values above 0"
            )


@lru_cache(maxsize=32)
def _positive_values(rig: Rig) -> tuple[tuple[str, Value], ...]:
    """Each distinct value of a rig that must be above 0, and what it is."""
    netlist = build_netlist(rig)
    named = [(f"capacitance of {node.name}", node.capacitance) for node in netlist.nodes]
    for link in netlist.links:
        named += [(f"resistance {link.a} - {link.b}", value) for value in link.resistances]
    named += [
        (f"electrical resistance of {c.name}", c.electrical_resistance) for c in netlist.cells
    ]
    driver = rig.driver
    named += [
        (f"{what} of the driver", value)
        for what, value in (("lag", driver.lag), ("delay", driver.delay))
        if value is not None
    ]
    first: dict[Value, str] = {}
    for what, value in named:
        if not value.is_constant:
            first.setdefault(value, what)
    return tuple((what, value) for value, what in first.items())


def _check_resolved(twin: Twin, schedule: Schedule) -> None:
    if np.isnan(_coupling(twin, schedule)):
        raise unresolved_network(twin)


@eqx.filter_jit
def _coupling(twin: Twin, schedule: Schedule) -> Float[Array, ""]:
    system = twin.system(lumped=True)
    return coupling_left(system, schedule_modes(system, schedule), schedule)


@eqx.filter_jit
def _run_exponential(
    twin: Twin, schedule: Schedule, initial: str | Float[Array | np.ndarray, " starts"] | None
) -> tuple[Array, Array, Float[Array, ""], Float[Array, ""]]:
    """Absolute temperatures of the rig's nodes `(times, nodes)` and of its channels
    `(times, channels)`, K, `coupling_left`, and the solution's doubt."""
    system = twin.system(lumped=keeps_symmetry(initial))
    reference = reference_temperature(system, schedule)
    start = initial_temperatures(system, initial, schedule.duty[0], reference)
    at_rest = isinstance(initial, str)
    modes, seen = schedule_modes(system, schedule), arriving(schedule, system, at_rest)
    read = solve_steps(system, seen, modes, start, np.eye(start.size), at_rest)
    states, readings = _absolute(system, schedule, read.at_samples(seen), reference)
    return states, readings, coupling_left(system, modes, schedule), read.doubt


def _absolute(
    system: System,
    schedule: Schedule,
    deviation: Float[Array, "times nodes"],
    reference: Float[Array, ""],
) -> tuple[Float[Array, "times rig_nodes"], Float[Array, "times channels"]]:
    readings = system.channel_temperatures(deviation, ambient_of_samples(system, schedule))
    return deviation[:, system.wiring.position] + reference, readings + reference


def _run_checked(
    twin: Twin,
    schedule: Schedule,
    initial: str | Float[np.ndarray, " starts"] | None,
    experiment: Experiment,
    solver: "diffrax.AbstractSolver | None",
    controller: "diffrax.AbstractStepSizeController | None",
    dt0: float | None,
) -> tuple[Array, Array]:
    """By a diffrax solver; the stiff one of our choice where none is given."""
    most = None
    if solver is None:
        import diffrax

        from ._diffrax import input_changes

        # Temperatures without a bound would keep it at ever shorter steps.
        solver, most = diffrax.Kvaerno5(), RESCUE_STEPS * (1 + len(input_changes(experiment)))
    states, readings, ok, message = _run_diffrax(
        twin, schedule, initial, experiment, solver, controller, dt0, most
    )
    if not ok:
        raise SimulationError(f"{twin.rig.name}: {type(solver).__name__}: {message}")
    return states, readings


@eqx.filter_jit
def _run_diffrax(
    twin: Twin,
    schedule: Schedule,
    initial: str | Float[Array | np.ndarray, " starts"] | None,
    experiment: Experiment,
    solver: "diffrax.AbstractSolver",
    controller: "diffrax.AbstractStepSizeController | None",
    dt0: float | None,
    most: int | None,
) -> tuple[Float[Array, "times nodes"], Float[Array, "times channels"], Array, object]:
    import diffrax

    from ._diffrax import solve_with_diffrax

    system = twin.system(lumped=keeps_symmetry(initial))
    reference = reference_temperature(system, schedule)
    start = initial_temperatures(system, initial, schedule.duty[0], reference)
    at_rest = isinstance(initial, str)
    deviation, result = solve_with_diffrax(
        system, schedule, start, reference, experiment, solver, controller, dt0, at_rest, most
    )
    states, readings = _absolute(system, schedule, deviation, reference)
    return states, readings, result == diffrax.RESULTS.successful, result
