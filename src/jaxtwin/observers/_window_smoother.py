r"""The most likely states of a window, within bounds.

With its steps and readings linearised, the states of a window have a normal distribution, whose
mean $\mu$ a Kalman filter and the adjoint of Bryson and Frazier find in a time that
grows with the number of samples. Bounds of some functions $v = C x$ of the states make the mode of
this distribution that of a quadratic program,

$$\min_v \tfrac12 (v - C \mu)^T S^{-1} (v - C \mu), \quad a \le v \le b, \quad S = C \Sigma C^T,$$

whose unknowns are only the bounded ones; with the multipliers $\lambda = S^{-1} (v - C \mu)$ the
states are $\mu + \Sigma C^T \lambda$. What $\Sigma$ multiplies is a force $f_k$ on the state of
each sample: it moves that state by $P_k f_k$ in the filter, as readings would that leave its
covariance as it is. No matrix of all states is made.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._quadratic_program import QuadraticProgram, minimised
from ._augmented_model import ExpectedReading, Transition
from ._gaussian import Gaussian, GaussianUpdate, gaussian_predict, gaussian_update, symmetric
from ._kalman_filter import Measured
from ._state_bounds import BoundRows
from ._window import LinearisedWindow

# How far the missing side of a bound is away, in standard deviations.
OPEN_SIDE = 50.0


class Passed(NamedTuple):
    """What a filter found, going through a window.

    - `start`: the state at the first sample.
    - `corrections`: those by the readings of the others.
    - `slopes`: the derivatives of the steps.
    """

    start: Gaussian
    corrections: GaussianUpdate
    slopes: Float[Array, "steps state state"]


def filtered_window(
    start: Gaussian,
    path: Float[Array, "samples state"],
    steps: LinearisedWindow,
    measured: Measured,
) -> Passed:
    """Goes through a window as a Kalman filter of the linearised equations."""

    def take(state: Gaussian, at: tuple[Array, Array, LinearisedWindow, Measured]) -> tuple:
        before, after, step, read = at
        result = updated_by(predicted_by(state, before, step.step), after, step.read, read)
        return result.state, result

    _, result = jax.lax.scan(take, start, (path[:-1], path[1:], steps, measured))
    return Passed(start, result, jax.vmap(lambda step: step.slope)(steps.step))


def predicted_by(state: Gaussian, before: Float[Array, " state"], step: Transition) -> Gaussian:
    """The state after a step that is linearised at another state."""
    driven, away = len(step.driven), state.mean - before
    by_away = jnp.concatenate([step.driven @ away[:driven], step.decay * away[driven:]])
    return gaussian_predict(state, step.mean + by_away, step.driven, step.decay, step.noise)


def updated_by(
    state: Gaussian, after: Float[Array, " state"], seen: ExpectedReading, measured: Measured
) -> GaussianUpdate:
    """The state after readings that are linearised at another state."""
    innovation = measured.values - seen.mean - seen.slope @ (state.mean - after)
    opened = Gaussian(state.mean, state.covariance + jnp.diag(measured.opened))
    return gaussian_update(
        opened, innovation, seen.slope, measured.variance, measured.mask, slice(0)
    )


def most_likely(passed: Passed, bounds: BoundRows) -> Float[Array, "samples state"]:
    """The most likely states of a window within the bounds."""
    result = passed.corrections
    means = jnp.concatenate([passed.start.mean[None], result.state.mean])
    samples, size = means.shape
    free = _smoothed(passed, means, result.whitened, jnp.zeros_like(means))
    rows = jnp.asarray(bounds.matrix, means.dtype)
    if not len(rows):
        return free
    lowest, highest = (jnp.asarray(edge, means.dtype) for edge in bounds[1:])
    value = free @ rows.T

    def within(_: None) -> Float[Array, "samples state"]:
        count = samples * len(rows)
        units = jnp.eye(count, dtype=means.dtype).reshape(count, samples, len(rows)) @ rows
        moves = jax.vmap(lambda forces: _response(passed, forces))(units)
        covariance = symmetric((moves @ rows.T).reshape(count, count))
        mean = value.reshape(-1)
        multipliers = _multipliers(
            mean, covariance, jnp.tile(lowest, samples), jnp.tile(highest, samples)
        )
        return free + (multipliers @ moves.reshape(count, -1)).reshape(samples, size)

    is_within = jnp.all((value >= lowest) & (value <= highest))
    return jax.lax.cond(is_within, lambda _: free, within, None)


def _multipliers(
    mean: Float[Array, " bounded"],
    covariance: Float[Array, "bounded bounded"],
    lowest: Float[Array, " bounded"],
    highest: Float[Array, " bounded"],
) -> Float[Array, " bounded"]:
    """The multipliers of the bounds, of normally distributed quantities."""
    dtype = mean.dtype
    spread = jnp.sqrt(jnp.maximum(jnp.diag(covariance), jnp.finfo(dtype).tiny ** 0.5))
    # Neighbours in time are nearly the same: a bit of noise in each keeps the factors apart.
    correlation = covariance / jnp.outer(spread, spread)
    apart = jnp.finfo(dtype).eps ** 0.5 * jnp.eye(len(mean), dtype=dtype)
    root = jnp.linalg.cholesky(correlation + apart)
    low, high = (lowest - mean) / spread, (highest - mean) / spread
    low = jnp.where(jnp.isfinite(low), low, jnp.minimum(high, 0.0) - OPEN_SIDE)
    high = jnp.where(jnp.isfinite(high), high, jnp.maximum(low, 0.0) + OPEN_SIDE)
    unit = jnp.eye(len(mean), dtype=dtype)
    whitened = minimised(QuadraticProgram(unit, jnp.zeros(len(mean), dtype), root, low, high))
    solved = jax.scipy.linalg.solve_triangular(root, whitened, lower=True, trans=1)
    return solved / spread


def _response(
    passed: Passed, forces: Float[Array, "samples state"]
) -> Float[Array, "samples state"]:
    """How far forces on the states of the samples move the most likely ones: $\\Sigma f$."""
    result = passed.corrections

    def take(change: Array, at: tuple[Array, GaussianUpdate, Array]) -> tuple:
        slope, one, force = at
        change = slope @ change
        whitened = -one.slope @ change
        change = change + one.gain @ whitened + one.state.covariance @ force
        return change, (change, whitened)

    first = passed.start.covariance @ forces[0]
    _, (changes, whitened) = jax.lax.scan(take, first, (passed.slopes, result, forces[1:]))
    return _smoothed(passed, jnp.concatenate([first[None], changes]), whitened, forces)


def _smoothed(
    passed: Passed,
    means: Float[Array, "samples state"],
    whitened: Float[Array, "steps readings"],
    forces: Float[Array, "samples state"],
) -> Float[Array, "samples state"]:
    """The states given all readings and forces, for those given the ones before."""
    result = passed.corrections

    def take(adjoint: Array, at: tuple[Array, GaussianUpdate, Array, Array, Array]) -> tuple:
        slope, one, mean, error, force = at
        smoothed = mean - one.state.covariance @ adjoint
        before = adjoint - force
        before = before - one.slope.T @ (one.gain.T @ before + error)
        return slope.T @ before, smoothed

    rows = passed.slopes, result, means[1:], whitened, forces[1:]
    adjoint, smoothed = jax.lax.scan(take, jnp.zeros_like(means[0]), rows, reverse=True)
    first = means[0] - passed.start.covariance @ adjoint
    return jnp.concatenate([first[None], smoothed])
