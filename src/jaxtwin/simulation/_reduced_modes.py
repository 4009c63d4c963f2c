r"""Computes the run of a large network in the few modes that it needs.

All modes of thousands of nodes take minutes to compute, and nearly all of them are either not
excited or decay at once. The states of a run lie close to the responses of the network to its
inputs, $(A + s C)^{-1} b$, at rates $s$ from the inverse of the duration to that of the first
steps. These responses, with those at rest ($s = 0$), span a rational Krylov space (A. Ruhe, Linear
Algebra Appl. 58 (1984) 391-405). $A$ is the conductance matrix with linearised cells and losses
(`_modes`), and $b$ are the heat flows at the sides of the cells, from the surroundings, and of the
state at the start. The eigenproblem of the network, projected on that space, is small.

The error of the projection is estimated from the residual $r$ of the solution in the equations of
all nodes: a constant residual would change the temperatures by $A^{-1} r$. If that is too much,
these temperatures are added to the space, and the run is computed again.
"""

from typing import Any, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Array, Float

from .._compilation import persistent_jit
from ..physics import System, Twin, conductance_entries
from ._drive import Drive
from ._initial import CheckedInitial, initial_temperatures, keeps_symmetry
from ._integrate import StepReadings, integrate
from ._modes import (
    MAX_SPAN,
    Linearisation,
    Modes,
    linearise,
    loss_shapes,
    operating_point,
    side_nodes,
)
from ._refinement import stability_number
from ._time_grid import TimeGrid, reference_temperature

# The number of rates at which responses are computed, without that at rest; and the largest, 1/s.
POLES, FASTEST_POLE = 12, 100.0

# The number of responses, from the slowest, to which responses to nonlinear losses are added.
RESPONSES_OF_LOSSES = 6

# The relative size of the part of a response outside the space of the others, below which the
# response is left out.
INDEPENDENCE_TOLERANCE = 1e-10

# The number of modes is padded to a multiple of this, so that runs share compiled programs.
MODE_BLOCK = 32

# The largest change of a temperature by the residual that is accepted, K.
MAX_RESIDUAL = 3e-4

# The largest number of runs, each in a larger space than the one before.
ROUNDS = 4

# The number of steps at which the residual is evaluated.
RESIDUAL_STEPS = 32


# Absolute temperatures of the rig's nodes and of its channels at the samples, K, the
# `stability_number`, and the error estimate of the steps, K.
RunResult: TypeAlias = tuple[
    Float[Array, "times rig_nodes"], Float[Array, "times channels"], Array, Array
]


@final
class ResidualTerms(eqx.Module):
    """The terms of the equations of all nodes at some steps of a run, from which the residual is
    computed.

    - `deviation`: the temperatures of the nodes as deviations from the reference, K.
    - `heat`: the heat flows into the nodes without conduction, minus heat capacity times slope, W.
    """

    deviation: Float[Array, "steps nodes"]
    heat: Float[Array, "steps nodes"]


def run_reduced(twin: Twin, grid: TimeGrid, initial: CheckedInitial) -> RunResult | None:
    """Simulates a large twin.

    **Returns:** the run; None if its states do not lie in a small space, or if float64 might not
    resolve the rates of the network. All modes are needed then.
    """
    system, network = _network(twin, keeps_symmetry(initial))
    sides, count = side_nodes(system), system.capacitance.size
    capacitance = np.asarray(system.capacitance)
    duration = float(np.asarray(grid.sizes)[grid.size].sum())
    if (network.diagonal() / capacitance).max() * duration > MAX_SPAN:
        return None
    at_sides = np.zeros((count, sides.size))
    at_sides[sides, np.arange(sides.size)] = 1.0
    solved = scipy.sparse.linalg.splu(network).solve(at_sides)
    point, start = _linearised(system, grid, initial, solved)
    linear = scipy.sparse.csc_array(network + _added(system, point))
    inputs = [at_sides, np.asarray(system.ambient_conductance)[:, None]]
    if system.reservoirs is not None:
        inputs.append(np.asarray(system.reservoirs.conductance).T)
    if np.any(start):
        inputs.append((capacitance * np.asarray(start))[:, None])
    driving = np.concatenate(inputs, axis=1)
    at_rest = scipy.sparse.linalg.splu(linear)
    responses = [at_rest.solve(driving)]
    for pole in np.geomspace(1 / duration, FASTEST_POLE, POLES):
        shifted = scipy.sparse.csc_array(linear + scipy.sparse.diags_array(pole * capacitance))
        responses.append(scipy.sparse.linalg.splu(shifted).solve(driving))
    space = [*responses]
    if np.any(start):
        space.append(np.asarray(start)[:, None])
    if point.loss is not None:
        # The nonlinear part of the losses follows the temperatures at the ends of their paths.
        lost = _of_losses(system, point.loss)
        space += [at_rest.solve(lost @ response) for response in responses[:RESPONSES_OF_LOSSES]]
    for _ in range(ROUNDS):
        modes = _projected(system, linear, np.concatenate(space, axis=1), point)
        read, terms, stability = _steps_in_modes(system, modes, grid, initial)
        residual = np.asarray(terms.heat).T - network @ np.asarray(terms.deviation).T
        missing = at_rest.solve(residual)
        size = np.abs(missing).max()
        if size <= MAX_RESIDUAL or not np.isfinite(size):
            nodes, channels = _at_samples(system, modes, grid, read)
            return nodes, channels, stability, read.error_estimate
        space.append(missing)
    return None


def _network(twin: Twin, lumped: bool) -> tuple[System, scipy.sparse.csc_array]:
    """Returns the equations without their conductance matrix, and that matrix, sparse."""
    system, (pairs, diagonal) = _assembled(twin, lumped)
    (a, b), nodes = system.wiring.pairs, np.arange(diagonal.size)
    places = np.concatenate([a, b, nodes]), np.concatenate([b, a, nodes])
    values = np.concatenate([-np.asarray(pairs), -np.asarray(pairs), np.asarray(diagonal)])
    shape = (nodes.size, nodes.size)
    return system, scipy.sparse.csc_array(scipy.sparse.coo_array((values, places), shape=shape))


def _of_losses(system: System, loss: Float[Array | np.ndarray, " paths"]) -> scipy.sparse.coo_array:
    """Returns the linearised losses as an addition to the conductance matrix."""
    paths, count = system.wiring.loss_paths, system.capacitance.size
    assert paths is not None
    (rows, columns), values = paths.conductance_matrix(np.asarray(loss))
    return scipy.sparse.coo_array((np.asarray(values), (rows, columns)), shape=(count, count))


def _added(system: System, point: Linearisation) -> scipy.sparse.sparray:
    """Returns the linearised cells and losses as an addition to the conductance matrix."""
    sides, count = side_nodes(system), system.capacitance.size
    rows, columns = (index.ravel() for index in np.meshgrid(sides, sides, indexing="ij"))
    values = np.asarray(point.conductance).ravel()
    cells = scipy.sparse.coo_array((values, (rows, columns)), shape=(count, count))
    return cells if point.loss is None else cells + _of_losses(system, point.loss)


def _projected(
    system: System,
    linear: scipy.sparse.csc_array,
    space: Float[np.ndarray, "nodes vectors"],
    point: Linearisation,
) -> Modes:
    """Computes the modes of the network within a space."""
    root = np.sqrt(np.asarray(system.capacitance))
    weighted = root[:, None] * space
    weighted /= np.linalg.norm(weighted, axis=0)
    factors: Any = scipy.linalg.qr(weighted, mode="economic", pivoting=True)
    basis, triangle, _ = factors
    sizes = np.abs(np.diag(triangle))
    basis = basis[:, sizes > INDEPENDENCE_TOLERANCE * sizes[0]] / root[:, None]
    rates, vectors = scipy.linalg.eigh(basis.T @ (linear @ basis))
    shapes = basis @ vectors
    # Modes of zero shape pad the number of modes to a multiple of `MODE_BLOCK`.
    filling = -len(rates) % MODE_BLOCK
    rates = np.pad(rates, (0, filling), mode="edge")
    shapes = np.pad(shapes, ((0, 0), (0, filling)))
    return Modes(
        rates=jnp.asarray(rates),
        shapes=jnp.asarray(shapes),
        sides=jnp.asarray(shapes[side_nodes(system)]),
        losses=loss_shapes(system, jnp.asarray(shapes)),
        capacitance=system.capacitance,
        linearised_conductance=point.conductance,
        linearised_loss=point.loss,
        operating_point=point.sides,
    )


@persistent_jit
def _assembled(twin: Twin, lumped: bool) -> tuple[System, tuple[Array, Array]]:
    system = twin.system(lumped=lumped)
    conductances = system.wiring.conductances(twin.values_si)
    entries = conductance_entries(system.wiring, conductances)
    return _with_matrix(system, None), entries


def _with_matrix(system: System, matrix: Array | None) -> System:
    return eqx.tree_at(
        lambda system: system.conductance, system, matrix, is_leaf=lambda leaf: leaf is None
    )


@persistent_jit
def _linearised(
    system: System,
    grid: TimeGrid,
    initial: CheckedInitial,
    resistance: Float[Array | np.ndarray, "nodes sides"],
) -> tuple[Linearisation, Float[Array, " nodes"]]:
    """Returns the operating point of a run, and the deviations at its start, K."""
    inputs = grid.summary()
    reference = reference_temperature(system, inputs)
    start = initial_temperatures(system, initial, inputs.first, reference) - reference
    duty = jnp.asarray(inputs.mean)
    at = operating_point(system, duty, reference, jnp.asarray(resistance))
    return linearise(system, duty, reference, at), start


@persistent_jit
def _steps_in_modes(
    system: System, modes: Modes, grid: TimeGrid, initial: CheckedInitial
) -> tuple[StepReadings, ResidualTerms, Array]:
    """Returns the amplitudes of the modes at the ends of the steps, the terms of the residual, and
    the `stability_number`."""
    # The modes replace the conductance matrix. Only derivatives would need it, and none are
    # computed.
    nodes = system.capacitance.size
    system = _with_matrix(system, jnp.zeros((nodes, nodes)))
    drive = Drive.of(system, grid)
    start = initial_temperatures(system, initial, grid.duty[0], drive.reference)
    read = integrate(system, drive, modes, start, None)
    stability = stability_number(system, modes, grid.summary())
    return read, _residual_terms(system, modes, drive, read), stability


@persistent_jit
def _at_samples(
    system: System, modes: Modes, grid: TimeGrid, read: StepReadings
) -> tuple[Float[Array, "times rig_nodes"], Float[Array, "times channels"]]:
    """Returns the absolute temperatures of the rig's nodes and of its channels at the samples,
    K."""
    drive = Drive.of(system, grid)
    amplitudes = read.at_samples(drive.grid)
    nodes = amplitudes @ modes.shapes[system.wiring.position].T
    zones = amplitudes @ (jnp.asarray(system.channel_weights) @ modes.shapes).T
    readings = system.readings(zones, drive.ambient_at_samples())
    return nodes + drive.reference, readings + drive.reference


def _residual_terms(
    system: System, modes: Modes, drive: Drive, read: StepReadings
) -> ResidualTerms:
    inputs = jax.vmap(lambda row: row.at(0))(drive.inputs())
    steps = np.unique(np.linspace(0, len(drive.grid.size) - 1, RESIDUAL_STEPS).astype(int))
    deviations, slopes = (rows[steps] @ modes.shapes.T for rows in (read.values, read.slopes))

    def heat(step: Array, deviation: Array, slope: Array) -> Array:
        duty, ambient = inputs.duty[step], inputs.ambient[step]
        heat = system.heat_without_conduction(deviation, duty, drive.reference, ambient)
        return heat - system.capacitance * slope

    return ResidualTerms(deviations, jax.vmap(heat)(jnp.asarray(steps), deviations, slopes))
