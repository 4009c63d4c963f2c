r"""Derivative-based measures: exact derivatives at random points bound Sobol's total indices.

By Poincaré's inequality, $S_{Tj} \le E[(w_j \, \partial f / \partial x_j)^2] / V$, with a weight
that follows from the parameter's distribution: its standard deviation for a normal distribution,
its range divided by $\pi$ for a uniform one (Sobol' and Kucherenko, Mathematics and Computers in
Simulation 79 (2009) 3009-3017; Lamboni and others, the same, 87 (2013) 45-54). A parameter with a
small bound does not matter. A parameter with a large bound may or may not matter.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._celsius import ZERO_CELSIUS
from .._compilation import persistent_jit
from .._jax_settings import own_settings
from .._padded_rows import padded
from ..errors import SimulationError
from ..io import Experiment
from ..physics import Twin
from ..simulation import (
    Reduction,
    ReductionChoice,
    Reductions,
    TimeGrid,
    checked_channels,
    checked_reductions,
    needs_shorter_steps,
    padded_time_grid,
    power_of_states,
    run_exponential,
    work_in_chunks,
)
from ._method import AbstractPlainMethod, Design, Indices, half_width, resample_weights


@final
@dataclass(frozen=True)
class DerivativeBased(AbstractPlainMethod):
    """The mean squared derivative `vi`, its standard deviation over draws `vi_std`, and the bound
    of the total index `dgsm`, with `dgsm_conf`, half of its 95 % bootstrap interval. SALib's
    `dgsm_conf` is that of `vi`."""

    name = "dgsm"
    main = "dgsm"
    default_draws = 256
    default_samples = "sobol"
    needs_independence_for = "derivative-based bounds"
    needs_slopes = True

    def estimate(
        self,
        design: Design,
        outputs: Float[np.ndarray, "runs outputs"],
        slopes: Float[np.ndarray, "runs outputs parameters"] | None,
        seed: int,
    ) -> Indices:
        assert slopes is not None
        pairs = zip(design.inputs.marginals.values(), design.samples.T, strict=True)
        weight = np.stack([marginal.poincare_weight(column) for marginal, column in pairs], axis=1)
        squares, bounds = slopes**2, (slopes * weight[:, None]) ** 2
        again = resample_weights(len(outputs), seed)
        centred = outputs - outputs.mean(axis=0)
        variance = np.maximum(again @ centred**2 - (again @ centred) ** 2, 0.0)
        variance = np.where(variance > 0, variance, np.nan)[:, :, None]
        return {
            "vi": squares.mean(axis=0),
            "vi_std": squares.std(axis=0),
            "dgsm": bounds.mean(axis=0) / outputs.var(axis=0)[:, None],
            "dgsm_conf": half_width(np.tensordot(again, bounds, axes=1) / variance),
        }


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
        states, readings, number, error = run_exponential(drawn, grid, None)
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
