"""Derivatives of the residuals: of the simulations, and of the weighted residuals that follow.

The exact derivatives are those of `jax.jacfwd` of `residuals`, with less work: a recording does not
depend on the values of another recording, and the gain of a channel does not act on the plate.

Central differences are used where a few values are estimated from a short part of a recording. The
errors and their derivatives are then one small compiled program. For the many values and samples
of a match the exact derivatives take less time.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..physics import Twin
from ..simulation import Modes, TimeGrid
from ._objective import MatchObjective, SameShapeBatch
from ._residual_weights import AnyArray, ResidualWeights, SplitErrors, of_each_recording
from ._residuals import camera_readings, channel_rises, errors_of_readings, local_vectors
from ._start import OF_THE_RIG, RunStart
from ._unknowns import SearchSpace, VectorLayout

Tree = TypeVar("Tree")


def residual_jacobian(
    vector: Float[Array, " unknowns"], objective: MatchObjective
) -> Float[Array, "residuals unknowns"]:
    """Derivatives of the `residuals`, in the order of `ravel_pytree`."""
    return jnp.asarray(weighted_jacobian(output_error_jacobians(vector, objective), objective))


def output_error_jacobians(
    vector: Float[Array, " unknowns"],
    objective: MatchObjective,
    modes: Sequence[Modes] | None = None,
) -> list[Float[Array, "_recordings _entries _times _channels"]]:
    """Derivatives of the `output_errors` with respect to the entries on which each recording
    depends.

    **Arguments:**

    - `modes`: the `recording_modes` of the vector, None to find them here.
    """
    known = [None] * len(objective.same_shape_batches) if modes is None else modes

    def of_recording(inputs: tuple[Array, SameShapeBatch, Modes | None]) -> Array:
        local, batch, modes = inputs
        twin, layout = objective.twin, objective.layout
        return reading_jacobian(
            local, twin, layout, batch.grid, batch.columns, modes, start=objective.start
        )

    # The batches are solved one after the other, as in `output_errors`.
    return [
        jax.lax.map(of_recording, (local, batch, of_batch))
        for batch, local, of_batch in zip(
            objective.same_shape_batches, local_vectors(vector, objective), known, strict=True
        )
    ]


def weighted_jacobian(
    jacobians: Sequence[Float[AnyArray, "_recordings _entries _times _channels"]],
    objective: MatchObjective,
) -> Float[AnyArray, "residuals unknowns"]:
    """Computes the derivatives of `residuals` from those of the output errors, in NumPy if these
    are."""
    size, columns = np.shape(objective.prior_means)[0], []
    xp: Any = np if all(isinstance(part, np.ndarray) for part in jacobians) else jnp
    for batch, jacobian in zip(objective.same_shape_batches, jacobians, strict=True):

        def of_recording(jacobian: AnyArray, weights: ResidualWeights) -> SplitErrors:
            return weights.weighted(jacobian)

        entries = objective.layout.entry_indices()[list(batch.positions)]
        recording = np.arange(len(entries))[:, None]
        for part in of_each_recording(of_recording, jacobian, batch.weights):
            flat = part.reshape(*part.shape[:2], -1)
            whole = xp.zeros((size, len(entries), flat.shape[-1]), flat.dtype)
            if xp is np:
                whole[entries, recording] = flat
            else:
                whole = whole.at[entries, recording].set(flat)
            columns.append(whole.reshape(size, -1))
    columns.append(xp.diag(xp.asarray(objective.prior_weights)))
    columns.append(xp.asarray(objective.linear_prior.matrix).T)
    # The transpose is a view: products of its columns run along rows in memory.
    return xp.concatenate(columns, axis=1).T


def reading_jacobian(
    local: Float[Array, " entries"],
    twin: Twin,
    layout: VectorLayout,
    grid: TimeGrid,
    columns: Int[Array | np.ndarray, " columns"],
    modes: Modes | None = None,
    *,
    start: RunStart = OF_THE_RIG,
) -> Float[Array, "entries times channels"]:
    """Derivatives of `camera_readings`: in forward mode for the entries that act on the network,
    and as a product for gains."""
    network_entries = np.array(layout.network_entries(twin), dtype=int)
    gain_entries = np.setdiff1d(np.arange(local.size), network_entries)

    def changed_twin(part: Array, entries: np.ndarray) -> Twin:
        return twin.with_values(layout.local_values(local.at[entries].set(part)))

    def rises(part: Array) -> tuple[Array, Array]:
        system = changed_twin(part, network_entries).system(lumped=start.is_lumped)
        return channel_rises(system, grid, columns, modes, start)

    def gains(part: Array, entries: np.ndarray) -> Array:
        changed = changed_twin(part, entries)
        return changed.wiring.gains(changed.values_si)[columns]

    (_, rise), (d_surroundings, d_rise) = _push_forward(rises, local[network_entries])
    d_gain = _push_forward(lambda part: gains(part, network_entries), local[network_entries])[1]
    d_reading = d_surroundings + gains(local[network_entries], network_entries) * d_rise
    d_reading = d_reading + rise * d_gain[:, None, :]
    whole = jnp.zeros((local.size, *rise.shape), rise.dtype).at[network_entries].set(d_reading)
    if gain_entries.size:
        d_gain = _push_forward(lambda part: gains(part, gain_entries), local[gain_entries])[1]
        whole = whole.at[gain_entries].set(rise * d_gain[:, None, :])
    return whole


def _push_forward(function: Callable[[Array], Tree], part: Array) -> tuple[Tree, Tree]:
    """The value of a function, and its derivatives with a leading axis for the entries."""
    basis = jnp.eye(part.size, dtype=part.dtype)
    push = jax.vmap(lambda d: jax.jvp(function, (part,), (d,)), out_axes=(None, 0))
    return push(basis)


def output_errors_and_differences(
    vector: Float[Array, " unknowns"],
    space: SearchSpace,
    objective: MatchObjective,
    modes: Sequence[Modes],
) -> tuple[
    list[Float[Array, "_recordings _times _channels"]],
    list[Float[Array, "_recordings _entries _times _channels"]],
]:
    """The `output_errors`, and their derivatives as `output_error_jacobians` has them.

    **Arguments:**

    - `space`: the distance of each entry from the two points of its difference, its
      `difference_steps`, and bounds. At a bound the difference has one side.
    - `modes`: the `recording_modes` of the vector.
    """

    def of_recording(
        local: Array, ahead: Array, behind: Array, batch: SameShapeBatch, modes: Modes
    ) -> tuple[Array, Array]:
        points = [local + jnp.diag(end - local) for end in (ahead, behind)]
        readings = jax.vmap(
            lambda entries: camera_readings(entries, objective, batch.grid, batch.columns, modes)
        )(jnp.concatenate([local[None], *points]))
        here, of_ahead, of_behind = jnp.split(readings, [1, 1 + local.size])
        jacobian = (of_ahead - of_behind) / (ahead - behind)[:, None, None]
        return errors_of_readings(here[0], batch), jacobian

    steps = space.difference_steps
    assert steps is not None
    errors, jacobians = [], []
    for local, ahead, behind, batch, of_batch in zip(
        local_vectors(vector, objective),
        local_vectors(space.clip(vector + steps), objective),
        local_vectors(space.clip(vector - steps), objective),
        objective.same_shape_batches,
        modes,
        strict=True,
    ):
        error, jacobian = jax.lax.map(
            lambda inputs: of_recording(*inputs), (local, ahead, behind, batch, of_batch)
        )
        errors.append(error)
        jacobians.append(jacobian)
    return errors, jacobians
