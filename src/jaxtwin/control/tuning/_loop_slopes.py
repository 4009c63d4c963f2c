"""Measures of many closed loops, with exact derivatives with respect to controller parameters."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..._compilation import persistent_jit
from ..._jax_settings import own_settings
from ...physics import Twin
from ...simulation import Stepper, work_in_chunks
from ..controllers._design_vector import ControllerNumbers, ControllerVector, Line
from ..loops._closed_loop import run_loop
from ..loops._measures import ClosedLoop, Measure
from ..loops._scenario import Scenario
from ..loops._simulate_closed_loops import (
    CHUNK_BYTES,
    is_whole_delay,
    numbers_per_step,
    steppers_of,
)

# The largest number of loops, each with all derivatives, that a core computes at a time.
MAX_CHUNK = 64


class Slopes(NamedTuple):
    """The measures of loops and their derivatives; NaN for a loop that failed.

    - `values`: the measures, `(controllers, draws, measures)`.
    - `slopes`: their derivatives, `(controllers, draws, measures, parameters)`.
    """

    values: Float[np.ndarray, "controllers draws measures"]
    slopes: Float[np.ndarray, "controllers draws measures parameters"]


@final
class LoopSlopes:
    """Closed loops of a twin, or of draws of it, as a function of the controller's parameters.

    Forward differentiation computes the change of the loop with each parameter beside the loop. It
    costs about as much again for each parameter, and needs no memory. Reverse differentiation would
    have to keep all steps of the loop.

    **Arguments:**

    - `twin`: the twin; parameters that are not drawn keep its values.
    - `draws`: name of a parameter -> values `(draws,)`; empty for the twin without draws.
    - `numbers`: the map from the numbers of a `Line` to the controller.
    - `scenario`: the scenario of all loops.
    - `measures`: name -> function.
    - `workers`: the number of threads, None for one for each core.
    """

    def __init__(
        self,
        twin: Twin,
        draws: Mapping[str, Float[np.ndarray, " draws"]],
        numbers: ControllerVector | ControllerNumbers,
        scenario: Scenario,
        measures: Mapping[str, Measure],
        workers: int | None,
    ):
        self._numbers, self._scenario, self._workers = numbers, scenario, workers
        self._measures = tuple(measures.items())
        size = scenario.step, scenario.longest_delay
        with own_settings():
            if draws:
                whole = is_whole_delay(twin, draws, scenario.step)
                steppers = steppers_of(twin, dict(draws), *size, whole)
                self.count = len(next(iter(draws.values())))
            else:
                steppers = jax.tree.map(
                    lambda leaf: jnp.asarray(leaf)[None],
                    Stepper(twin, size[0], longest_delay=size[1]),
                )
                self.count = 1
            self._steppers: Stepper = jax.tree.map(np.asarray, steppers)
        self._a_loop = 8 * scenario.ambient.size * numbers_per_step(twin, scenario)

    def __call__(self, controllers: Sequence[Line], room: int) -> Slopes:
        """Computes the measures of some controllers for each draw.

        **Arguments:**

        - `controllers`: the controllers.
        - `room`: the number of controllers for which the program is compiled, so that calls with
          fewer controllers use the same program.
        """
        loops = len(controllers) * self.count
        rows = {
            "draw": np.tile(np.arange(self.count, dtype=float), len(controllers)),
            "controller": np.repeat(np.arange(len(controllers), dtype=float), self.count),
        }
        lines = Line(*(np.stack(part) for part in zip(*controllers, strict=True)))
        largest = CHUNK_BYTES // (self._a_loop * (1 + lines.slopes.shape[1]))
        chunk = min(int(min(max(largest, 1), MAX_CHUNK)), room * self.count)
        fill = max(chunk - loops, 0)
        rows = {name: np.concatenate([v, np.repeat(v[-1:], fill)]) for name, v in rows.items()}
        work = partial(self._work, lines)
        result = work_in_chunks(rows, work, chunk_size=chunk, workers=self._workers)
        shape = len(controllers), self.count
        failed = result["failed"][:loops]
        values, slopes = (
            np.where(failed.reshape(-1, *[1] * (part.ndim - 1)), np.nan, part[:loops]).reshape(
                *shape, *part.shape[1:]
            )
            for part in (result["values"], result["slopes"])
        )
        return Slopes(values, np.moveaxis(slopes, 2, 3))

    def _work(self, lines: Line, chunk: Mapping[str, np.ndarray]) -> dict[str, Array]:
        draw, controller = chunk["draw"].astype(int), chunk["controller"].astype(int)
        steppers = jax.tree.map(lambda leaf: leaf[draw], self._steppers)
        of_loops = Line(*(part[controller] for part in lines))
        with own_settings():
            result = _slopes(steppers, self._numbers, of_loops, self._scenario, self._measures)
        return dict(zip(("values", "slopes", "failed"), result, strict=True))


@persistent_jit
def _slopes(
    steppers: Stepper,
    numbers: ControllerVector | ControllerNumbers,
    lines: Line,
    scenario: Scenario,
    measures: tuple[tuple[str, Measure], ...],
) -> tuple[
    Float[Array, "chunk measures"], Float[Array, "chunk parameters measures"], Bool[Array, " chunk"]
]:
    def of_loop(
        stepper: Stepper, line: Line
    ) -> tuple[Float[Array, " measures"], Float[Array, "parameters measures"], Bool[Array, ""]]:
        def measured(values: Array) -> tuple[Array, Array]:
            loop: ClosedLoop = run_loop(stepper, numbers.apply(values), scenario)
            result = [jnp.asarray(function(loop), values.dtype) for _, function in measures]
            return jnp.stack(result), ~loop.stays_finite

        def along(direction: Array) -> tuple[Array, Array, Array]:
            result, slope, failed = jax.jvp(measured, (line.numbers,), (direction,), has_aux=True)
            return result, slope, failed

        result, slope, failed = jax.vmap(along)(jnp.asarray(line.slopes))
        return result[0], slope, failed[0]

    return jax.vmap(of_loop)(steppers, jax.tree.map(jnp.asarray, lines))
