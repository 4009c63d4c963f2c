r"""Moving-horizon estimation: the most likely way of a rig through its last samples, within bounds.

At each sample the states $x_0 \dots x_n$ of a window minimise

$$\|x_0 - \bar x_0\|^2_{P^{-1}} + \sum_{k=1}^{n} \|x_k - F(x_{k-1}, u_{k-1})\|^2_{Q^{-1}}
+ \sum_{k=1}^{n} \|y_k - h(x_k)\|^2_{R^{-1}}$$

within bounds of the states (Rao, Rawlings and Mayne, IEEE Trans. Autom. Control 48, 2003). The twin
$F$ with its further states, the noises $Q$ and $R$ and the readings $h$ are those of an extended
Kalman filter. The first term is the arrival cost: $\bar x_0$ is what was estimated at that sample
when it was the last one, and $P$ follows from the filter's Riccati equation.

It is solved by multiple shooting with the Hessian of Gauss and Newton: all steps of the window are
linearised side by side, each at a state of its own, and the program that is left
(`most_likely`) gives the next states. One such iteration a sample, from the states of the
sample before, is the real-time iteration.
"""

from typing import NamedTuple, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from .._arguments import of_kind, whole_number
from .._quadratic_program import QuadraticProgram, minimised
from ..errors import ObserverError
from ._augmented_model import AugmentedModel, ExpectedReading, Transition
from ._commands import Commands
from ._expected_correction import Jump
from ._gaussian import Gaussian, GaussianUpdate, measurement_update, symmetric, time_update
from ._kalman_filter import ExtendedKalmanFilter, KalmanState, Measured
from ._observer import AbstractObserver
from ._state_bounds import BoundRows, StateBounds, bound_rows

# The last steps and readings of a rig, which a moving-horizon estimator looks at together.

Tree = TypeVar("Tree")


class WindowStep(NamedTuple):
    """A step of an observer.

    - `reached`: the duty that reaches the cells before it. `commands`: those in force during it.
    - `dt`: its length, s; 0 for a step that was not taken.
    - `levels`: the rig's other inputs; None for those of the rig file.
    - `jump`: that of a correction of the camera which is expected during it.
    """

    reached: Float[Array, "*steps cells"]
    commands: Commands
    dt: Float[Array, "*steps"]
    levels: Float[Array, "*steps inputs"] | None
    jump: Jump


class SmoothingWindow(NamedTuple):
    """A horizon of steps, with a sample before the first and one after each.

    - `start`: the state at the first sample, given its readings and all before: the arrival cost.
    - `steps`: the steps. `measured`: the readings after each of them.
    - `path`: the states of all samples, given the readings of the window: where the equations are
      linearised.
    - `estimates`: the state of each sample as it was estimated when the sample was the last one.
    """

    start: Gaussian
    steps: WindowStep
    measured: Measured
    path: Float[Array, "samples state"]
    estimates: Float[Array, "samples state"]


class LinearisedWindow(NamedTuple):
    """Steps and the readings after each of them, linearised: `step` at the states before, `read` at
    those after."""

    step: Transition
    read: ExpectedReading


def initial_window(
    kalman: ExtendedKalmanFilter, start: Gaussian, step: WindowStep, horizon: int
) -> SmoothingWindow:
    """A window in which nothing has happened yet."""
    dtype = start.mean.dtype
    size, readings = len(start.mean), 1 + len(kalman.model.columns)
    measured = Measured(
        values=jnp.zeros(readings, dtype),
        variance=jnp.ones(readings, dtype),
        mask=jnp.zeros(readings, bool),
        far=jnp.zeros(readings, bool),
        rejected=jnp.zeros(readings, bool),
        log_density=jnp.zeros((), dtype),
        added_variance=jnp.zeros(size, dtype),
        is_certain=jnp.zeros((), bool),
    )
    steps, measured = _repeated((step, measured), horizon)
    path = jnp.tile(start.mean, (horizon + 1, 1))
    return SmoothingWindow(start, steps, measured, path, path)


def linearised(
    kalman: ExtendedKalmanFilter,
    step: WindowStep,
    before: Float[Array, "steps state"],
    after: Float[Array, "steps state"],
) -> tuple[LinearisedWindow, Float[Array, "steps cells"]]:
    """Linearises several steps side by side, each at its own state, with exact derivatives; and the
    duty that reaches the cells after each."""

    def one(step: WindowStep, before: Array, after: Array) -> tuple[LinearisedWindow, Array]:
        moved, duty = kalman.model.exact_step(
            before, step.reached, step.commands, step.dt, step.levels
        )
        moved = moved._replace(
            mean=moved.mean + step.jump.mean, noise=moved.noise + jnp.diag(step.jump.variance)
        )
        return LinearisedWindow(moved, kalman.expected(after)), duty

    return jax.vmap(one)(step, before, after)


def shifted_window(
    window: SmoothingWindow, start: Gaussian, step: WindowStep, expected: Float[Array, " state"]
) -> SmoothingWindow:
    """The window a step shifted_window: its first sample is left out, and a new one expected.

    **Arguments:**

    - `start`: the state at what is then its first sample.
    """
    steps = _pushed(window.steps, step)
    unread = jax.tree.map(lambda rows: jnp.zeros_like(rows[0]), window.measured)
    unread = unread._replace(variance=jnp.ones_like(unread.variance))
    measured = _pushed(window.measured, unread)
    return SmoothingWindow(
        start, steps, measured, _pushed(window.path, expected), _pushed(window.estimates, expected)
    )


def read(window: SmoothingWindow, measured: Measured) -> SmoothingWindow:
    """The window with readings at its last sample, beside those that it had there."""
    rows = window.measured
    old = jax.tree.map(lambda many: many[-1], rows)
    both = Measured(
        values=jnp.where(measured.mask, measured.values, old.values),
        variance=jnp.where(measured.mask, measured.variance, old.variance),
        mask=measured.mask | old.mask,
        far=measured.far | old.far,
        rejected=measured.rejected | old.rejected,
        log_density=measured.log_density + old.log_density,
        added_variance=measured.added_variance + old.added_variance,
        is_certain=measured.is_certain | old.is_certain,
    )
    return window._replace(
        measured=jax.tree.map(lambda many, row: many.at[-1].set(row), rows, both)
    )


def _repeated(tree: Tree, count: int) -> Tree:
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count, *leaf.shape)), tree)


def _pushed(rows: Tree, row: Tree) -> Tree:
    """Rows without the first, and with another after the last."""
    return jax.tree.map(lambda many, row: jnp.concatenate([many[1:], row[None]]), rows, row)


# The most likely states of a window, within bounds.
#
# With its steps and readings linearised, the states of a window have a normal distribution,
# whose mean $\mu$ a Kalman filter and the adjoint of Bryson and Frazier find in a time that
# grows with the number of samples. Bounds of some functions $v = C x$ of the states make the
# mode of this distribution that of a quadratic program,
#
# $$\min_v \tfrac12 (v - C \mu)^T S^{-1} (v - C \mu), \quad a \le v \le b, \quad S = C \Sigma C^T,$$
#
# whose unknowns are only the bounded ones; with the multipliers $\lambda = S^{-1} (v - C \mu)$
# the states are $\mu + \Sigma C^T \lambda$. What $\Sigma$ multiplies is a force $f_k$ on the
# state of each sample: it moves that state by $P_k f_k$ in the filter, as readings would that
# leave its covariance as it is. No matrix of all states is made.


# How far the missing side of a bound is away, in standard deviations.
OPEN_SIDE = 50.0


class FilteredWindow(NamedTuple):
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
) -> FilteredWindow:
    """Goes through a window as a Kalman filter of the linearised equations."""

    def take(state: Gaussian, at: tuple[Array, Array, LinearisedWindow, Measured]) -> tuple:
        before, after, step, read = at
        result = updated_by(predicted_by(state, before, step.step), after, step.read, read)
        return result.state, result

    _, result = jax.lax.scan(take, start, (path[:-1], path[1:], steps, measured))
    return FilteredWindow(start, result, jax.vmap(lambda step: step.slope)(steps.step))


def predicted_by(state: Gaussian, before: Float[Array, " state"], step: Transition) -> Gaussian:
    """The state after a step that is linearised at another state."""
    driven, away = len(step.driven), state.mean - before
    by_away = jnp.concatenate([step.driven @ away[:driven], step.decay * away[driven:]])
    return time_update(state, step.mean + by_away, step.driven, step.decay, step.noise)


def updated_by(
    state: Gaussian, after: Float[Array, " state"], seen: ExpectedReading, measured: Measured
) -> GaussianUpdate:
    """The state after readings that are linearised at another state."""
    innovation = measured.values - seen.mean - seen.slope @ (state.mean - after)
    prior = Gaussian(state.mean, state.covariance + jnp.diag(measured.added_variance))
    return measurement_update(
        prior, innovation, seen.slope, measured.variance, measured.mask, slice(0)
    )


def most_likely(filtered: FilteredWindow, bounds: BoundRows) -> Float[Array, "samples state"]:
    """The most likely states of a window within the bounds."""
    result = filtered.corrections
    means = jnp.concatenate([filtered.start.mean[None], result.state.mean])
    samples, size = means.shape
    free = _smoothed(filtered, means, result.whitened, jnp.zeros_like(means))
    rows = jnp.asarray(bounds.matrix, means.dtype)
    if not len(rows):
        return free
    lowest, highest = (jnp.asarray(edge, means.dtype) for edge in bounds[1:])
    value = free @ rows.T

    def within(_: None) -> Float[Array, "samples state"]:
        count = samples * len(rows)
        units = jnp.eye(count, dtype=means.dtype).reshape(count, samples, len(rows)) @ rows
        moves = jax.vmap(lambda forces: _response(filtered, forces))(units)
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
    # Neighbours in time are almost fully correlated: a jitter keeps the matrix positive definite.
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
    filtered: FilteredWindow, forces: Float[Array, "samples state"]
) -> Float[Array, "samples state"]:
    """How far forces on the states of the samples move the most likely ones: $\\Sigma f$."""
    result = filtered.corrections

    def take(change: Array, at: tuple[Array, GaussianUpdate, Array]) -> tuple:
        slope, one, force = at
        change = slope @ change
        whitened = -one.slope @ change
        change = change + one.gain @ whitened + one.state.covariance @ force
        return change, (change, whitened)

    first = filtered.start.covariance @ forces[0]
    _, (changes, whitened) = jax.lax.scan(take, first, (filtered.slopes, result, forces[1:]))
    return _smoothed(filtered, jnp.concatenate([first[None], changes]), whitened, forces)


def _smoothed(
    filtered: FilteredWindow,
    means: Float[Array, "samples state"],
    whitened: Float[Array, "steps readings"],
    forces: Float[Array, "samples state"],
) -> Float[Array, "samples state"]:
    """Smooths filtered states backwards (Bryson and Frazier), with forces on the states."""
    result = filtered.corrections

    def take(adjoint: Array, at: tuple[Array, GaussianUpdate, Array, Array, Array]) -> tuple:
        slope, one, mean, error, force = at
        smoothed = mean - one.state.covariance @ adjoint
        before = adjoint - force
        before = before - one.slope.T @ (one.gain.T @ before + error)
        return slope.T @ before, smoothed

    rows = filtered.slopes, result, means[1:], whitened, forces[1:]
    adjoint, smoothed = jax.lax.scan(take, jnp.zeros_like(means[0]), rows, reverse=True)
    first = means[0] - filtered.start.covariance @ adjoint
    return jnp.concatenate([first[None], smoothed])


# The usual number of steps in a window.
HORIZON = 20


class MovingHorizonState(NamedTuple):
    """What a `MovingHorizonEstimator` knows.

    - `latest`: the state at the last sample, as an `ExtendedKalmanFilter` has it. Its covariance
      knows nothing of the bounds.
    - `window`: the last steps and readings.
    """

    latest: KalmanState
    window: SmoothingWindow


@final
class MovingHorizonEstimator(AbstractObserver[MovingHorizonState]):
    """Estimates the state of a rig from its last samples together, within bounds.

    ```python
    observer = MovingHorizonEstimator(live_observer(twin), 20, StateBounds(heat=(0, None)))
    design_mpc(model, observer=observer)
    ```

    It pays where one knows what cannot be: heat that nothing takes away, a room within a house, a
    node that cannot be colder than the bath around it. An extended Kalman filter cannot be told
    so, and an estimate that is cut off at a bound leaves the other states as wrong as before.
    Without an active bound it is that filter, with its equations linearised again at what later
    readings say, and without its caution about values of the twin where a reading is far off; on a
    linear twin it is the Kalman filter exactly.

    **Arguments:**

    - `kalman`: the filter whose twin and noises it takes, such as of `live_observer`.
    - `horizon`: the number of steps in the window. A step is at most `kalman.longest_step` long;
      longer times between samples are several.
    - `bounds`: what the state cannot be; None for nothing.
    - `iterations`: linearisations at each sample.

    **Raises:** `ObserverError` for an argument that is not valid, such as an unknown node.
    """

    kalman: ExtendedKalmanFilter
    bounds: BoundRows
    horizon: int = eqx.field(static=True)
    iterations: int = eqx.field(static=True)

    def __init__(
        self,
        kalman: ExtendedKalmanFilter,
        horizon: int = HORIZON,
        bounds: StateBounds | None = None,
        *,
        iterations: int = 1,
    ):
        where = "MovingHorizonEstimator"
        expected = "an observer of the rig, such as jaxtwin.observers.live_observer(twin)"
        self.kalman = of_kind(
            f"{where}: kalman", kalman, ExtendedKalmanFilter, expected, ObserverError
        )
        self.horizon = whole_number(f"{where}: horizon", horizon, 1, ObserverError)
        self.iterations = whole_number(f"{where}: iterations", iterations, 1, ObserverError)
        self.bounds = bound_rows(where, kalman.model, bounds)

    @property
    def model(self) -> AugmentedModel:
        """The twin with the states of the observer."""
        return self.kalman.model

    @property
    def longest_seconds(self) -> float:
        """The longest step that is taken at once, s, as a number of Python."""
        return self.kalman.longest_seconds

    def init(
        self, nodes: Float[ArrayLike, "..."] | None, duty: Float[ArrayLike, " cells"]
    ) -> MovingHorizonState:
        """The state at the start, that of the filter."""
        latest = self.kalman.init(nodes, duty)
        dt = jnp.zeros_like(latest.mean[0])
        jump = self.kalman.expected_jump(latest, dt)
        step = WindowStep(latest.duty, latest.commands, dt, self._levels(), jump)
        return MovingHorizonState(
            latest, initial_window(self.kalman, latest.gaussian, step, self.horizon)
        )

    def predict(
        self,
        state: MovingHorizonState,
        duty: Float[ArrayLike, " cells"],
        ambient: Float[ArrayLike, ""],
        dt: Float[ArrayLike, ""],
    ) -> MovingHorizonState:
        """The state after `dt` seconds with a duty, in steps of at most the longest step."""
        del ambient  # it is a reading of the room
        dt = jnp.asarray(dt, state.latest.mean.dtype)
        parts = jnp.maximum(jnp.ceil(dt / self.kalman.longest_step - 1e-9), 1.0)
        command = jnp.asarray(duty, dt.dtype)
        return jax.lax.fori_loop(
            0, parts.astype(int), lambda _, s: self.step(s, command, dt / parts), state
        )

    def step(
        self,
        state: MovingHorizonState,
        command: Float[ArrayLike, " cells"],
        dt: Float[ArrayLike, ""],
        levels: Float[ArrayLike, " inputs"] | None = None,
    ) -> MovingHorizonState:
        """The state after a single step; `levels` as in `ExtendedKalmanFilter.step`."""
        latest, window = state.latest, state.window
        commands, dt = self.kalman.commands(latest, command, dt)
        known = self._levels() if levels is None else jnp.asarray(levels, dt.dtype)
        jump = self.kalman.expected_jump(latest, dt)
        taken = WindowStep(latest.duty, commands, dt, known, jump)
        # The first step of the window, by which it is left, and the one that is new.
        both = jax.tree.map(lambda rows, row: jnp.stack([rows[0], row]), window.steps, taken)
        before = jnp.stack([window.path[0], latest.mean])
        after = jnp.stack([window.path[1], latest.mean])
        steps, duty = linearised(self.kalman, both, before, after)
        first, last = (jax.tree.map(lambda rows, i=i: rows[i], steps) for i in (0, 1))
        moved = predicted_by(window.start, window.path[0], first.step)
        read_then = jax.tree.map(lambda rows: rows[0], window.measured)
        arrived = updated_by(moved, window.path[1], first.read, read_then).state
        start = Gaussian(window.estimates[1], arrived.covariance)
        expected = predicted_by(latest.gaussian, latest.mean, last.step)
        return MovingHorizonState(
            self.kalman.stepped(latest, expected, duty[1], commands, dt),
            shifted_window(window, start, taken, expected.mean),
        )

    def predict_mean(
        self,
        state: MovingHorizonState,
        command: Float[ArrayLike, " cells"],
        dt: Float[ArrayLike, ""],
        levels: Float[ArrayLike, " inputs"] | None = None,
    ) -> MovingHorizonState:
        """The latest state after a single step, with covariance and window left as they were."""
        return state._replace(latest=self.kalman.predict_mean(state.latest, command, dt, levels))

    def with_room_temperature(
        self, state: MovingHorizonState, ambient: Float[ArrayLike, ""]
    ) -> MovingHorizonState:
        """The latest state in a room of this temperature, without doubt; NaN for its own room."""
        return state._replace(latest=self.kalman.with_room_temperature(state.latest, ambient))

    def update(
        self,
        state: MovingHorizonState,
        readings: Float[ArrayLike, " channels"],
        mask: Bool[ArrayLike, " channels"],
        ambient: Float[ArrayLike, ""],
    ) -> MovingHorizonState:
        """The state that readings and a measured ambient temperature (NaN if there is none)
        leave."""
        latest = state.latest
        expected = self.kalman.model.read(latest.mean)
        at_sample = self.kalman.measured(latest, expected, readings, mask, ambient)
        window = read(state.window, at_sample)
        measured = window.measured

        def improved(path: Float[Array, "samples state"]) -> tuple[Array, KalmanState]:
            steps, _ = linearised(self.kalman, window.steps, path[:-1], path[1:])
            filtered = filtered_window(window.start, path, steps, measured)
            optimum = most_likely(filtered, self.bounds)
            last = jax.tree.map(lambda rows: rows[-1], filtered.corrections)
            now = jax.tree.map(lambda rows: rows[-1], measured)
            return optimum, self.kalman.updated(latest, optimum[-1], last, now)

        start = window.path, latest
        path, latest = jax.lax.fori_loop(
            0, self.iterations, lambda _, carry: improved(carry[0]), start
        )
        estimates = window.estimates.at[-1].set(latest.mean)
        return MovingHorizonState(latest, window._replace(path=path, estimates=estimates))

    def readings(
        self, state: MovingHorizonState, ambient: Float[ArrayLike, ""]
    ) -> Float[Array, " channels"]:
        return self.kalman.readings(state.latest, ambient)

    def nodes(self, state: MovingHorizonState) -> Float[Array, " nodes"]:
        return self.kalman.nodes(state.latest)

    def _levels(self) -> Float[Array, " inputs"] | None:
        """The rig's other inputs as the rig file states them; None for a rig without any."""
        inputs = self.model.twin.rig.inputs
        if not inputs:
            return None
        return jnp.asarray(
            [rig_input.level for rig_input in inputs], self.model.stepper.reference.dtype
        )
