r"""The information in the recording of a schedule, $J^T J$ and $J^T \Gamma J$, and its highest
temperatures.

$J$ are the exact derivatives of the residuals that a match would have, with the weights that it
would give them. The noise is that of the fit: of the channels and of their common mode, each with
its autocorrelation time $n$ in samples, as a first-order autoregression with $\rho = (n - 1) /
(n + 1)$. The schedule is data of one compiled program.
"""

from collections.abc import Sequence
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._celsius import ZERO_CELSIUS
from .._compilation import persistent_jit
from .._jax_settings import own_settings
from ..matching import Fit, Noise
from ..matching._camera_error import camera_shapes, count_shapes
from ..matching._fit import solution_of
from ..matching._jacobian import reading_jacobian
from ..matching._noise_model import INITIAL_NOISE
from ..matching._residual_weights import ResidualWeights, residual_weights
from ..matching._unknowns import VectorLayout
from ..physics import Twin
from ..simulation import TimeGrid, solve_network
from ..simulation._modes import side_nodes
from ..simulation._padding import padded_time_grid
from ._prior_information import PriorInformation
from ._schedules import Counts, Schedules


class NoisePrediction(NamedTuple):
    """The noise of a future recording.

    - `noise`: the noise of the channels without their common mode, and the noise of the common mode
      times the root of the number of channels.
    - `assumed`: the standard deviations by which a match weights its residuals, K.
    """

    noise: tuple[Noise, Noise]
    assumed: tuple[float, float]

    @classmethod
    def of(cls, twin: Twin | Fit) -> "NoisePrediction":
        """The noise that a fit has estimated, or that a match assumes in its first round."""
        if isinstance(twin, Fit):
            model = solution_of(twin).noise_model
            return cls(twin.noise, (model.channel.effective, model.common_mode.effective))
        assumed = INITIAL_NOISE.effective
        return cls((INITIAL_NOISE, INITIAL_NOISE), (assumed, assumed))


class EvaluatedSchedule(NamedTuple):
    r"""The information in the recording of a schedule, and its highest temperatures.

    - `normal`, `meat`: $J^T J$ and $J^T \Gamma J$.
    - `reading`, `side`: the highest temperature of a channel, and of a cell's side, degC.
    """

    normal: Float[np.ndarray, "unknowns unknowns"]
    meat: Float[np.ndarray, "unknowns unknowns"]
    reading: float
    side: float


@final
class DesignProblem(eqx.Module):
    """Everything on which the information of a schedule depends, except the schedule.

    - `vector`: the unknowns. `layout`: their order. `twin`: the twin with the values of the other
      parameters.
    - `grid`: the time grid of all schedules, whose duty is replaced. `step_of`: for each step of
      the grid the step of the schedule in which it lies.
    - `weights`: the weights of the samples. `samples`: their number, without padding.
    - `variance`, `rho`: the variance and the autocorrelation of the weighted noise of the channels
      and of the common mode.
    """

    twin: Twin
    vector: Float[np.ndarray | Array, " unknowns"]
    grid: TimeGrid
    step_of: Int[np.ndarray | Array, " grid_steps"]
    weights: ResidualWeights
    samples: Int[np.ndarray | Array, ""]
    variance: Float[np.ndarray | Array, "2"]
    rho: Float[np.ndarray | Array, "2"]
    layout: VectorLayout = eqx.field(static=True)

    def evaluate(self, schedules: Schedules, counts: Sequence[Counts]) -> list[EvaluatedSchedule]:
        """Evaluates several schedules. Each number of schedules is compiled separately."""
        duty = np.stack(counts) / schedules.counts
        with own_settings():
            normal, meat, reading, side = map(np.asarray, _evaluate(duty, self))
        return [
            EvaluatedSchedule(*parts[:2], float(parts[2]), float(parts[3]))
            for parts in zip(normal, meat, reading, side, strict=True)
        ]


def make_design_problem(
    prior: PriorInformation, schedules: Schedules, noise: NoisePrediction, events: tuple[float, ...]
) -> DesignProblem:
    """Makes the problem.

    **Arguments:**

    - `events`: the expected times of the camera's corrections, s.
    """
    twin = prior.twin
    example = schedules.numbered()
    grid = padded_time_grid(twin, example)
    step_of = np.rint(np.asarray(grid.duty)[:, 0] * schedules.steps).astype(np.int32) - 1
    times, channels = len(example.time), len(twin.channels)
    shapes, standard_deviations = np.zeros((times, 0)), np.zeros(0)
    if (error := twin.rig.common_error) is not None:
        shape_count = count_shapes(error, example.time, events)
        shapes, standard_deviations = camera_shapes(error, example.time, events, shape_count)
    weights = residual_weights(
        np.ones((times, channels)), np.ones(times), *noise.assumed, shapes, standard_deviations
    )
    ratios = [
        (of.standard_deviation / assumed) ** 2
        for of, assumed in zip(noise.noise, noise.assumed, strict=True)
    ]
    memories = np.array([of.autocorrelation_time for of in noise.noise])
    return DesignProblem(
        twin=twin,
        vector=prior.vector,
        grid=grid,
        step_of=step_of,
        weights=weights.padded(),
        samples=np.array(times),
        variance=np.array(ratios),
        rho=np.maximum(0.0, (memories - 1) / (memories + 1)),
        layout=prior.unknowns.layout,
    )


@persistent_jit
def _evaluate(
    duty: Float[Array | np.ndarray, "schedules steps cells"], problem: DesignProblem
) -> tuple[Array, Array, Array, Array]:
    columns = np.arange(len(problem.twin.channels))

    def of_schedule(levels: Array) -> tuple[Array, Array, Array, Array]:
        grid = eqx.tree_at(lambda g: g.duty, problem.grid, levels[jnp.asarray(problem.step_of)])
        vector = jnp.asarray(problem.vector)
        slopes = reading_jacobian(vector, problem.twin, problem.layout, grid, columns)
        counted = jnp.arange(slopes.shape[1]) < problem.samples
        slopes = jnp.where(counted[:, None], slopes, 0.0)
        weigh = jax.vmap(lambda slope: problem.weights.weigh(problem.weights.split(slope)))
        weighted = weigh(slopes)
        of_channels, common_mode = jnp.asarray(weighted.channel), jnp.asarray(weighted.common_mode)
        sizes = jnp.asarray(weighted.sizes)
        normal = meat = sizes @ sizes.T
        for number, part in enumerate((of_channels, common_mode[..., None])):
            rows = jnp.moveaxis(part, 1, 0)
            rho = jnp.asarray(problem.rho)[number]
            correlated = jnp.moveaxis(_apply_autocorrelation(rho, rows), 0, 1)
            normal = normal + _product(part, part)
            meat = meat + jnp.asarray(problem.variance)[number] * _product(part, correlated)
        readings, sides = _temperatures(problem, grid)
        return normal, meat, readings.max(), sides.max()

    return jax.vmap(of_schedule)(jnp.asarray(duty))


def _product(a: Array, b: Array) -> Array:
    return jnp.tensordot(a, b, ((1, 2), (1, 2)))


def _apply_autocorrelation(
    rho: Float[Array, ""], rows: Float[Array, "times ..."]
) -> Float[Array, "times ..."]:
    r"""$\sum_s \rho^{|t - s|} x_s$, by a recursion forwards and another one backwards."""

    def follow(state: Array, row: Array) -> tuple[Array, Array]:
        state = rho * state + row
        return state, state

    zero = jnp.zeros_like(rows[0])
    _, forwards = jax.lax.scan(follow, zero, rows)
    _, backwards = jax.lax.scan(follow, zero, rows, reverse=True)
    return forwards + backwards - rows


def _temperatures(problem: DesignProblem, grid: TimeGrid) -> tuple[Array, Array]:
    """The readings, and the temperatures of the cells' sides, at the samples, degC."""
    values = problem.layout.local_values(jnp.asarray(problem.vector))
    system = problem.twin.with_values(values).system(lumped=True)
    channels = jnp.asarray(system.channel_weights)
    sides = jnp.eye(system.capacitance.size)[side_nodes(system)]
    readout = jnp.concatenate([channels, sides])
    drive, rise = solve_network(system, grid, system.initial_temperature, readout)
    ambient = jnp.asarray(drive.ambient_at_samples(), rise.dtype)
    read, at_sides = rise[:, : len(channels)], rise[:, len(channels) :]
    celsius = drive.reference - ZERO_CELSIUS
    return system.readings(read, ambient) + celsius, at_sides + celsius
