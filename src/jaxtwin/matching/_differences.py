"""Derivatives of the output errors as central differences.

They are used if a few values are estimated from a short part of a recording. The errors and
their derivatives are then one small compiled program. For the many values and samples of a match
the exact derivatives of `_jacobian` take less time.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..simulation._modes import Modes
from ._objective import Objective, RecordingGroup
from ._residuals import camera_readings, errors_of_readings, local_vectors
from ._search_space import SearchSpace


def output_errors_and_differences(
    vector: Float[Array, " unknowns"],
    space: SearchSpace,
    objective: Objective,
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
        local: Array, ahead: Array, behind: Array, group: RecordingGroup, modes: Modes
    ) -> tuple[Array, Array]:
        points = [local + jnp.diag(end - local) for end in (ahead, behind)]
        readings = jax.vmap(
            lambda entries: camera_readings(entries, objective, group.grid, group.columns, modes)
        )(jnp.concatenate([local[None], *points]))
        here, of_ahead, of_behind = jnp.split(readings, [1, 1 + local.size])
        jacobian = (of_ahead - of_behind) / (ahead - behind)[:, None, None]
        return errors_of_readings(here[0], group), jacobian

    steps = space.difference_steps
    assert steps is not None
    errors, jacobians = [], []
    for local, ahead, behind, group, of_group in zip(
        local_vectors(vector, objective),
        local_vectors(space.clip(vector + steps), objective),
        local_vectors(space.clip(vector - steps), objective),
        objective.groups,
        modes,
        strict=True,
    ):
        error, jacobian = jax.lax.map(
            lambda inputs: of_recording(*inputs), (local, ahead, behind, group, of_group)
        )
        errors.append(error)
        jacobians.append(jacobian)
    return errors, jacobians
