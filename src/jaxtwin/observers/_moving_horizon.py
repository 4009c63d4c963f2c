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
(`_window_smoother`) gives the next states. One such iteration a sample, from the states of the
sample before, is the real-time iteration.
"""

from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from .._arguments import of_kind, whole_number
from ..errors import ObserverError
from ._augmented_model import AugmentedModel
from ._gaussian import Gaussian
from ._kalman_filter import ExtendedKalmanFilter, KalmanState
from ._observer import AbstractObserver
from ._state_bounds import BoundRows, StateBounds, bound_rows
from ._window import SmoothingWindow, Step, begun, later, linearised, read
from ._window_smoother import corrected_by, filtered_window, most_likely, moved_by

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
    MPC(model, observer=observer)
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
        step = Step(latest.duty, latest.commands, dt, self._levels(), jump)
        return MovingHorizonState(latest, begun(self.kalman, latest.gaussian, step, self.horizon))

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
        taken = Step(latest.duty, commands, dt, known, jump)
        # The first step of the window, by which it is left, and the one that is new.
        both = jax.tree.map(lambda rows, row: jnp.stack([rows[0], row]), window.steps, taken)
        before = jnp.stack([window.path[0], latest.mean])
        after = jnp.stack([window.path[1], latest.mean])
        steps, duty = linearised(self.kalman, both, before, after)
        first, last = (jax.tree.map(lambda rows, i=i: rows[i], steps) for i in (0, 1))
        moved = moved_by(window.start, window.path[0], first.step)
        read_then = jax.tree.map(lambda rows: rows[0], window.measured)
        arrived = corrected_by(moved, window.path[1], first.read, read_then).state
        start = Gaussian(window.estimates[1], arrived.covariance)
        expected = moved_by(latest.gaussian, latest.mean, last.step)
        return MovingHorizonState(
            self.kalman.stepped(latest, expected, duty[1], commands, dt),
            later(window, start, taken, expected.mean),
        )

    def step_of_mean(
        self,
        state: MovingHorizonState,
        command: Float[ArrayLike, " cells"],
        dt: Float[ArrayLike, ""],
        levels: Float[ArrayLike, " inputs"] | None = None,
    ) -> MovingHorizonState:
        """The latest state after a single step, with covariance and window left as they were."""
        return state._replace(latest=self.kalman.step_of_mean(state.latest, command, dt, levels))

    def in_room(
        self, state: MovingHorizonState, ambient: Float[ArrayLike, ""]
    ) -> MovingHorizonState:
        """The latest state in a room of this temperature, without doubt; NaN for its own room."""
        return state._replace(latest=self.kalman.in_room(state.latest, ambient))

    def correct(
        self,
        state: MovingHorizonState,
        readings: Float[ArrayLike, " channels"],
        mask: Bool[ArrayLike, " channels"],
        ambient: Float[ArrayLike, ""],
    ) -> MovingHorizonState:
        """The state that readings and a measured ambient temperature (NaN if there is none)
        leave."""
        latest = state.latest
        window = read(state.window, self.kalman.measured(latest, readings, mask, ambient))
        measured = window.measured

        def improved(path: Float[Array, "samples state"]) -> tuple[Array, KalmanState]:
            steps, _ = linearised(self.kalman, window.steps, path[:-1], path[1:])
            passed = filtered_window(window.start, path, steps, measured)
            optimum = most_likely(passed, self.bounds)
            last = jax.tree.map(lambda rows: rows[-1], passed.corrections)
            now = jax.tree.map(lambda rows: rows[-1], measured)
            return optimum, self.kalman.corrected(latest, optimum[-1], last, now)

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
        return jnp.asarray([one.level for one in inputs], self.model.stepper.reference.dtype)
