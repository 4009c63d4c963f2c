"""A moving-horizon estimator is the Kalman filter where nothing is bounded and the twin is linear,
and the minimum that scipy finds for the same problem where something is."""

from functools import cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from scipy.optimize import minimize

from jaxtwin import Experiment, Twin, observe
from jaxtwin.errors import ObserverError
from jaxtwin.observers import (
    ExtendedKalmanFilter,
    MovingHorizonEstimator,
    MovingHorizonState,
    ProcessNoise,
    StateBounds,
    live_observer,
)
from jaxtwin.observers._moving_horizon import WindowStep, linearised

pytestmark = pytest.mark.usefixtures("float64")

NOISE = ProcessNoise(disturbance=0.1, disturbance_time=60.0, heat=0.05, reading=0.2)


@cache
def followed(rig: str) -> ExtendedKalmanFilter:
    return live_observer(Twin(rig), NOISE, 5.0)


def plan(cells: int, samples: int, channels: int) -> tuple[np.ndarray, ...]:
    """Duty and readings without meaning, of which a quarter are missing."""
    random = np.random.default_rng(1)
    duty = random.uniform(0.1, 0.9, (samples, cells))
    readings = 26.0 + random.normal(0.0, 1.0, (samples, channels))
    readings[random.uniform(size=readings.shape) < 0.25] = np.nan
    return duty, readings


def recording(twin: Twin, samples: int = 40) -> Experiment:
    duty, readings = plan(len(twin.rig.driven), samples, len(twin.channels))
    steps = np.random.default_rng(2).uniform(3.0, 7.0, samples - 1)
    steps[20] = 55.0
    time = np.append(0.0, np.cumsum(steps))
    return Experiment(time, duty, channels=twin.channels, temperatures=readings)


@pytest.mark.slow
@pytest.mark.parametrize("horizon", [1, 8])
def test_on_a_linear_twin_it_is_the_kalman_filter(horizon: int):
    twin = Twin("tclab")
    given = recording(twin)
    usual, ours = (observe(twin, given, NOISE, horizon=steps) for steps in (None, horizon))
    for one, other in zip(usual.filtered, ours.filtered, strict=True):
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-9), one, other)


class Problem:
    """The problem of a window that begins with the start of the filter, as scipy gets it: its
    unknowns are the start and the noise of each step, in standard deviations."""

    def __init__(self, state: MovingHorizonState, estimator: MovingHorizonEstimator):
        self.window, self.model = state.window, estimator.model
        self.kalman, self.bounds = estimator.kalman, estimator.bounds
        ends = both_ends(self.window.path)
        steps, _ = eqx.filter_jit(linearised)(self.kalman, self.window.steps, *ends)
        self.roots = np.stack([factor(noise) for noise in steps.step.noise])
        self.first = factor(self.window.start.covariance)

    def path(self, unknowns: Array) -> Float[Array, "samples state"]:
        start, *noises = unknowns.reshape(1 + len(self.roots), -1)

        def take(before: Array, at: tuple[WindowStep, Array, Array]) -> tuple[Array, Array]:
            step, root, noise = at
            end, _ = self.model.predict_mean(before, step.reached, *step[1:4])
            return end + root @ noise, end + root @ noise

        first = self.window.start.mean + self.first @ start
        rows = self.window.steps, jnp.asarray(self.roots), jnp.stack(noises)
        _, later = jax.lax.scan(take, first, rows)
        return jnp.concatenate([first[None], later])

    def cost(self, unknowns: Array) -> Float[Array, ""]:
        read = self.window.measured
        expected = jax.vmap(lambda mean: self.kalman.expected(mean).mean)(self.path(unknowns)[1:])
        missed = jnp.where(read.mask, read.values - expected, 0.0)
        return unknowns @ unknowns + jnp.sum(missed**2 / read.variance)

    def minimum(self) -> Float[np.ndarray, "samples state"]:
        """The way within the lowest values."""
        lowest = np.tile(self.bounds.lowest, len(self.window.path))

        def above(unknowns: Array) -> Array:
            return (self.path(unknowns) @ self.bounds.matrix.T).reshape(-1) - lowest

        limits: Any = {"type": "ineq", "fun": jax.jit(above), "jac": jax.jit(jax.jacfwd(above))}
        start = np.zeros((1 + len(self.roots)) * len(self.first))
        found = minimize(
            jax.jit(jax.value_and_grad(self.cost)), start, jac=True,
            method="SLSQP", constraints=[limits], options={"ftol": 1e-13, "maxiter": 200},
        )  # fmt: skip
        assert found.success
        return np.asarray(jax.jit(self.path)(found.x))


def factor(covariance: Array) -> Float[np.ndarray, "state state"]:
    """A root of a covariance that need not be definite."""
    values, vectors = np.linalg.eigh(np.asarray(covariance))
    return vectors * np.sqrt(np.maximum(values, 0.0))


def both_ends(path: Array) -> tuple[Array, Array]:
    return path[:-1], path[1:]


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["tclab", pytest.param("pcr-block", marks=pytest.mark.long)])
def test_the_way_through_a_window_is_the_minimum_that_scipy_finds(rig: str):
    """With heats that may not be below a bound where they would be."""
    kalman, steps = followed(rig), 6
    bounds = StateBounds(heat=(-0.01, None))
    cells, channels = len(kalman.model.twin.rig.driven), len(kalman.model.columns)
    duty, readings = plan(cells, steps, channels)
    found = {}
    for name, bound in (("free", None), ("bounded", bounds)):
        estimator = MovingHorizonEstimator(kalman, steps, bound, iterations=4)
        state = estimator.init(24.0, np.zeros(cells))
        step = jax.jit(lambda s, u, y, o=estimator: o.update(
            o.predict(s, u, jnp.nan, 5.0), y, jnp.isfinite(y), jnp.nan
        ))  # fmt: skip
        for row, reading in zip(duty, readings, strict=True):
            state = step(state, row, reading)
        found[name] = state
    heats = kalman.model.layout.of("heats")
    assert found["free"].window.path[:, heats].min() < -0.05
    path = found["bounded"].window.path
    assert path[:, heats].min() > -0.01 - 1e-6
    np.testing.assert_allclose(path, Problem(found["bounded"], estimator).minimum(), atol=2e-4)


@pytest.mark.slow
def test_what_a_bound_says_of_the_room_is_in_degC():
    twin = Twin("tclab")
    given = recording(twin)
    ours = observe(
        twin, given, NOISE, bounds=StateBounds(room=(None, 22.0), nodes={"H1": (25, None)})
    )
    assert ours.estimates.room.mean.max() < 22.0 + 1e-5
    assert ours.estimates.node("H1").mean.min() > 25.0 - 1e-5
    free = observe(twin, given, NOISE)
    assert free.estimates.room.mean.max() > 22.5
    with pytest.raises(ObserverError, match="smooth: expected a recording that was observed with"):
        ours.smooth()


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        (StateBounds(room=(20, 10)), "bounds: room: expected the lowest and a higher value, or No"),
        (StateBounds(heat={"H3": (0, 1)}), "bounds: unknown cell 'H3'"),
        (StateBounds(nodes={"H": (0, 1)}), "bounds: unknown node 'H'"),
        (StateBounds(heat=(0.0,)), "bounds: heat H1: expected the lowest and a higher value"),
        (StateBounds(room=(float("nan"), 3)), "bounds: room: expected the lowest"),
    ],
)
def test_bounds_that_are_none(bounds: Any, message: str):
    with pytest.raises(ObserverError, match=message):
        MovingHorizonEstimator(followed("tclab"), bounds=bounds)


def test_a_horizon_of_no_step():
    with pytest.raises(ObserverError, match="horizon: expected a whole number above 0, got 0"):
        MovingHorizonEstimator(followed("tclab"), 0)
