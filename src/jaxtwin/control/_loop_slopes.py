"""Measures of many closed loops and their exact derivatives by the controller's parameters."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._compilation import persistent_jit
from .._jax_settings import own_settings
from ..physics import Twin
from ..simulation import Stepper
from ..simulation._draws import work_in_chunks
from ._closed_loop import ClosedLoop, Scenario, run_loop
from ._controller_vector import ControllerVector
from ._measures import Measure
from ._simulate_closed_loop import CHUNK_BYTES, is_whole_delay, numbers_a_step, steppers_of

LARGEST_CHUNK = 64
"""Loops that a core works on at a time, each with all derivatives."""


class Slopes(NamedTuple):
    """Measures of loops, those of each controller in a row; NaN where a loop failed.

    - `values`: `(controllers, draws, measures)`.
    - `slopes`: `(controllers, draws, measures, parameters)`.
    """

    values: Float[np.ndarray, "controllers draws measures"]
    slopes: Float[np.ndarray, "controllers draws measures parameters"]


@final
class LoopSlopes:
    """Closed loops of a twin, or of draws of it, with a controller whose parameters change.

    The derivatives are taken forwards: beside the loop runs its change by each parameter. That
    costs about as much again for each, and keeps nothing; backwards a loop would have to keep all
    of its steps.

    **Arguments:**

    - `twin`: whose other parameters hold. `draws`: name -> values `(draws,)`, none for the twin
      alone.
    - `vector`: of the parameters that change.
    - `happens`: in the loops.
    - `measures`: name -> function.
    - `workers`: threads, None for one a core.
    """

    def __init__(
        self,
        twin: Twin,
        draws: Mapping[str, Float[np.ndarray, " draws"]],
        vector: ControllerVector,
        happens: Scenario,
        measures: Mapping[str, Measure],
        workers: int | None,
    ):
        self._vector, self._happens, self._workers = vector, happens, workers
        self._measures = tuple(measures.items())
        size = happens.step_s, happens.longest_delay_s
        with own_settings():
            if draws:
                whole = is_whole_delay(twin, draws, happens.step_s)
                steppers = steppers_of(twin, dict(draws), *size, whole)
                self.count = len(next(iter(draws.values())))
            else:
                steppers = jax.tree.map(
                    lambda leaf: jnp.asarray(leaf)[None],
                    Stepper(twin, size[0], longest_delay=size[1]),
                )
                self.count = 1
            self._steppers: Stepper = jax.tree.map(np.asarray, steppers)
        parameters = len(vector.values)
        a_loop = 8 * happens.ambient.size * numbers_a_step(twin, happens) * (1 + parameters)
        self._chunk = int(min(max(CHUNK_BYTES // a_loop, 1), LARGEST_CHUNK))

    def __call__(
        self, controllers: Sequence[Float[np.ndarray, " parameters"]], room: int
    ) -> Slopes:
        """The measures of some controllers with every draw.

        **Arguments:**

        - `controllers`: their parameters.
        - `room`: for how many controllers the program is compiled at first, so that fewer of them
          compile nothing anew.
        """
        loops = len(controllers) * self.count
        rows = {
            "draw": np.tile(np.arange(self.count, dtype=float), len(controllers)),
            **{
                str(entry): np.repeat(column, self.count)
                for entry, column in enumerate(np.array(controllers, float).T)
            },
        }
        chunk = min(self._chunk, room * self.count)
        fill = max(chunk - loops, 0)
        rows = {name: np.concatenate([v, np.repeat(v[-1:], fill)]) for name, v in rows.items()}
        found = work_in_chunks(rows, self._work, chunk_size=chunk, workers=self._workers)
        shape = len(controllers), self.count
        failed = found["failed"][:loops]
        values, slopes = (
            np.where(failed.reshape(-1, *[1] * (part.ndim - 1)), np.nan, part[:loops]).reshape(
                *shape, *part.shape[1:]
            )
            for part in (found["values"], found["slopes"])
        )
        return Slopes(values, np.moveaxis(slopes, 2, 3))

    def _work(self, chunk: Mapping[str, np.ndarray]) -> dict[str, Array]:
        draw = chunk["draw"].astype(int)
        steppers = jax.tree.map(lambda leaf: leaf[draw], self._steppers)
        values = np.stack([chunk[str(entry)] for entry in range(len(chunk) - 1)], axis=1)
        with own_settings():
            found = _slopes(steppers, self._vector, values, self._happens, self._measures)
        return dict(zip(("values", "slopes", "failed"), found, strict=True))


@persistent_jit
def _slopes(
    steppers: Stepper,
    vector: ControllerVector,
    values: Float[Array | np.ndarray, "chunk parameters"],
    happens: Scenario,
    measures: tuple[tuple[str, Measure], ...],
) -> tuple[
    Float[Array, "chunk measures"], Float[Array, "chunk parameters measures"], Bool[Array, " chunk"]
]:
    def of_loop(
        stepper: Stepper, values: Float[Array, " parameters"]
    ) -> tuple[Float[Array, " measures"], Float[Array, "parameters measures"], Bool[Array, ""]]:
        def measured(values: Array) -> tuple[Array, Array]:
            loop: ClosedLoop = run_loop(stepper, vector.apply(values), happens)
            numbers = [jnp.asarray(function(loop), values.dtype) for _, function in measures]
            return jnp.stack(numbers), ~loop.stays_finite

        def along(direction: Array) -> tuple[Array, Array, Array]:
            found, slope, failed = jax.jvp(measured, (values,), (direction,), has_aux=True)
            return found, slope, failed

        units = jnp.eye(values.size, dtype=values.dtype)
        found, slope, failed = jax.vmap(along)(units)
        return found[0], slope, failed[0]

    return jax.vmap(of_loop)(steppers, jnp.asarray(values))
