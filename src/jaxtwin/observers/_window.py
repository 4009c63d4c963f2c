"""The last steps and readings of a rig, which a moving-horizon estimator looks at together."""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._augmented_model import ExpectedReading, Transition
from ._commands import Commands
from ._expected_correction import Jump
from ._gaussian import Gaussian
from ._kalman_filter import ExtendedKalmanFilter, Measured

Tree = TypeVar("Tree")


class Step(NamedTuple):
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
    steps: Step
    measured: Measured
    path: Float[Array, "samples state"]
    estimates: Float[Array, "samples state"]


class LinearisedWindow(NamedTuple):
    """Steps and the readings after each of them, linearised: `step` at the states before, `read` at
    those after."""

    step: Transition
    read: ExpectedReading


def initial_window(
    kalman: ExtendedKalmanFilter, start: Gaussian, step: Step, horizon: int
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
    step: Step,
    before: Float[Array, "steps state"],
    after: Float[Array, "steps state"],
) -> tuple[LinearisedWindow, Float[Array, "steps cells"]]:
    """Linearises several steps side by side, each at its own state, with exact derivatives; and the
    duty that reaches the cells after each."""

    def one(step: Step, before: Array, after: Array) -> tuple[LinearisedWindow, Array]:
        moved, duty = kalman.model.exact_step(
            before, step.reached, step.commands, step.dt, step.levels
        )
        moved = moved._replace(
            mean=moved.mean + step.jump.mean, noise=moved.noise + jnp.diag(step.jump.variance)
        )
        return LinearisedWindow(moved, kalman.expected(after)), duty

    return jax.vmap(one)(step, before, after)


def shifted_window(
    window: SmoothingWindow, start: Gaussian, step: Step, expected: Float[Array, " state"]
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
