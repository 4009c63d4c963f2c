r"""The directions in which the values of a twin are uncertain.

A fit knows its parameters $u$ (logarithms, for positive ones) with a covariance $\Sigma$, and a
recording of another day has values of its own. Most of the dozens of parameters have no effect that
could be seen: $\Sigma = L L^T$ is therefore rotated so that its columns are ordered by the root
mean square of the change of the readings, and only the first are kept.

$$\frac{\partial y}{\partial u} L = U s V^T, \qquad u = u_0 + L V w, \qquad w \sim N(0, 1)$$
"""

from collections.abc import Mapping, Sequence
from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._name_suggestions import did_you_mean
from ..errors import ObserverError
from ..io import Experiment
from ..matching import Fit
from ..matching._fit import solution_of
from ..matching._group_values import group_and_shared_values
from ..matching._initial_condition_priors import with_prior
from ..matching._start import (
    first_sample,
    hidden_parameters,
    names_in,
    plate_parameters,
    room_parameters,
)
from ..physics import Twin
from ..rig import Parameter, Rig
from ..simulation import simulate_batch
from ._process_noise import Level, ProcessNoise

# The number of directions that are kept. It is the same for all recordings, which then share their
# compiled programs.
DIRECTIONS = 6

# The largest change of a logarithm. A change enters as a heat that is held during a step. However
# stiff a conductance is, this is stable as long as no rate is more than twice that in the modes,
# and 1.3 / 0.7, a larger conductance with a smaller heat capacity, is less than 2.
MAX_LOG_CHANGE = 0.3

# The largest change of another value, in standard deviations.
MAX_CHANGE_SIGMAS = 5.0

# The limit of a logarithm that the fit hardly knows, in its standard deviations.
LOG_LIMIT_SIGMAS = 3.0

# The power of the smooth limit.
SHARPNESS = 8

# A usual standard deviation of the logarithm of a parameter that drifts.
USUAL_DRIFT = 0.05

# The step of the differences, in standard deviations.
DIFFERENCE_STEP = 0.1


@final
class UncertainDirections(eqx.Module):
    """The twin's values as a function of a few numbers, each 0 for the values of the twin.

    - `names`: the parameters; `is_logarithmic`: which of them change by their logarithm.
    - `values`: their values in the twin. `matrix`: the directions, as columns.
    - `limits`: the largest change of each parameter, of its logarithm if it changes by that.
    - `slow`: the number of directions, at the end, that are single parameters which drift.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    is_logarithmic: tuple[bool, ...] = eqx.field(static=True)
    slow: int = eqx.field(static=True)
    values: Float[Array | np.ndarray, " parameters"]
    matrix: Float[Array | np.ndarray, "parameters directions"]
    limits: Float[Array | np.ndarray, " parameters"]

    @property
    def count(self) -> int:
        """The number of directions."""
        return self.matrix.shape[1]

    def limited(self, amounts: Float[Array, " directions"]) -> Float[Array, " directions"]:
        """The multiples of the directions, all of them smaller where a parameter would come to its
        limit."""
        parts = jnp.asarray(self.matrix) @ amounts / jnp.asarray(self.limits)
        return amounts * (1 + jnp.sum(parts**SHARPNESS)) ** (-1 / SHARPNESS)

    def change(self, amounts: Float[Array, " directions"]) -> Float[Array, " parameters"]:
        """The change of each parameter, of its logarithm if it changes by that."""
        return jnp.asarray(self.matrix) @ self.limited(amounts)

    def changed(self, amounts: Float[Array, " directions"]) -> dict[str, Float[Array, ""]]:
        """Name -> value, in the unit of the rig's table."""
        change = self.change(amounts)
        values = jnp.asarray(self.values)
        changed = jnp.where(
            np.array(self.is_logarithmic), values * jnp.exp(change), values + change
        )
        return {name: changed[number] for number, name in enumerate(self.names)}

    def spreads(self, noise: ProcessNoise) -> Float[Array, " directions"]:
        """The standard deviation of each direction."""
        return self._of_each(noise.twin, noise.slow)

    def times(self, noise: ProcessNoise) -> Float[Array, " directions"]:
        """The time within which each direction is forgotten, s."""
        return self._of_each(noise.twin_time, noise.slow_time)

    def _of_each(self, of_fit: Level, of_slow: Level) -> Float[Array, " directions"]:
        is_slow = np.arange(self.count) >= self.count - self.slow
        return jnp.where(is_slow, jnp.asarray(of_slow), jnp.asarray(of_fit))


def uncertain_directions(
    twin: Twin,
    known: Mapping[str, Parameter],
    covariance: Float[np.ndarray, "parameters parameters"],
    experiment: Experiment | None,
    slow: Sequence[str],
) -> UncertainDirections | None:
    """Finds the directions that the readings of an experiment show; None if there are none.

    **Arguments:**

    - `known`: name -> row of the parameters of which the fit knows the covariance.
    - `experiment`: the experiment; None is enough if no covariance is known.
    - `slow`: names of parameters that drift by themselves.

    **Raises:** `ObserverError` if a name of `slow` is unknown or not positive.
    """
    table = twin.rig.parameters
    for name in slow:
        if name not in table:
            raise ObserverError(
                f"noise: names: expected parameters of {twin.rig.name}, got {name!r}"
                f"{did_you_mean([name], table)}"
            )
        if not float(twin.values[name]) > 0:
            raise ObserverError(
                f"noise: names: expected a parameter above 0, got {name} = "
                f"{float(twin.values[name]):g}"
            )
    rows = list(known.values())
    directions = np.zeros((len(rows), 0))
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    root = root[:, values > 1e-12 * max(values.max(initial=0.0), 1e-300)]
    if root.shape[1] and experiment is not None:
        effects = _effects(twin, rows, root, experiment)
        _, _, rotation = np.linalg.svd(effects, full_matrices=False)
        directions = root @ rotation[:DIRECTIONS].T
    names = [row.name for row in rows]
    places = [names.index(name) if name in names else None for name in slow]
    names += [name for name, place in zip(slow, places, strict=True) if place is None]
    matrix = np.zeros((len(names), directions.shape[1] + len(slow)))
    matrix[: len(rows), : directions.shape[1]] = directions
    for number, name in enumerate(slow):
        matrix[names.index(name), directions.shape[1] + number] = 1.0
    if not matrix.shape[1]:
        return None
    is_logarithmic = np.array([name in slow or table[name].is_logarithmic for name in names])
    spreads = np.linalg.norm(
        matrix * np.where(np.arange(matrix.shape[1]) < directions.shape[1], 1.0, USUAL_DRIFT),
        axis=1,
    )
    shrunk = np.minimum(1.0, MAX_LOG_CHANGE / (LOG_LIMIT_SIGMAS * np.maximum(spreads, 1e-12)))
    matrix = np.where(is_logarithmic, shrunk, 1.0)[:, None] * matrix
    return UncertainDirections(
        names=tuple(names),
        is_logarithmic=tuple(is_logarithmic.tolist()),
        slow=len(slow),
        values=np.array([float(twin.values[name]) for name in names]),
        matrix=matrix,
        limits=np.where(
            is_logarithmic, MAX_LOG_CHANGE, MAX_CHANGE_SIGMAS * np.maximum(spreads, 1e-12)
        ),
    )


def uncertainty_of_fit(
    fit: Fit, experiment: Experiment
) -> tuple[dict[str, Parameter], Float[np.ndarray, "parameters parameters"]]:
    """The parameters of which a fit knows how uncertain they are for a recording, and their
    covariance, without the temperatures at the start, which are states of the observer."""
    solution = solution_of(fit)
    unknowns, rig = solution.problem.unknowns, fit.twin.rig
    of_vector = np.nan_to_num(fit.uncertainty.vector_covariance)
    if experiment.fingerprint in fit.fingerprints:
        places = unknowns.layout.entry_indices()[fit.fingerprints.index(experiment.fingerprint)]
        rows = unknowns.shared + unknowns.per_group + unknowns.per_recording
        covariance = of_vector[np.ix_(places, places)]
    else:
        names = solution.problem.group_names
        number = names.index(experiment.group) if experiment.group in names else None
        between = np.diag(fit.uncertainty.between_recordings**2)
        match = group_and_shared_values(unknowns, solution.vector, number)
        of_match = match.covariance(of_vector + between)
        own = [
            with_prior(row, rig, first_sample(experiment).reading, fit.recording_values)
            for row in unknowns.per_recording
        ]
        rows = (*match.rows, *own)
        covariance = np.diag([0.0] * len(match.rows) + [(r.prior_spread or 0.0) ** 2 for r in own])
        covariance[: len(match.rows), : len(match.rows)] = of_match
    starts = start_parameters(rig)
    kept = [number for number, row in enumerate(rows) if row.name not in starts]
    return {rows[n].name: rows[n] for n in kept}, covariance[np.ix_(kept, kept)]


def room_spread(fitted: Twin | Fit) -> float:
    """The standard deviation of the room temperature of a new recording, K."""
    twin = fitted.twin if isinstance(fitted, Fit) else fitted
    earlier = fitted.recording_values if isinstance(fitted, Fit) else {}
    spreads = [
        with_prior(twin.rig.parameters[name], twin.rig, 20.0, earlier).prior_spread
        for name in room_parameters(twin.rig)
    ]
    return max((spread for spread in spreads if spread is not None), default=2.0)


def start_parameters(rig: Rig) -> frozenset[str]:
    """The parameters of temperatures at the start and of the room, which are states of an
    observer."""
    return (
        room_parameters(rig)
        | plate_parameters(rig)
        | hidden_parameters(rig)
        | names_in(rig.ambient_drift)
    )


def _effects(
    twin: Twin,
    rows: Sequence[Parameter],
    root: Float[np.ndarray, "parameters columns"],
    experiment: Experiment,
) -> Float[np.ndarray, "readings columns"]:
    """The change of the readings along each column, divided by the square root of their number, so
    that the length of a column is the root mean square of the change, K."""
    names = [row.name for row in rows]
    at = np.array([float(twin.values[name]) for name in names])
    steps = DIFFERENCE_STEP * np.concatenate([root, -root], axis=1).T
    is_logarithmic = np.array([row.is_logarithmic for row in rows])
    values = np.where(is_logarithmic, at * np.exp(steps), at + steps)
    draws = {name: values[:, number] for number, name in enumerate(names)}
    simulated = np.asarray(simulate_batch(twin, experiment, draws))
    up, down = np.split(simulated, 2)
    effects = ((up - down) / (2 * DIFFERENCE_STEP)).reshape(len(up), -1).T
    return np.nan_to_num(effects) / np.sqrt(len(effects))
