r"""The information on a rig before a recording, and what the recording of a schedule would add to
it.

The match of all recordings together with a new one has the covariance of `matching/_uncertainty.py`
with the sums over all recordings:

$$\operatorname{cov} = A^{-1} M A^{-1}, \qquad A = A_0 + J^T J, \qquad M = M_0 + J^T \Gamma J$$

$A_0$ and $M_0$ belong to the recordings of today and to the priors, $J$ and $\Gamma$ to the new
recording. Values that belong only to the new recording, such as the temperature of the room, are
unknowns too, with their priors.

The entries of $J$ are the exact derivatives of the residuals that a match would have, with the
weights that it would give them. The noise is that of the fit: of the channels and of their common
mode, each with its autocorrelation time $n$ in samples, as a first-order autoregression with $\rho
= (n - 1) / (n + 1)$. The schedule is data of one compiled program.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._celsius import ZERO_CELSIUS
from .._compilation import persistent_jit
from .._jax_settings import own_settings
from ..errors import MatchError
from ..matching import (
    INITIAL_NOISE,
    Fit,
    Noise,
    ResidualWeights,
    Unknowns,
    VectorLayout,
    camera_shapes,
    choose_unknowns,
    count_shapes,
    inverse_of_normal,
    new_group_values,
    reading_jacobian,
    residual_weights,
    solution_of,
)
from ..physics import Twin
from ..rig import Parameter
from ..simulation import TimeGrid, padded_time_grid, side_nodes, solve_network
from ._schedules import Counts, Schedules

# The standard deviation of an unknown value, in the scale of the match.
UNKNOWN = 1e4

Square = Float[np.ndarray, "entries entries"]


@final
@dataclass(frozen=True, eq=False)
class PriorInformation:
    r"""The information before the new recording.

    - `twin`: the twin with the values that are expected in the new recording.
    - `unknowns`: the unknowns of a match of only the new recording.
    - `vector`: their values. `scale`: the distance that each is expected to move.
    - `normal`, `meat`: $A_0$ and $M_0$ of all entries: the entries of the match of today, followed
      by the additional entries of the new recording.
    - `places`: the position of each of the `unknowns` among these entries; -1 for values that are
      held at a bound.
    """

    twin: Twin
    unknowns: Unknowns
    vector: Float[np.ndarray, " unknowns"]
    scale: Float[np.ndarray, " unknowns"]
    normal: Square
    meat: Square
    places: Int[np.ndarray, " unknowns"]

    @classmethod
    def of_twin(cls, twin: Twin) -> "PriorInformation":
        """The information in the priors of the rig file."""
        unknowns = choose_unknowns(twin, (0,))
        prior = np.diag(unknowns.prior_weights() ** 2)
        places = np.arange(unknowns.size)
        return cls._make(twin, unknowns, prior, prior, places)

    @classmethod
    def of_fit(cls, fit: Fit, group: str | None) -> "PriorInformation":
        """The match of today.

        **Arguments:**

        - `group`: the group of the new recording; None for the only group, or for a new one.

        **Raises:** `MatchError` for a group that the match does not have.
        """
        problem = solution_of(fit).problem
        matched, names = problem.unknowns, problem.group_names
        if group is not None and group not in names:
            raise MatchError(
                f"design_experiment: group: expected one of {', '.join(names)}, or None for a new "
                f"one, got {group!r}"
            )
        unknowns = Unknowns(
            matched.shared, matched.per_group, matched.per_recording, group_numbers=(0,)
        )
        inside = np.isfinite(np.diag(fit.uncertainty.inverse_hessian))
        normal, _ = inverse_of_normal(fit.uncertainty.inverse_hessian[np.ix_(inside, inside)])
        meat = normal @ fit.uncertainty.vector_covariance[np.ix_(inside, inside)] @ normal
        position = np.where(inside, np.cumsum(inside) - 1, -1)
        shared = position[: len(matched.shared)]
        if not matched.per_group:
            of_group = np.zeros(0, int)
        elif group is not None:
            of_group = position[matched.group_entries()[names.index(group)]]
        else:
            normal, meat, of_group = _with_new_group(fit, normal, meat, inside)
        rows = matched.per_recording
        weights = [
            0.0 if row.standard_deviation is None else 1 / row.standard_deviation**2 for row in rows
        ]
        of_recording = len(normal) + np.arange(len(rows))
        return cls._make(
            fit.twin_of_group(names[0] if len(names) == 1 else group or ""),
            unknowns,
            _with_block(normal, np.diag(weights)),
            _with_block(meat, np.diag(weights)),
            np.concatenate([shared, of_group, of_recording]),
        )

    @classmethod
    def _make(
        cls,
        twin: Twin,
        unknowns: Unknowns,
        normal: Square,
        meat: Square,
        places: Int[np.ndarray, " unknowns"],
    ) -> "PriorInformation":
        rows = unknowns.entry_parameters
        vector = np.array([row.to_entry(float(twin.values[row.name])) for row in rows])
        scale = unknowns.scales()
        open_ = np.zeros(len(normal))
        open_[places[places >= 0]] = (UNKNOWN * scale[places >= 0]) ** -2.0
        return cls(
            twin, unknowns, vector, scale, normal + np.diag(open_), meat + np.diag(open_), places
        )

    @property
    def own_rows(self) -> tuple[Parameter, ...]:
        """The parameters of the rig itself that are not held at a bound."""
        rows = self.unknowns.shared + self.unknowns.per_group
        return tuple(row for row, place in zip(rows, self.places, strict=False) if place >= 0)

    def covariance(
        self,
        normal: Float[np.ndarray, "unknowns unknowns"] | None = None,
        meat: Float[np.ndarray, "unknowns unknowns"] | None = None,
    ) -> Float[np.ndarray, "unknowns unknowns"]:
        r"""The covariance of the `unknowns` with a new recording; NaN for values that are held.

        **Arguments:**

        - `normal`, `meat`: $J^T J$ and $J^T \Gamma J$ of the recording; None without one.
        """
        free = self.places >= 0
        at, of_new = np.ix_(self.places[free], self.places[free]), np.ix_(free, free)
        total, noise = self.normal.copy(), self.meat.copy()
        if normal is not None and meat is not None:
            total[at] += normal[of_new]
            noise[at] += meat[of_new]
        inverse, _ = inverse_of_normal(total)
        result = np.full((len(free), len(free)), np.nan)
        result[of_new] = (inverse @ noise @ inverse)[at]
        return result


def _with_new_group(
    fit: Fit, normal: Square, meat: Square, inside: np.ndarray
) -> tuple[Float[np.ndarray, "all all"], Float[np.ndarray, "all all"], Int[np.ndarray, " rows"]]:
    """The entries of the match and of a new group, whose values follow from those of the groups of
    the match."""
    solution = solution_of(fit)
    expected = new_group_values(solution.problem.unknowns, solution.vector)
    rows = len(expected.rows)
    difference = np.concatenate([-expected.lift[:, inside], np.eye(rows)], axis=1)
    prior = difference.T @ (difference / expected.variance[:, None])
    empty = np.zeros((rows, rows))
    places = len(normal) + np.arange(rows)
    return _with_block(normal, empty) + prior, _with_block(meat, empty) + prior, places


def _with_block(
    matrix: Square, block: Float[np.ndarray, "more more"]
) -> Float[np.ndarray, "all all"]:
    """The block-diagonal matrix of two blocks."""
    size = len(matrix)
    whole = np.zeros((size + len(block), size + len(block)))
    whole[:size, :size] = matrix
    whole[size:, size:] = block
    return whole


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
        weighted = jax.vmap(problem.weights.weighted)(slopes)
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
        return normal, meat, readings.max(), sides.max(initial=-jnp.inf)

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
    """The readings, and the temperatures of the sides that have a limit, at the samples, degC."""
    values = problem.layout.local_values(jnp.asarray(problem.vector))
    system = problem.twin.with_values(values).system(lumped=True)
    channels = jnp.asarray(system.channel_weights)
    limited = np.isfinite(np.tile(problem.twin.rig.maximum_side_temperatures, 2))
    sides = jnp.eye(system.capacitance.size)[side_nodes(system)[limited]]
    readout = jnp.concatenate([channels, sides])
    drive, rise = solve_network(system, grid, system.initial_temperature, readout)
    ambient = jnp.asarray(drive.ambient_at_samples(), rise.dtype)
    read, at_sides = rise[:, : len(channels)], rise[:, len(channels) :]
    celsius = drive.reference - ZERO_CELSIUS
    return system.readings(read, ambient) + celsius, at_sides + celsius
