"""The recordings and weights of a match as arrays, on which its objective depends.

The objective itself is half the sum of the squared residuals (`_residuals`).
"""

from collections.abc import Sequence
from typing import TypeVar, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._padded_rows import padded
from ..io import Experiment
from ..physics import Twin
from ..simulation import TimeGrid, checked_initial, padded_time_grid
from ._camera_error import camera_shapes, count_shapes
from ._noise_model import NoiseModel
from ._problem import LinearPrior, MatchProblem
from ._residual_weights import ResidualWeights, residual_weights
from ._start import RunStart
from ._unknowns import VectorLayout

Tree = TypeVar("Tree")


@final
class SameShapeBatch(eqx.Module):
    """Recordings of equal shapes, stacked so that they are simulated together.

    Their samples, like their grids, are padded to a few sizes, so that recordings of another length
    use the same programs. Padding has no weight.

    - `grid`: the time grid; every array has a leading recordings axis.
    - `columns`: the positions of each recording's channels among those of the rig.
    - `temperatures`: the recorded temperatures, `(recordings, times, channels)`, degC; any finite
      number for a missing sample or padding.
    - `sampled`: whether a sample exists.
    - `lengths`: the number of times of each recording, without padding.
    - `weights`: the weights of the samples, with the camera's shapes; 0 for padding.
    - `positions`: the number of each recording among all.
    """

    grid: TimeGrid
    columns: Int[np.ndarray | Array, "recordings channels"]
    temperatures: Float[np.ndarray | Array, "recordings times channels"]
    sampled: Bool[np.ndarray | Array, "recordings times channels"]
    lengths: Int[np.ndarray | Array, " recordings"]
    weights: ResidualWeights
    positions: tuple[int, ...] = eqx.field(static=True)

    def weights_of(self, row: int) -> ResidualWeights:
        """The weights of one of the recordings, as arrays of NumPy."""
        return jax.tree.map(lambda leaf: np.asarray(leaf[row]), self.weights)


@final
class MatchObjective(eqx.Module):
    """Everything on which the residuals depend, except the unknowns.

    - `twin`: the twin with the values of the held parameters.
    - `same_shape_batches`: the recordings, those of equal shapes together.
    - `prior_means`: prior means of the vector's entries. `prior_weights`: the reciprocals of their
      prior standard deviations, 0 for an entry without a prior or with one in `linear_prior`.
    - `linear_prior`: priors of combinations of entries.
    - `start`: the temperatures with which the runs begin.
    - `layout`: the layout of the vector of unknowns.
    """

    twin: Twin
    same_shape_batches: tuple[SameShapeBatch, ...]
    prior_means: Float[np.ndarray | Array, " unknowns"]
    prior_weights: Float[np.ndarray | Array, " unknowns"]
    linear_prior: LinearPrior
    start: RunStart
    layout: VectorLayout = eqx.field(static=True)


def make_objective(
    problem: MatchProblem,
    noise_model: NoiseModel,
    shapes: int | None = None,
) -> MatchObjective:
    """The arrays on which the residuals depend, with the weights that follow from the noise model.

    **Arguments:**

    - `shapes`: the number of shapes of the camera's common error in each recording; by default as
      many as are needed.
    """
    count = shapes_needed(problem, noise_model) if shapes is None else shapes
    experiments = problem.experiments
    start = RunStart.of(checked_initial(problem.twin, problem.initial))
    grids = [
        padded_time_grid(problem.twin, experiment, steady_start=start.is_steady)
        for experiment in experiments
    ]
    weights = [
        recording_weights(problem, noise_model, number, count).padded()
        for number in range(len(experiments))
    ]
    # Recordings whose grids have equal shapes share compiled code.
    positions_of_shapes: dict[tuple, list[int]] = {}
    for position, (grid, experiment) in enumerate(zip(grids, experiments, strict=True)):
        leaves = jax.tree.leaves((grid, weights[position]))
        shapes_of_leaves = tuple(np.shape(leaf) for leaf in leaves)
        key = (shapes_of_leaves, grid.ambient is None, len(experiment.channels))
        positions_of_shapes.setdefault(key, []).append(position)
    unknowns = problem.unknowns
    return MatchObjective(
        twin=problem.twin,
        same_shape_batches=tuple(
            _batch(
                problem.twin,
                [experiments[position] for position in positions],
                _stacked([grids[position] for position in positions]),
                _stacked([weights[position] for position in positions]),
                positions,
            )
            for positions in positions_of_shapes.values()
        ),
        prior_means=unknowns.prior_means(),
        prior_weights=problem.prior_weights,
        linear_prior=problem.linear_prior,
        start=start,
        layout=unknowns.layout,
    )


def shapes_needed(problem: MatchProblem, noise_model: NoiseModel) -> int:
    """The number of shapes of the camera's common error, the largest of all recordings.

    All recordings have this number, so that their grids alone decide which of them are simulated
    together.
    """
    error = problem.common_error
    if error is None:
        return 0
    return max(
        count_shapes(error, experiment.time, events)
        for experiment, events in zip(problem.experiments, noise_model.events, strict=True)
    )


def recording_weights(
    problem: MatchProblem, noise_model: NoiseModel, number: int, count: int
) -> ResidualWeights:
    """Weights of one recording, with the given number of shapes of the camera's common error."""
    time = problem.experiments[number].time
    shapes, standard_deviations = np.zeros((len(time), 0)), np.zeros(0)
    if problem.common_error is not None:
        events = noise_model.events[number]
        shapes, standard_deviations = camera_shapes(problem.common_error, time, events, count)
    return residual_weights(
        noise_model.channel_weights[number],
        noise_model.common_mode_weights[number],
        noise_model.channel.effective,
        noise_model.common_mode.effective,
        shapes,
        standard_deviations,
    )


def _batch(
    twin: Twin,
    members: Sequence[Experiment],
    grid: TimeGrid,
    weights: ResidualWeights,
    positions: Sequence[int],
) -> SameShapeBatch:
    columns = [[twin.channels.index(name) for name in e.channels] for e in members]
    return SameShapeBatch(
        grid=grid,
        columns=np.array(columns, dtype=np.int32),
        # Missing samples have a weight of 0, but 0 times NaN is NaN.
        temperatures=np.stack([padded(np.nan_to_num(np.asarray(e.temperatures))) for e in members]),
        sampled=np.stack([padded(e.sampled, False) for e in members]),
        lengths=np.array([len(e.time) for e in members]),
        weights=weights,
        positions=tuple(positions),
    )


def _stacked(trees: Sequence[Tree]) -> Tree:
    return jax.tree.map(lambda *leaves: np.stack(leaves), *trees)
