"""Exact derivatives of outputs with respect to parameters, for many draws."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._celsius import ZERO_CELSIUS
from .._compilation import persistent_jit
from .._jax_settings import own_settings
from ..errors import SimulationError
from ..io import Experiment
from ..physics import Twin
from ..simulation import Reductions, TimeGrid
from ..simulation._padding import padded, padded_time_grid
from ..simulation._power import power_of_states
from ..simulation._reductions import Reduction, ReductionChoice, checked_reductions
from ..simulation._refinement import needs_shorter_steps
from ..simulation._simulate import _run_exponential, checked_channels
from ..simulation._workers import work_in_chunks

# The number of draws that a core differentiates at a time, each with respect to all parameters.
CHUNK = 32


def slopes_of(
    twin: Twin,
    experiment: Experiment,
    draws: Mapping[str, Float[np.ndarray, " draws"]],
    reductions: ReductionChoice,
) -> list[Reductions]:
    """Computes the derivatives of reductions with respect to each parameter, as further reductions.

    They are marked failed for draws that the default solver would solve again with shorter steps.

    **Arguments:** those of `reduce_batch`.

    **Returns:** the derivatives with respect to the first parameter, the second, and so on.

    **Raises:** `SimulationError` for reductions of the plate, whose derivatives are not computed.
    """
    requested = checked_reductions(reductions, [experiment], twin.rig)
    on_plate = [name for name, reduction in requested.items() if reduction.reads == "plate_end"]
    if on_plate:
        raise SimulationError(
            f"sensitivity: outputs: expected functions of the channels for derivatives, got "
            f'{on_plate[0]!r}; use method="sobol" for it'
        )
    channels = checked_channels(twin, experiment)
    columns = np.array([twin.channels.index(name) for name in channels])
    grid = padded_time_grid(twin, experiment)
    recorded = experiment.temperatures
    target = None if recorded is None else padded(recorded, np.nan)

    def work(chunk: Mapping[str, Float[np.ndarray, " chunk"]]) -> dict[str, Array | np.ndarray]:
        values = np.column_stack(list(chunk.values()))
        with own_settings():
            slopes, number, error = _slopes_of_chunk(
                twin,
                grid,
                tuple(chunk),
                values,
                requested,
                columns,
                len(experiment.time),
                target,
                padded(experiment.duty),
            )
            is_refused = needs_shorter_steps(number, error, 0) | np.isnan(number)
            return {**slopes, "failed": is_refused}

    slopes = work_in_chunks(draws, work, chunk_size=CHUNK)
    return [
        Reductions.of(
            channels,
            {name: part if name == "failed" else part[..., j] for name, part in slopes.items()},
        )
        for j in range(len(draws))
    ]


@persistent_jit
def _slopes_of_chunk(
    twin: Twin,
    grid: TimeGrid,
    names: tuple[str, ...],
    values: Float[np.ndarray | Array, "draws parameters"],
    reductions: Mapping[str, Reduction],
    columns: Int[np.ndarray | Array, " channels"],
    count: int,
    recorded: Float[np.ndarray | Array, "filled channels"] | None,
    commands: Float[np.ndarray | Array, "filled cells"],
) -> tuple[dict[str, Array], Float[Array, " draws"], Float[Array, " draws"]]:
    """Computes the derivatives, name of the reduction -> `(draws, ..., parameters)`; the stability
    numbers; and the error estimates of the solutions, K."""

    def read(
        vector: Float[Array, " parameters"],
    ) -> tuple[dict[str, Array], tuple[Float[Array, ""], Float[Array, ""]]]:
        drawn = twin.with_values(dict(zip(names, vector, strict=True)))
        states, readings, number, error = _run_exponential(drawn, grid, None)
        trajectory = readings[:, columns] - ZERO_CELSIUS
        parts = {
            "trajectory": trajectory[:count],
            "padded_trajectory": trajectory,
            "end": trajectory[-1],
        }
        if any(reduction.reads in ("energy", "peak_power") for reduction in reductions.values()):
            drawn_power = power_of_states(
                drawn, states, grid.times, commands, grid.steady_start, grid.levels_at
            )
            parts |= {"energy": drawn_power.energy[-1], "peak_power": drawn_power.peak}
        results = {}
        for name, reduction in reductions.items():
            more = (recorded,) if reduction.needs_recording else ()
            results[name] = jnp.asarray(reduction.function(parts[reduction.reads], *more))
        return results, (number, error)

    slopes, (number, error) = jax.vmap(jax.jacfwd(read, has_aux=True))(values)
    return slopes, number, error
