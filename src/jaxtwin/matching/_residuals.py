r"""The residuals of a twin on recordings, as a function of the unknowns.

The output errors $D$ of a recording are simulated minus recorded temperatures. They have two parts
with different noise: the common mode of the channels, which comes from the camera or the room, and
the rest of each channel.

$$m_t = \sum_c w_{tc} D_{tc} \Big/ \sum_c w_{tc}, \qquad
\lVert r \rVert^2 = \sum_{tc} \frac{w_{tc} (D_{tc} - m_t)^2}{\sigma_i^2}
+ \sum_t \frac{w_t (m_t - c_t)^2}{\sigma_m^2} + \sum_j \frac{b_j^2}{s_j^2}
+ \sum_p \frac{(u_p - \bar u_p)^2}{s_p^2}$$

$c = \Phi b$ is the camera's common error, whose amplitudes $b$ are solved for in closed form, and
the last sum is the prior of the parameters. Without camera and prior, and with equal weights, this
is eq. (11) of the paper.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._celsius import ZERO_CELSIUS
from ..physics import System
from ..simulation import Drive, Modes, TimeGrid, run_modes, solve_network
from ._native_recordings import few_modes
from ._objective import MatchObjective, SameShapeBatch
from ._residual_weights import AnyArray, ResidualWeights, SplitErrors, of_each_recording
from ._start import OF_THE_RIG, RunStart

# For each batch of recordings the weighted parts of their output errors, followed by those of the
# priors.
Residuals = list[SplitErrors | Float[AnyArray, "..."]]


def residuals(
    vector: Float[Array, " unknowns"], objective: MatchObjective
) -> tuple[Residuals, Float[Array, ""]]:
    """The weighted residuals, and the mean squared error of all existing samples, K^2."""
    parts, mean_square = weighted_residuals(output_errors(vector, objective), vector, objective)
    return parts, jnp.asarray(mean_square)


def recording_modes(vector: Float[Array, " unknowns"], objective: MatchObjective) -> list[Modes]:
    """The modes of the network in each recording, with a leading recordings axis for each batch.

    They have no derivatives: residuals and their derivatives can share them.
    """

    def of_recording(local: Array, grid: TimeGrid) -> Modes:
        twin = objective.twin.with_values(objective.layout.local_values(local))
        system = twin.system(lumped=objective.start.is_lumped)
        return few_modes(system, run_modes(system, grid.summary()))

    return [
        jax.lax.map(lambda inputs: of_recording(*inputs), (local, batch.grid))
        for batch, local in zip(
            objective.same_shape_batches, local_vectors(vector, objective), strict=True
        )
    ]


def output_errors(
    vector: Float[Array, " unknowns"],
    objective: MatchObjective,
    modes: Sequence[Modes] | None = None,
) -> list[Float[Array, "_recordings _times _channels"]]:
    """Simulated minus recorded temperatures, `(recordings, times, channels)` for each batch, K; 0
    for padding.

    **Arguments:**

    - `modes`: the `recording_modes` of the vector, None to find them here.
    """
    known = [None] * len(objective.same_shape_batches) if modes is None else modes

    # The batches are solved one after the other, which on a CPU is as fast as side by side and
    # compiles in two thirds of the time.
    def of_recording(local: Array, batch: SameShapeBatch, modes: Modes | None) -> Array:
        simulated = camera_readings(local, objective, batch.grid, batch.columns, modes)
        return errors_of_readings(simulated, batch)

    return [
        jax.lax.map(lambda inputs: of_recording(*inputs), (local, batch, of_batch))
        for batch, local, of_batch in zip(
            objective.same_shape_batches, local_vectors(vector, objective), known, strict=True
        )
    ]


def errors_of_readings(
    simulated: Float[Array, "times channels"], recording: SameShapeBatch
) -> Float[Array, "times channels"]:
    """Simulated readings minus those of a single recording, K; 0 for padding."""
    error = simulated - recording.temperatures
    return jnp.where(jnp.arange(len(error))[:, None] < recording.lengths, error, 0.0)


def weighted_residuals(
    errors: Sequence[Float[AnyArray, "_recordings _times _channels"]],
    vector: Float[AnyArray, " unknowns"],
    objective: MatchObjective,
) -> tuple[Residuals, Float[AnyArray | np.floating | float, ""]]:
    """Computes the result of `residuals` from the output errors, in NumPy if these are."""
    parts: Residuals = []
    squares: AnyArray | np.floating | float = 0.0
    samples = 0
    for batch, batch_errors in zip(objective.same_shape_batches, errors, strict=True):

        def of_recording(
            errors: AnyArray, weights: ResidualWeights, sampled: AnyArray
        ) -> tuple[SplitErrors, AnyArray | np.floating]:
            split = weights.split(errors)
            # The errors that the twin does not explain, without the camera's error.
            unexplained = errors - (weights.shapes @ split.sizes)[:, None]
            return weights.weigh(split), (unexplained**2).sum(where=sampled)

        part, square = of_each_recording(of_recording, batch_errors, batch.weights, batch.sampled)
        parts.append(part)
        squares = squares + square.sum()
        samples = samples + batch.sampled.sum()
    linear = objective.linear_prior
    parts.append((vector - objective.prior_means) * objective.prior_weights)
    parts.append(linear.matrix @ vector - linear.values)
    return parts, squares / samples


def local_vectors(
    vector: Float[Array, " unknowns"], objective: MatchObjective
) -> list[Float[Array, "_recordings _entries"]]:
    """For each batch of recordings, the entries of the vector on which each recording depends."""
    indices = objective.layout.entry_indices()
    return [vector[indices[list(batch.positions)]] for batch in objective.same_shape_batches]


def camera_readings(
    local: Float[Array, " entries"],
    objective: MatchObjective,
    grid: TimeGrid,
    columns: Int[Array | np.ndarray, " columns"],
    modes: Modes | None,
) -> Float[Array, "times channels"]:
    """The readings of the camera without its common error, degC."""
    twin = objective.twin.with_values(objective.layout.local_values(local))
    system = twin.system(lumped=objective.start.is_lumped)
    drive, zones, ambient = _solved(system, grid, columns, modes, objective.start)
    return drive.reference + system.readings(zones, ambient, columns) - ZERO_CELSIUS


def channel_rises(
    system: System,
    grid: TimeGrid,
    columns: Int[Array | np.ndarray, " columns"],
    modes: Modes | None,
    start: RunStart = OF_THE_RIG,
) -> tuple[Float[Array, "times #channels"], Float[Array, "times channels"]]:
    """The temperature of the surroundings, K, and the rise of each channel's target above it; both
    are relative to the start of the rig."""
    drive, zones, ambient = _solved(system, grid, columns, modes, start)
    return drive.reference + ambient, system.rises(zones, ambient, columns)


def _solved(
    system: System,
    grid: TimeGrid,
    columns: Int[Array | np.ndarray, " columns"],
    modes: Modes | None,
    start: RunStart,
) -> tuple[Drive, Float[Array, "times channels"], Float[Array, "times 1"]]:
    """The drive, and the deviations of the channels' zones and of the ambient at the samples, K."""
    weights = jnp.asarray(system.channel_weights)[columns]
    initial = start.node_temperatures(system, grid)
    drive, zones = solve_network(system, grid, initial, weights, modes)
    ambient = jnp.asarray(drive.ambient_at_samples(), zones.dtype)
    return drive, zones, jnp.broadcast_to(ambient, (zones.shape[0], 1))
